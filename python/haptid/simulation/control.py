"""PD or PID controller of the motors' coordinates, as it was active while a log was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array, expect, positive
from haptid.dynamics.model import DynamicModel
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
    given = np.asarray(law.reference[place], dtype=float)
    expect("reference", given.shape, (len(motion), len(model.device.active)))
    return np.asarray(model.device.row_map @ given.T)


def recorded(log: Log, wanted: Signal) -> Array:
    """Other position channels of a log's file, on the log's grid, (channels, n), rad or m."""
    whole = read_log(log.path, replace(log.channels, position=wanted))
    return np.array([np.interp(log.t, whole.t, channel) for channel in whole.position.T])


@dataclass(frozen=True, eq=False)
class InitialState:
    """Initial state of a controller, of the coordinates, each (n, ...), SI.

    Attributes:
        c, cd: positions and velocities.
        target, speed: planned.
        static: torque that the controller exerts in total, which determines its integral.
    """

    c: Array
    cd: Array
    target: Array
    speed: Array
    static: Array


class ControllerState:
    """State of a controller on many device states at once; trailing axes are the states'.

    Except for saturation it is linear, so the same code propagates sensitivities.
    """

    def __init__(self, law: PID, model: DynamicModel, period: float, start: InitialState) -> None:
        """Start in the stationary state of the initial torque."""
        if model.device.drive_varies.any():
            raise SettingError(
                f"controller: motors of {model.device.name} are on passive joints whose rates vary with the pose; the "
                "simulated controller requires constant ones.",
                where="controller",
                found=model.device.name,
                advice="Use a method that simulates no controller, such as wls, torque-noise, iv or output-error.",
            )
        self.rates = np.asarray(model.device.drive_rates[model.device.driven])
        self.kp, self.kd, self.ki = (law.figures(name, model) for name in ("kp", "kd", "ki"))
        self.limit = None if law.saturation is None else law.figures("saturation", model)
        self.keep = None
        if law.velocity_cutoff_hz is not None:
            self.keep = float(np.exp(-2 * np.pi * law.velocity_cutoff_hz * period))
        self.period = period
        d, self.velocity = self.drives(start.c), self.drives(start.cd)
        self.last = d - period * self.velocity
        self.integral = np.zeros_like(d)
        if self.ki.any():
            error, rate = self.drives(start.target) - d, self.drives(start.speed) - self.velocity
            total = np.tensordot(np.linalg.pinv(self.rates.T), start.static, 1)
            proportional = _each(self.kp, error) + _each(self.kd, rate)
            self.integral = np.where(_each(self.ki, np.ones_like(d)) != 0, total - proportional, 0.0)

    def drives(self, c: Array) -> Array:
        """Coordinates of the motorised drives, (motors, ...)."""
        return _by_matrix(self.rates, c)

    def torque(
        self, c: Array, cd: Array, target: Array | None, speed: Array | None, free: np.ndarray | None = None
    ) -> tuple[Array, np.ndarray]:
        """One control period: torque of the coordinates, (n, ...), and which motors are not saturated.

        Args:
            c, cd: positions and velocities, (n, ...).
            target, speed: planned; None for zero, as for sensitivities.
            free: which motors are not saturated, (motors, ...); None determines it from the limit.
        """
        d = self.drives(c)
        if self.keep is None:
            velocity = self.drives(cd)
        else:
            velocity = self.keep * self.velocity + (1 - self.keep) / self.period * (d - self.last)
        self.velocity, self.last = velocity, d
        error = -d if target is None else self.drives(target) - d
        rate = -velocity if speed is None else self.drives(speed) - velocity
        self.integral = self.integral + _each(self.period * self.ki, error)
        command = _each(self.kp, error) + _each(self.kd, rate) + self.integral
        if free is None:
            limit = np.inf if self.limit is None else _each(self.limit, np.ones_like(command))
            free = np.abs(command) < limit
            command = np.clip(command, -limit, limit)
        else:
            command = np.where(free, command, 0.0)
        return _by_matrix(self.rates.T, command), free


def _by_matrix(A: Array, values: Array) -> Array:
    """A times the values' first axis; a fifth of the time of `np.tensordot`, which counts in every control period."""
    return np.asarray((A @ values.reshape(len(values), -1)).reshape(len(A), *values.shape[1:]))


def _each(gains: Array, values: Array) -> Array:
    """Every motor's values multiplied by its gain."""
    return gains.reshape(-1, *[1] * (values.ndim - 1)) * values


def _setting(name: str, value: object, wanted: str) -> SettingError:
    """Error of a controller's setting."""
    return SettingError(f"controller: {name} is {value}; write {wanted}.", where=name, found=value, limit=wanted)
