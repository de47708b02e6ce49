"""Constants of friction that the torque is not linear in, found by variable projection."""

from haptid.projection.copies import EveryOther
from haptid.projection.projected import Constant, Projection, variable_projection

__all__ = ["Constant", "EveryOther", "Projection", "variable_projection"]
