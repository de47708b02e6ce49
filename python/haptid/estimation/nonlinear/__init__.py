"""Constants of friction that the torque is not linear in, found by variable projection."""

from haptid.estimation.nonlinear.copies import EveryOther
from haptid.estimation.nonlinear.projected import Constant, VariableProjection, variable_projection

__all__ = ["Constant", "EveryOther", "VariableProjection", "variable_projection"]
