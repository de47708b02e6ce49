"""The model at the end-effector: torque decomposition, hand-force estimation, compensation and characterisation.

It uses estimates and treated motions, and imports no study, report or experiment.
"""

from haptid.end_effector.characterisation import (
    ApparentMass,
    Characterisation,
    GivenParameters,
    apparent_mass,
    characterise,
)
from haptid.end_effector.compensation import Compensation, stable_share
from haptid.end_effector.definiteness import Definiteness, definiteness
from haptid.end_effector.force import HandleForce, estimate_force
from haptid.end_effector.momentum_observer import MomentumObserver, ObserverResult, observe_force
from haptid.end_effector.torque_decomposition import TorqueDecomposition, decompose_torque

__all__ = [
    "ApparentMass",
    "Characterisation",
    "Compensation",
    "Definiteness",
    "GivenParameters",
    "HandleForce",
    "MomentumObserver",
    "ObserverResult",
    "TorqueDecomposition",
    "apparent_mass",
    "characterise",
    "decompose_torque",
    "definiteness",
    "estimate_force",
    "observe_force",
    "stable_share",
]
