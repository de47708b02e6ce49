"""Compensation that a hand can hold: the law, its sampled loop, hands, and the search for settings."""

from haptid.end_effector.compensation.design import (
    CompensationDesign,
    DesignPoint,
    JudgedLaw,
    design_compensation,
    judge_law,
)
from haptid.end_effector.compensation.hands import (
    PUBLISHED_RANGE,
    STIFF_HAND,
    TYPICAL_HAND,
    HandModel,
    HandMotion,
    published_hands,
)
from haptid.end_effector.compensation.inverse_dynamics import InverseDynamics
from haptid.end_effector.compensation.law import Compensation, stable_share
from haptid.end_effector.compensation.sampled import Feedback, SampledLoop, filtered_difference

__all__ = [
    "PUBLISHED_RANGE",
    "STIFF_HAND",
    "TYPICAL_HAND",
    "Compensation",
    "CompensationDesign",
    "DesignPoint",
    "Feedback",
    "HandModel",
    "HandMotion",
    "InverseDynamics",
    "JudgedLaw",
    "SampledLoop",
    "design_compensation",
    "filtered_difference",
    "judge_law",
    "published_hands",
    "stable_share",
]
