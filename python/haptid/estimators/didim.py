"""DIDIM: the measured torque explained by the motion of the model under the same controller."""

from __future__ import annotations

from dataclasses import dataclass

from haptid._values import Array
from haptid.device import Device
from haptid.estimators.simulating import Simulating, along, treated_as
from haptid.observation import Observation


@dataclass(frozen=True)
class DIDIM(Simulating):
    """Direct and inverse dynamic identification models: Gauss-Newton on the torque of the simulated closed loop.

    The derivative of the simulated torque by the parameters is taken to be the columns of the inverse model at the
    simulated motion, so that a pass is least squares of the measured torque on them. The measured positions only
    begin each stretch: their noise is not in W.

    Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), eqs 27 to 33.
    """

    def restate(self, observation: Observation, smoothed: Device, beta: Array) -> Observation:
        """Measured torque, columns of the simulated motion."""
        courses = self.courses(observation, smoothed, beta)
        return along(observation, [treated_as(observation.device, course) for course in courses])
