"""PD or PID controller of the motors' coordinates, as it was active while a log was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array, expect, positive
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import DIFFERENCE_STEPS
from haptid.errors import SettingError
from haptid.log import Log, Signal, read_log
from haptid.motion.channels import position_map
from haptid.motion.motion import Motion

_Figures = float | Sequence[float]


@dataclass(frozen=True, eq=False)
class PID:
    """PID controller tau = kp e + kd ed + ki integral of e of every motor's coordinate, with zero-order hold.

    Attributes:
        kp, kd, ki: gains at the joint side, N m/rad, N m s/rad and N m/(rad s), or per m; one for all motors or one
            for each.
        reference: the planned motion of the active joints: channels of the log's own file, such as
            `Signal(("target1", "target2"), "rad")`; or arrays, (n, active) for each motion, rad or m; None takes the
            treated positions, where the plan was not recorded.
        rate_hz: of the controller, a multiple of the log's; None is the log's.
        velocity_cutoff_hz: the controller's velocity is the difference of positions through a first-order filter with
            this cut-off; None is the velocity itself.
        saturation: largest torque of a motor's coordinate, N m or N; None for no limit.
    """

    kp: _Figures
    kd: _Figures
    ki: _Figures = 0.0
    reference: Signal | Sequence[Array] | None = None
    rate_hz: float | None = None
    velocity_cutoff_hz: float | None = None
    saturation: _Figures | None = None

    def __post_init__(self) -> None:
        for name in ("rate_hz", "velocity_cutoff_hz"):
            value = getattr(self, name)
            if value is not None and not positive(value):
                raise _setting(name, value, "a finite number above zero, or leave it out")

    def figures(self, name: str, model: DynamicModel) -> Array:
        """A setting as one value for each motor, (motors,).

        Raises:
            SettingError: neither one value nor one for each motor, or one that is not finite.
        """
        values, motors = np.atleast_1d(np.asarray(getattr(self, name), dtype=float)), len(model.device.motors)
        if values.shape not in ((1,), (motors,)) or not np.isfinite(values).all():
            wanted = f"one finite value, or one for each of {', '.join(m.name for m in model.device.motors)}"
            raise _setting(name, values.tolist(), wanted)
        return np.ascontiguousarray(np.broadcast_to(values, (motors,)))

    def periods(self, dt: float) -> int:
        """Control periods per sampling period dt, s.

        Raises:
            SettingError: not a whole number.
        """
        ratio = 1.0 if self.rate_hz is None else self.rate_hz * dt
        if abs(ratio - round(ratio)) > 1e-3 or round(ratio) < 1:
            raise _setting("rate_hz", self.rate_hz, f"a multiple of the log's {1 / dt:g} Hz")
        return round(ratio)


def reference(law: PID, model: DynamicModel, motion: Motion, place: int) -> Array:
    """Planned positions of the coordinates that torque rows belong to, (n, samples), rad or m.

    Args:
        law: the controller.
        motion: at whose samples.
        place: index of the motion in the observation.

    Raises:
        SettingError: the log has no file to read them from, or the number of arrays is wrong.
        LogError: the channels cannot be read.
    """
    if law.reference is None:
        q = motion.q.T
        return position_map(model.device, motion)(q)
    if isinstance(law.reference, Signal):
        if motion.log is None or not motion.log.sha256:
            raise _setting("reference", "channels of a log", "arrays: this motion comes from no file")
        return np.asarray(model.device.row_map @ recorded(motion.log, law.reference))
    if place >= len(law.reference):
        raise _setting("reference", f"{len(law.reference)} arrays", "one for each motion of the observation")
    reference = np.asarray(law.reference[place], dtype=float)
    expect("reference", reference.shape, (len(motion), len(model.device.active)))
    return np.asarray(model.device.row_map @ reference.T)


def recorded(log: Log, wanted: Signal) -> Array:
    """Other position channels of a log's file, on the log's grid, (channels, n), rad or m."""
    log_of_reference = read_log(log.path, replace(log.channels, position=wanted))
    return np.array([np.interp(log.t, log_of_reference.t, channel) for channel in log_of_reference.position.T])


@dataclass(frozen=True, eq=False)
class MotorRates:
    """Positions of the motors' coordinates, and their Jacobian B by those of the rows, at many device states at once.

    Trailing axes of values are the states'; where B varies with the pose, there is one of them, and `by` has it.

    Attributes:
        model: the dynamic model.
        by: B at every state, (states, motors, n), or for all of them, (motors, n).
    """

    model: DynamicModel
    by: Array

    @staticmethod
    def at(model: DynamicModel, c: Array) -> MotorRates:
        """At positions of the rows' coordinates, (n, states)."""
        return MotorRates(model, model.device.drive_jacobian(c)[..., model.device.driven, :])

    @staticmethod
    def positions(model: DynamicModel, c: Array) -> Array:
        """Positions of the motors' coordinates, (motors, states), from those of the rows, (n, states), rad or m."""
        device = model.device
        if not device.drive_varies.any():
            return _by_matrix(device.drive_rates[device.driven], c)
        qa = np.asarray(np.linalg.solve(device.row_map, c), dtype=np.float64)
        return np.asarray(device.drive_rows[device.driven] @ device.closure.follow(qa).q)

    def of_motors(self, values: Array) -> Array:
        """B times values of the rows' coordinates, (n, states, ...)."""
        return _by_matrix(self.by, values) if self.by.ndim == 2 else np.einsum("smn,ns...->ms...", self.by, values)

    def of_rows(self, values: Array) -> Array:
        """B' times values of the motors, (motors, states, ...)."""
        return _by_matrix(self.by.T, values) if self.by.ndim == 2 else np.einsum("smn,ms...->ns...", self.by, values)

    def torque_in_total(self, rows: Array) -> Array:
        """Torques of the motors with the least sum of squares that load the rows as given, (n, states, ...)."""
        inverse = np.linalg.pinv(np.swapaxes(self.by, -1, -2))
        return MotorRates(self.model, np.swapaxes(inverse, -1, -2)).of_rows(rows)

    def changes(self, c: Array) -> Array | None:
        """Derivatives of B by the rows' coordinates at positions, (n, states): (n, states, motors, n); None if zero.

        By central differences.
        """
        if self.by.ndim == 2:
            return None
        step = DIFFERENCE_STEPS[0]
        sides = [
            [MotorRates.at(self.model, c + by * unit[:, None]).by for by in (step, -step)] for unit in np.eye(len(c))
        ]
        return np.array([(after - before) / (2 * step) for after, before in sides])


class ControllerState:
    """State of a controller on many device states at once; trailing axes are the states'.

    Except for saturation it is linear in the motors' coordinates, so the same code propagates sensitivities.
    """

    def __init__(self, law: PID, model: DynamicModel, period: float, d: Array, velocity: Array) -> None:
        """Without an integral at positions and velocities of the motors' coordinates, (motors, ...)."""
        self.kp, self.kd, self.ki = (law.figures(name, model) for name in ("kp", "kd", "ki"))
        self.limit = None if law.saturation is None else law.figures("saturation", model)
        self.keep = None
        if law.velocity_cutoff_hz is not None:
            self.keep = float(np.exp(-2 * np.pi * law.velocity_cutoff_hz * period))
        self.period, self.velocity, self.last = period, velocity, d - period * velocity
        self.integral = np.zeros_like(d)

    def settle(self, error: Array, rate: Array, total: Array) -> None:
        """Begin with the integral at which the torque is a total, (motors, ...), at errors of position and velocity."""
        proportional = _each(self.kp, error) + _each(self.kd, rate)
        self.integral = np.where(_each(self.ki, np.ones_like(error)) != 0, total - proportional, 0.0)

    def torque(
        self, d: Array, velocity: Array, target: Array | None, speed: Array | None, free: np.ndarray | None = None
    ) -> tuple[Array, np.ndarray]:
        """One control period: torque of each motor, (motors, ...), and which motors are not saturated.

        Args:
            d, velocity: of the motors' coordinates, (motors, ...); the velocity is not read where it is filtered.
            target, speed: planned; None for zero, as for sensitivities.
            free: which motors are not saturated, (motors, ...); None determines it from the limit.
        """
        if self.keep is not None:
            velocity = self.keep * self.velocity + (1 - self.keep) / self.period * (d - self.last)
        self.velocity, self.last = velocity, d
        error = -d if target is None else target - d
        rate = -velocity if speed is None else speed - velocity
        self.integral = self.integral + _each(self.period * self.ki, error)
        command = _each(self.kp, error) + _each(self.kd, rate) + self.integral
        if free is None:
            limit = np.inf if self.limit is None else _each(self.limit, np.ones_like(command))
            free = np.abs(command) < limit
            return np.clip(command, -limit, limit), free
        return np.where(free, command, 0.0), free


def _by_matrix(A: Array, values: Array) -> Array:
    """A times the values' first axis; a fifth of the time of `np.tensordot`, which counts in every control period."""
    return np.asarray((A @ values.reshape(len(values), -1)).reshape(len(A), *values.shape[1:]))


def _each(gains: Array, values: Array) -> Array:
    """Every motor's values multiplied by its gain."""
    return gains.reshape(-1, *[1] * (values.ndim - 1)) * values


def _setting(name: str, value: object, wanted: str) -> SettingError:
    """Error of a controller's setting."""
    return SettingError(f"controller: {name} is {value}; write {wanted}.", where=name, found=value, limit=wanted)
