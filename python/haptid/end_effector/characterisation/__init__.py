"""What the hand feels of a device: masses, friction, weight and forces at the handle, with their intervals."""

from haptid.end_effector.characterisation.apparent_mass import ApparentMass, apparent_mass
from haptid.end_effector.characterisation.characterise import Characterisation, characterise, line, sweep
from haptid.end_effector.characterisation.jacobian import Grasp
from haptid.end_effector.characterisation.model import Figure, GivenParameters, IdentifiedModel

__all__ = [
    "ApparentMass",
    "Characterisation",
    "Figure",
    "GivenParameters",
    "Grasp",
    "IdentifiedModel",
    "apparent_mass",
    "characterise",
    "line",
    "sweep",
]
