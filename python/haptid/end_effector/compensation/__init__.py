"""Compensation that a hand can hold: the law, its sampled loop, hands, and the search for settings."""

from haptid.end_effector.compensation.design import CompensationDesign, DesignPoint, design_compensation
from haptid.end_effector.compensation.hands import (
    PUBLISHED_RANGE,
    STIFF_HAND,
    TYPICAL_HAND,
    HandModel,
    HandMotion,
    published_hands,
)
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
    "SampledLoop",
    "design_compensation",
    "filtered_difference",
    "published_hands",
    "stable_share",
]
