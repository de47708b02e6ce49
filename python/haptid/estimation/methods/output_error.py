"""Output and input errors: Gauss-Newton on what the simulated model does, with its sensitivities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.dynamics.model import DynamicModel
from haptid.estimation.methods.didim import base_columns, torque_error
from haptid.estimation.methods.linearised import Linearised, gathered
from haptid.estimation.methods.simulating import ClosedLoop, treated_as
from haptid.motion.channels import state
from haptid.motion.treatment import Motion
from haptid.observation.observation import Observation
from haptid.simulation import Sensitivity, Steps, closed_loop, sensitivity


@dataclass(frozen=True)
class CLIE(ClosedLoop):
    """Closed-loop input error: the measured torque against that of the model under the same controller.

    As `DIDIM`, but with the torque's true derivatives, the controller's answer among them.

    Source: Brunot, Janot, Young and Carrillo (2018), Control Engineering Practice 74, section 3.
    """

    def restate(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of torque."""
        parts = []
        for motion, steps, made in self.varied(observation, smoothed, beta):
            assert made.tau is not None  # a closed loop
            error = torque_error(observation.model, steps.course(motion))
            parts.append(Linearised(motion, error, steps.stretches.joined(made.tau)))
        return gathered(observation, beta, parts, [motor.unit for motor in observation.motors])

    def varied(
        self, observation: Observation, smoothed: DynamicModel, beta: Array
    ) -> list[tuple[Motion, Steps, Sensitivity]]:
        """Every motion, what the model does along it, and how that depends on the base parameters."""
        model = observation.model
        forward = ForwardDynamics(smoothed, sets_of(model, beta))
        base = base_columns(model)
        made = []
        for place, motion in enumerate(observation.motions):
            steps = closed_loop(forward, self.law, motion, place, self.stretches(motion))
            made.append((motion, steps, sensitivity(forward, self.law, motion, steps, base)))
        return made


@dataclass(frozen=True)
class CLOE(CLIE):
    """Closed-loop output error: the measured positions against those of the model under the same controller.

    A stiff controller leaves little of the parameters in the positions: what it does leave is torque over gain, and
    must be seen above the noise of the encoders. The treated positions are compared.

    Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section II.C.
    """

    def restate(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of position."""
        model = observation.model
        parts = []
        for motion, steps, made in self.varied(observation, smoothed, beta):
            again = treated_as(model, steps.course(motion))
            low, high = motion.usable
            error = np.zeros((len(model.device.row_names), len(motion)))
            error[:, low:high] = state(model.device, motion, low, high)[0] - state(model.device, again, low, high)[0]
            parts.append(Linearised(motion, error, steps.stretches.joined(made.c)))
        names = [model.device.row_names.index(motor.name) for motor in observation.motors]
        return gathered(observation, beta, parts, [model.device.coordinate_units[k] for k in names])
