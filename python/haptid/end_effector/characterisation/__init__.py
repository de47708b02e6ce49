"""Characterisation at the end-effector: apparent mass, friction, weight and forces, with confidence intervals."""

from haptid.end_effector.characterisation.apparent_mass import ApparentMass, apparent_mass
from haptid.end_effector.characterisation.characterise import Characterisation, characterise, line, sweep
from haptid.end_effector.characterisation.jacobian import HandleJacobian
from haptid.end_effector.characterisation.model import GivenParameters, IdentifiedModel

__all__ = [
    "ApparentMass",
    "Characterisation",
    "GivenParameters",
    "HandleJacobian",
    "IdentifiedModel",
    "apparent_mass",
    "characterise",
    "line",
    "sweep",
]
