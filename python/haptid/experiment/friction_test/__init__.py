"""Friction identification at constant velocities: the friction curve of each joint, and the choice of its model."""

from haptid.experiment.friction_test.choice import FrictionChoice, choose_friction
from haptid.experiment.friction_test.curve import (
    ConstantVelocity,
    FrictionCurve,
    friction_curve,
)

__all__ = [
    "ConstantVelocity",
    "FrictionChoice",
    "FrictionCurve",
    "choose_friction",
    "friction_curve",
]
