"""Friction identification at constant velocities: the friction curve of each joint, and the choice of its model."""

from haptid.experiment.friction_test.choice import FrictionChoice, choose_friction
from haptid.experiment.friction_test.curve import (
    ConstantVelocity,
    DirectionPairs,
    FrictionCurve,
    ModelSubtraction,
    friction_curve,
)

__all__ = [
    "ConstantVelocity",
    "DirectionPairs",
    "FrictionChoice",
    "FrictionCurve",
    "ModelSubtraction",
    "choose_friction",
    "friction_curve",
]
