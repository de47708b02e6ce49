"""What a look that is not "ok" means, in words that need no statistics: for the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

PLAIN: Mapping[str, str] = MappingProxyType(
    {
        "units and signs": "the torque is not of the size or sign that the device file's bodies need",
        "time delay": "torque and motion are out of step in time",
        "influence": "one stretch of the log decides a parameter by itself",
        "drift": "parameters change along the log",
        "friction near standstill": "the model lacks how dry friction changes near standstill",
        "friction by direction": "the model lacks a constant torque or dry friction by direction",
        "viscosity by direction": "viscous friction differs by direction",
        "bent viscosity": "friction does not grow in proportion to velocity",
        "friction by load": "dry friction grows with the torque carried",
        "torque by position": "the model lacks a torque that depends on position",
        "ripple": "a torque repeats along the position (cogging or teeth)",
        "excitation": "the motion hardly tells some parameters from zero",
        "collinearity": "the motion hardly tells some parameters from one another",
        "errors in W": "noise or filtering of the positions biases parameters",
        "whiteness": "what the model leaves is no plain noise (a term may be missing)",
    }
)
