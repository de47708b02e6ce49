"""Control laws on exported C code, for the bench: compensation of weight and friction, and computed-torque tracking."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.compiled_code import Compiled
from haptid.experiment.bench.trajectories import Figures, Trajectory, per_coordinate

_Step = Callable[[float, Array], Array]


@dataclass(frozen=True, eq=False)
class Assistance:
    """Gravity and friction compensation.

    Attributes:
        model: of the device on the bench.
        code: the exported model.
        weight: share of the static torque (gravity, springs, offsets) that the motors compensate.
        friction: share of the friction that they compensate.
        velocity_cutoff_hz: of the code's differentiator.
    """

    model: DynamicModel
    code: Compiled
    weight: float = 1.0
    friction: float = 0.9
    velocity_cutoff_hz: float = 50.0

    def begin(self, dt: float) -> _Step:
        """See TorqueLaw."""
        velocity = self.code.differentiator(self.velocity_cutoff_hz, dt)
        frame = self.model.device.row_map
        still, to_motors = np.zeros(len(frame)), motor_map(self.model)

        def step(_t: float, qa: Array) -> Array:
            q = frame @ qa
            friction = self.code.friction_compensation(velocity(q), self.friction)
            static = self.code("gravity", q)["tau"] + self.code("terms", q, still)["tau"]
            return np.asarray(to_motors(q) @ (self.weight * static + friction))

        return step


@dataclass(frozen=True, eq=False)
class Tracking:
    """PD tracking of a planned motion with the model's torque as feedforward, and a momentum observer.

    With a share of 1 this is computed torque with constant gains (Murray, Li and Sastry 1994, A Mathematical
    Introduction to Robotic Manipulation, ch. 4, section 5.3); with 0 it is the PD alone.

    Attributes:
        model: of the device on the bench.
        code: the exported model.
        trajectory: the planned motion, at the control rate.
        kp, kd: gains on the motor coordinates, N m/rad and N m s/rad; one for all or one for each.
        share: of the model's torque that is fed forward.
        velocity_cutoff_hz: of the code's differentiator.
        gain: of the observer, rad/s.
        report: called every period with the observed torque of the hand, (coordinates,), N m or N.
    """

    model: DynamicModel
    code: Compiled
    trajectory: Trajectory
    kp: Figures
    kd: Figures
    share: float = 1.0
    velocity_cutoff_hz: float = 50.0
    gain: float = 40.0
    report: Callable[[Array], None] | None = None

    def begin(self, dt: float) -> _Step:
        """See TorqueLaw."""
        code, device = self.code, self.model.device
        frame = device.row_map
        names = [drive.name for drive in self.model.device.motors]
        kp, kd = per_coordinate("kp", self.kp, names), per_coordinate("kd", self.kd, names)
        # The planned motion passes the same filter as the encoders, so that its lag cancels in the error.
        velocity, planned_velocity = (code.differentiator(self.velocity_cutoff_hz, dt) for _ in range(2))
        observe, to_motors = code.observer(self.gain, dt), motor_map(self.model)
        planned = [x @ frame.T for x in (self.trajectory.q, self.trajectory.qd, self.trajectory.qdd)]

        def step(t: float, qa: Array) -> Array:
            q, k = frame @ qa, min(round(t / dt), len(self.trajectory) - 1)
            qd, (target, rate, acceleration) = velocity(q), (x[k] for x in planned)
            rates = device.drive_jacobian(q[:, None])
            driven = np.squeeze(rates[..., device.driven, :])
            error, error_rate = driven @ (target - q), driven @ (planned_velocity(target) - qd)
            feedforward = code("inverse_dynamics", q, rate, acceleration)["tau"] + code("terms", q, rate)["tau"]
            tau = kp * error + kd * error_rate + self.share * (to_motors(q) @ feedforward)
            if self.report is not None:
                self.report(observe(q, qd, driven.T @ tau))
            return np.asarray(tau)

        return step


def motor_map(model: DynamicModel) -> Callable[[Array], Array]:
    """Map from torques of the torque rows to those of the motor coordinates, without preload, (motors, coordinates).

    A function of the rows' coordinates, (active,).
    """
    device = model.device

    def at(c: Array) -> Array:
        shares = device.law.shares(device.drive_jacobian(c[:, None]))
        return np.asarray((shares[0] if shares.ndim == 3 else shares)[device.driven])

    if device.drive_varies.any():
        return at
    constant = at(np.zeros(len(device.active)))
    return lambda _c: constant
