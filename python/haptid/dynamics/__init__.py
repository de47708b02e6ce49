"""Dynamic models: base parameters, regressor, inverse and forward dynamics, kinematics and workspace of a device.

It depends on devices and on numbers (a pose, a motion, parameter values), not on logs or estimates.
"""

from haptid.dynamics.base_parameters import BaseParameters, base_parameters
from haptid.dynamics.inverse import bias_torque, gravity_torque, inverse_dynamics, mass_matrix
from haptid.dynamics.kinematics import HandleMotion, handle_motion, link_poses
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.static import StaticModel, static_model
from haptid.dynamics.workspace import Box, Workspace, workspace

__all__ = [
    "BaseParameters",
    "Box",
    "DynamicModel",
    "HandleMotion",
    "StaticModel",
    "Workspace",
    "base_parameters",
    "bias_torque",
    "gravity_torque",
    "handle_motion",
    "inverse_dynamics",
    "link_poses",
    "mass_matrix",
    "static_model",
    "workspace",
]
