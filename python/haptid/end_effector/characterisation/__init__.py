"""Characterisation at the end-effector: apparent mass, friction, weight and forces, with confidence intervals."""

from haptid.end_effector.characterisation.apparent_mass import FeltMass, felt_mass
from haptid.end_effector.characterisation.characterise import Characterisation, characterise, line, sweep
from haptid.end_effector.characterisation.jacobian import Grasp
from haptid.end_effector.characterisation.model import GivenModel, IdentifiedModel

__all__ = [
    "Characterisation",
    "FeltMass",
    "GivenModel",
    "Grasp",
    "IdentifiedModel",
    "characterise",
    "felt_mass",
    "line",
    "sweep",
]
