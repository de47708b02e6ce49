"""Models nonlinear in some constants: variable projection, and friction that depends on the load."""

from haptid.estimation.nonlinear.candidate_columns import AlternateBlocks
from haptid.estimation.nonlinear.load_friction import fit_load_friction
from haptid.estimation.nonlinear.variable_projection import SearchedConstant, VariableProjection, variable_projection

__all__ = ["AlternateBlocks", "SearchedConstant", "VariableProjection", "fit_load_friction", "variable_projection"]
