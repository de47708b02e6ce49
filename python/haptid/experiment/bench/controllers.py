"""Laws of control made of exported C, for the bench: what the code does for a device, once every control period."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.compiled_code import Compiled
from haptid.experiment.bench.trajectories import Figures, Trajectory, spread

# What a law tells of every period: the torque of the hand that its observer sees, (coordinates,), N m or N.
Tell = Callable[[Array], None]
Step = Callable[[float, Array], Array]


@dataclass(frozen=True, eq=False)
class Assistance:
    """Weight and friction taken off the hand.

    Attributes:
        model: whose positions are measured.
        code: of its model.
        weight: share of what holds the device still, gravity, springs and offsets, that the motors carry.
        friction: share of friction that they overcome.
        velocity_cutoff_hz: of the code's differentiator.
    """

    model: DynamicModel
    code: Compiled
    weight: float = 1.0
    friction: float = 0.9
    velocity_cutoff_hz: float = 50.0

    def begin(self, dt: float) -> Step:
        """The law from rest."""
        velocity = self.code.differentiator(self.velocity_cutoff_hz, dt)
        frame, to_motors = self.model.device.row_map, motors_of(self.model)
        still = np.zeros(len(frame))

        def step(_t: float, qa: Array) -> Array:
            q = frame @ qa
            friction = self.code.friction_compensation(velocity(q), self.friction)
            resting = self.code("gravity", q)["tau"] + self.code("terms", q, still)["tau"]
            return np.asarray(to_motors @ (self.weight * resting + friction))

        return step


@dataclass(frozen=True, eq=False)
class Tracking:
    """PD on a planned motion, with the model's torque of that motion added, and the hand observed.

    With a share of 1 this is computed torque with constant gains (Murray, Li and Sastry 1994, A Mathematical
    Introduction to Robotic Manipulation, ch. 4, section 5.3); with 0 it is the PD alone.

    Attributes:
        model: whose positions are measured.
        code: of its model.
        trajectory: the planned motion, at the control rate.
        kp, kd: gains on the motors' coordinates, N m/rad and N m s/rad; one for all or one for each.
        share: of the model's torque.
        velocity_cutoff_hz: of the code's differentiator.
        gain: of the observer, rad/s.
        tell: called every period with what the observer sees.
    """

    model: DynamicModel
    code: Compiled
    trajectory: Trajectory
    kp: Figures
    kd: Figures
    share: float = 1.0
    velocity_cutoff_hz: float = 50.0
    gain: float = 40.0
    tell: Tell | None = None

    def begin(self, dt: float) -> Step:
        """The law from rest."""
        code, frame, to_motors = self.code, self.model.device.row_map, motors_of(self.model)
        names = [drive.name for drive in self.model.device.motors]
        kp, kd = spread("kp", self.kp, names), spread("kd", self.kd, names)
        to_coordinates = np.linalg.pinv(to_motors)
        driven = np.linalg.pinv(to_motors.T)  # rates of the motors' coordinates by those of the torque rows
        # The plan goes through the same filter as the encoders, so that its lag makes no error.
        velocity, planned_velocity = (code.differentiator(self.velocity_cutoff_hz, dt) for _ in range(2))
        observe = code.observer(self.gain, dt)
        planned = [x @ frame.T for x in (self.trajectory.q, self.trajectory.qd, self.trajectory.qdd)]

        def step(t: float, qa: Array) -> Array:
            q, k = frame @ qa, min(round(t / dt), len(self.trajectory) - 1)
            qd, (wanted, rate, acceleration) = velocity(q), (x[k] for x in planned)
            error, slow = driven @ (wanted - q), driven @ (planned_velocity(wanted) - qd)
            feedforward = code("inverse_dynamics", q, rate, acceleration)["tau"] + code("terms", q, rate)["tau"]
            tau = kp * error + kd * slow + self.share * (to_motors @ feedforward)
            if self.tell is not None:
                self.tell(observe(q, qd, to_coordinates @ tau))
            return np.asarray(tau)

        return step


def motors_of(model: DynamicModel) -> Array:
    """From torques of the torque rows to those of the motors' coordinates, (motors, coordinates)."""
    return np.asarray(np.linalg.inv(model.device.drive_rates).T[[drive.motorised for drive in model.device.drives]])
