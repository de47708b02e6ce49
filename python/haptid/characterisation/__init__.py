"""What the hand feels of a device: masses, friction, weight and forces at the handle, with their intervals."""

from haptid.characterisation.characterise import Characterisation, characterise, line, sweep
from haptid.characterisation.grasp import Grasp
from haptid.characterisation.masses import FeltMass, felt_mass
from haptid.characterisation.model import Figure, GivenModel, Model

__all__ = [
    "Characterisation",
    "FeltMass",
    "Figure",
    "GivenModel",
    "Grasp",
    "Model",
    "characterise",
    "felt_mass",
    "line",
    "sweep",
]
