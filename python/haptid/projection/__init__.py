"""Constants of friction that the torque is not linear in, found by variable projection."""

from haptid.projection.projected import Constant, Projection, variable_projection

__all__ = ["Constant", "Projection", "variable_projection"]
