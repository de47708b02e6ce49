"""DIDIM: the measured torque explained by the motion of the model under the same controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import columns
from haptid.estimation.methods.linearised import Linearised, gathered
from haptid.estimation.methods.simulating import ClosedLoop
from haptid.motion.channels import coordinate_torque
from haptid.motion.streaming import delayed
from haptid.observation.observation import Observation
from haptid.simulation import Course


@dataclass(frozen=True)
class DIDIM(ClosedLoop):
    """Direct and inverse dynamic identification models: Gauss-Newton on the torque of the simulated closed loop.

    The derivative of the simulated torque by the parameters is taken to be the columns of the inverse model at the
    simulated motion: the controller makes that motion follow the planned one, whatever the parameters. The measured
    positions only begin each stretch; W has neither their noise nor their filter.

    Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III.
    """

    def restate(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of torque on columns of the simulated motion."""
        base, parts = base_columns(observation.model), []
        for course in self.courses(observation, smoothed, beta):
            slope = columns(smoothed, course.c, course.cd, course.cdd, base)
            parts.append(Linearised(course.motion, torque_error(observation.model, course), slope))
        return gathered(observation, beta, parts, [motor.unit for motor in observation.motors])


def base_columns(model: DynamicModel) -> Array:
    """The core's columns from base parameters, (r, p)."""
    return np.asarray(model.device.parameters.S[:, list(model.base.independent_columns)])


def torque_error(model: DynamicModel, course: Course) -> Array:
    """Measured less simulated torque, treated alike, (n, samples), N m or N."""
    motion = course.motion
    late = motion.treatment.torque_delay_s / motion.dt if motion.log else 0.0
    simulated = delayed(course.tau.T, late).T if late else course.tau
    return coordinate_torque(model.device, motion, 0, len(motion)) - simulated
