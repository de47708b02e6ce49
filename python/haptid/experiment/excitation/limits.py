"""Constraints of an exciting motion: relative violation of every limit, and its gradient."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TypeVar

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device import CollisionShape, Joint, NewtonClosure
from haptid.device.loops.pins import Pins
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import DIFFERENCE_STEPS, CoreChannels
from haptid.errors import IncompleteDeviceError, SettingError, TrajectoryError
from haptid.experiment.bench.limits import FLAT, loop_conditioning
from haptid.experiment.bench.trajectories import Figures, per_coordinate
from haptid.experiment.collision import CollisionModel, clearance_along
from haptid.experiment.excitation.actuation import Actuation

T = TypeVar("T")
# Planned distance from flat loops, relative to the minimum of the bench.
_MARGIN = 1.2
# Name of the limit of loops in errors.
FLAT_LOOPS = "the distance of a loop from flat"


@dataclass(frozen=True)
class Coupling:
    """Limits of a linear combination of active joints, such as the angle between two bars.

    Attributes:
        weights: of each active joint.
        low, high: rad or m.
    """

    weights: Figures
    low: float
    high: float


@dataclass(frozen=True)
class Limits:
    """Limits of a motion; position and speed default to those of the device file.

    Attributes:
        position: lowest and highest of each active joint, rad or m.
        speed: maximum of each active joint, rad/s or m/s; one for all or one for each.
        acceleration: maximum of each active joint, rad/s^2 or m/s^2; unlimited by default.
        torque: maximum of each torque row, N m or N, computed from base parameters; unlimited by default.
        jerk: maximum of each active joint, rad/s^3 or m/s^3.
        rms_torque: maximum root mean square of each torque row over the motion, N m or N: what heats the motors.
        power: maximum of |torque times velocity| of each torque row, W.
        handle_force: maximum force at the handle that the motors' torques are equivalent to, N.
        torque_confidence: probability with which torques keep their maximum, at every sample, given the covariance of
            the base parameters; None takes the parameters as exact.
        couplings: limits of combinations of active joints.
        conditioning: minimum distance of a loop from its singular configuration: see `bench.loop_conditioning`.
        clearance: minimum distance between the collision shapes of the device, and from those of the world, m.
        world: shapes about the device: see `haptid.device.read_world`.
    """

    position: tuple[tuple[float, float], ...] | None = None
    speed: Figures | None = None
    acceleration: Figures | None = None
    torque: Figures | None = None
    jerk: Figures | None = None
    rms_torque: Figures | None = None
    power: Figures | None = None
    handle_force: float | None = None
    torque_confidence: float | None = None
    couplings: tuple[Coupling, ...] = ()
    conditioning: float = _MARGIN * FLAT
    clearance: float = 0.01
    world: tuple[CollisionShape, ...] = ()

    def __post_init__(self) -> None:
        if self.torque_confidence is not None and not 0.5 <= self.torque_confidence < 1:
            raise SettingError(
                f"Limits: torque_confidence is {self.torque_confidence!r}; write a probability from 0.5 to below 1.",
                where="torque_confidence",
                found=self.torque_confidence,
            )
        if not 0 <= self.clearance < np.inf:
            raise SettingError(
                f"Limits: clearance is {self.clearance!r}; write a distance in m, 0 or more.",
                where="clearance",
                found=self.clearance,
            )


@dataclass(frozen=True, eq=False)
class MotionBounds:
    """Limits of one device as arrays.

    Attributes:
        position: lowest and highest of each active joint, (active, 2), rad or m.
        speed: maximum, (active,).
        acceleration: maximum, (active,); infinite where there is no limit.
        limits: the limits they come from, with couplings and conditioning.
        beta: base parameters for the torques, (p,), SI.
        jerk: maximum, (active,); infinite where there is no limit.
        actuation: limits of torques, powers and the force at the handle.
    """

    model: DynamicModel
    position: Array
    speed: Array
    acceleration: Array
    limits: Limits
    beta: Array
    jerk: Array
    actuation: Actuation

    def __post_init__(self) -> None:
        active, p = len(self.model.device.active), len(self.model.base)
        freeze_fields(self, "speed", "acceleration", "jerk", position=(active, 2), beta=(p,))

    @cached_property
    def names(self) -> list[str]:
        """Names of the active joints."""
        return [self.model.device.joints[j].name for j in self.model.device.active]

    @staticmethod
    def of(model: DynamicModel, limits: Limits, beta: Array, covariance: Array | None = None) -> MotionBounds:
        """Limits as given, else those of the device.

        Args:
            limits: as given.
            beta: base parameters, (p,), SI.
            covariance: of their errors, (p, p); with `torque_confidence` the prior's where None.

        Raises:
            SettingError: a joint has no room to move; a confidence of torques without their maximum, or without a
                covariance.
            IncompleteDeviceError: a joint has no range of positions or no maximum speed in either.
            TrajectoryError: nothing drives a joint, so that it does not follow a planned motion.
            ExperimentError: not one value for all joints or one for each.
        """
        joints = [model.device.joints[j] for j in model.device.active]
        names = [joint.name for joint in joints]
        if free := ", ".join(drive.name for drive in model.device.drives if drive.free):
            raise TrajectoryError(
                f"nothing drives {free}: how the others' motion moves it follows from the parameters that are to be "
                "identified, and cannot be planned.",
                where=free,
                advice="Let the driven joints follow a motion that makes it swing, at several speeds.",
            )
        position, speed = limits.position, limits.speed
        if position is None:
            position = tuple(_given("range of positions", j.name, j.position_limits) for j in joints)
        if speed is None:
            speed = tuple(_given("maximum speed", j.name, j.velocity_limit) for j in joints)
        given = {"speed": speed, "acceleration": limits.acceleration, "jerk": limits.jerk}
        rates = {what: per_coordinate(what, most or (np.inf,), names) for what, most in given.items()}
        _check_room(names, position, rates)
        return MotionBounds(
            model,
            np.array(position, dtype=float),
            rates["speed"],
            rates["acceleration"],
            limits,
            beta,
            rates["jerk"],
            Actuation.of(
                model,
                beta,
                torque=limits.torque,
                rms_torque=limits.rms_torque,
                power=limits.power,
                handle_force=limits.handle_force,
                confidence=limits.torque_confidence,
                covariance=covariance,
            ),
        )

    def by_sample(self, states: Array) -> Iterator[tuple[Array, str]]:
        """Relative violations at every sample, (n,) each: see `violations`."""
        return zip(*self.violations(states), strict=True)

    def violations(self, states: Array) -> tuple[Array, tuple[str, ...]]:
        """Relative violations at every sample, without flat loops, (limits, n), and the names of the limits.

        Args:
            states: positions, velocities and accelerations of the active joints, (3, active, n).
        """
        rows, centre, width, middle = self._ranges
        of_joints = states.reshape(-1, states.shape[2])[rows] - centre
        np.abs(of_joints, out=of_joints)
        of_joints /= width
        of_joints -= middle
        for j in self._endless:
            of_joints[j] = _beyond(states[0, j], *self.position[j])
        couplings = (
            (_beyond(np.array(c.weights) @ states[0], c.low, c.high), f"the coupling {c.weights}")
            for c in self.limits.couplings
        )
        others = [*couplings, *self._passive(states), *self.actuation.by_sample(states)]
        made = np.concatenate([of_joints, *(excess[None] for excess, _ in others)]) if others else of_joints
        return made, self._names_of_joints + tuple(name for _, name in others)

    def gradients(self, states: Array, weights: Array) -> Array:
        """Gradient by states, (3, active, n), of the weighted sum of all violations of `by_sample`.

        Args:
            states: as for `by_sample`.
            weights: (limits, n).
        """
        made, rest = np.zeros_like(states), iter(weights)
        low, high = self.position.T[:, :, None]
        made[0] = _next(rest, len(low)) * _outwards(states[0], low, high)
        for s, most, joints, _ in self._rates:
            made[s, joints] = _next(rest, len(most)) * np.sign(states[s, joints]) / most
        for c in self.limits.couplings:
            made[0] += np.outer(c.weights, next(rest) * _outwards(np.array(c.weights) @ states[0], c.low, c.high))
        self._passive_slopes(states, rest, made)
        return made + self.actuation.gradients(states, rest)

    @cached_property
    def _labels(self) -> tuple[list[str], ...]:
        """Names of the limits of position, speed and acceleration of each active joint."""
        return tuple([f"the {what} of joint {n}" for n in self.names] for what in ("position", "speed", "acceleration"))

    @cached_property
    def _rates(self) -> list[tuple[int, Array, slice | list[int], list[str]]]:
        """Limits of speeds and accelerations: which state, maximum, (k, 1), of which joints, names."""
        made = list[tuple[int, Array, slice | list[int], list[str]]]()
        for s, limits in ((1, self.speed), (2, self.acceleration)):
            limited = np.flatnonzero(np.isfinite(limits)).tolist()
            joints = slice(None) if len(limited) == len(limits) else limited
            if limited:
                made.append((s, limits[limited, None], joints, [self._labels[s][j] for j in limited]))
        return made

    @cached_property
    def _ranges(self) -> tuple[slice | np.ndarray, Array, Array, Array]:
        """Limits of the joints' states as ranges: which rows of them, middle, what a violation is relative to, and the
        distance from the middle at which it begins, relative to that, (k, 1)."""
        many, position = len(self.names), self.position.copy()
        position[self._endless] = -1.0, 1.0  # no middle: see `violations`
        low, high = position.T[:, :, None]
        kinds = [(np.arange(many), 0.5 * (low + high), high - low, np.full((many, 1), 0.5))]
        for s, most, joints, _ in self._rates:
            kinds.append((s * many + np.arange(many)[joints], np.zeros_like(most), most, np.ones_like(most)))
        rows, centre, width, middle = (np.concatenate(parts) for parts in zip(*kinds, strict=True))
        return slice(None) if len(rows) == 3 * many else rows, centre, width, middle

    @cached_property
    def _endless(self) -> list[int]:
        """The active joints without a lowest or a highest position."""
        return np.flatnonzero(~np.isfinite(self.position).all(axis=1)).tolist()

    @cached_property
    def _jerking(self) -> list[int]:
        """The active joints whose jerk is limited."""
        return np.flatnonzero(np.isfinite(self.jerk)).tolist()

    @cached_property
    def _names_of_joints(self) -> tuple[str, ...]:
        """Of the limits of positions, velocities and accelerations, which come first."""
        return (*self._labels[0], *(label for *_, labels in self._rates for label in labels))

    @property
    def of_joints(self) -> int:
        """How many limits of `by_sample` are those of positions, velocities and accelerations, which come first."""
        return len(self._names_of_joints)

    def over_time(self, states: Array, dt: float) -> list[tuple[Array, str]]:
        """Relative violations that take several samples: jerk between samples, (n - 1,), and rms torques, (1,).

        Args:
            states: as for `by_sample`.
            dt: sampling period, s.
        """
        made = [
            (np.abs(np.diff(states[2, j])) / dt / self.jerk[j] - 1, f"the jerk of joint {self.names[j]}")
            for j in self._jerking
        ]
        return made + self.actuation.over_time(states)

    def over_time_gradients(self, states: Array, dt: float, weights: list[Array]) -> Array:
        """Gradient by states, (3, active, n), of the weighted sum of all violations of `over_time`."""
        made, rest = np.zeros_like(states), iter(weights)
        for j in self._jerking:
            slope = next(rest) * np.sign(np.diff(states[2, j])) / (dt * self.jerk[j])
            made[2, j, 1:] += slope
            made[2, j, :-1] -= slope
        return made + self.actuation.over_time_gradients(states, rest)

    def _passive_slopes(self, states: Array, rest: Iterator[Array], made: Array) -> None:
        """Add the gradient of passive joints' violations; a rate changes with a coordinate as along the motion."""
        if not self._limited_passive:
            return
        followed = self.model.device.closure.follow(states[0], states[1])
        qd = followed.velocity(states[1])
        shape = (states.shape[2], *followed.G.shape[-2:])
        G, Gd = (np.broadcast_to(x, shape).transpose(1, 2, 0) for x in (followed.G, followed.Gd))
        for k, joint in self._limited_passive:
            if joint.position_limits is not None:
                made[0] += G[k] * (next(rest) * _outwards(followed.q[k], *joint.position_limits))
            if joint.velocity_limit is not None:
                by_rate = next(rest) * np.sign(qd[k]) / joint.velocity_limit
                made[0] += Gd[k] * by_rate
                made[1] += G[k] * by_rate

    def channels(self, states: Array) -> CoreChannels:
        """Input channels of the core for states of the active joints, (3, active, n)."""
        return CoreChannels.of(self.model, self.model.device.row_map @ states)

    @cached_property
    def collision(self) -> CollisionModel | None:
        """The clearance of collision shapes; None where neither the device nor the world has any."""
        if not self.model.device.collision and not self.limits.world:
            return None
        return CollisionModel.of(self.model, self.limits.world)

    def check_start(self, q: Array) -> None:
        """Raise TrajectoryError if a pose of rest is outside the limits of positions, or too near a collision."""
        for name, (low, high), x in zip(self.names, self.position, q.tolist(), strict=True):
            if not low <= x <= high:
                raise TrajectoryError(
                    f"the start pose has joint {name} at {x:.4g}, outside its range from {low:.4g} to {high:.4g}.",
                    where=name,
                    found=x,
                    limit=(low, high),
                    advice="Start elsewhere, or widen the range.",
                )
        if self.collision is None:
            return
        found, least = clearance_along(self.collision, q[None], 1.0), self.limits.clearance
        if found.distance < least:
            state = f"overlap by {-1e3 * found.distance:.4g} mm" if found.distance < 0 else "are too near"
            raise TrajectoryError(
                f"in the start pose {found.pair} {state}: their distance is {1e3 * found.distance:.4g} mm; the limit "
                f"is {1e3 * least:.4g} mm.",
                where=found.pair,
                found=found.distance,
                limit=least,
                advice="Start elsewhere, lower the clearance, correct the shapes, or let one `ignore` the other's "
                "link.",
            )

    @cached_property
    def _limited_passive(self) -> list[tuple[int, Joint]]:
        """Indices and data of the passive joints that have limits."""
        passive = [(k, joint) for k, joint in enumerate(self.model.device.joints) if k not in self.model.device.active]
        return [(k, j) for k, j in passive if j.position_limits is not None or j.velocity_limit is not None]

    def _passive(self, states: Array) -> Iterator[tuple[Array, str]]:
        """Violations of the passive joints' limits."""
        if not self._limited_passive:
            return
        followed = self.model.device.closure.follow(states[0], states[1])
        q, qd = followed.q, followed.velocity(states[1])
        for k, joint in self._limited_passive:
            if joint.position_limits is not None:
                yield _beyond(q[k], *joint.position_limits), f"the position of joint {joint.name}"
            if joint.velocity_limit is not None:
                yield np.abs(qd[k]) / joint.velocity_limit - 1, f"the speed of joint {joint.name}"

    def flatness(self, q: Array) -> Array:
        """Relative violation of the least distance from flat loops, (n,), from active positions, (active, n)."""
        q_tree = self.model.device.closure.positions(q).T
        return np.asarray(1 - loop_conditioning(self.model, q_tree) / self.limits.conditioning)

    @cached_property
    def loops(self) -> LoopLimit | None:
        """The least distance from flat loops; None where none can become flat."""
        closure = self.model.device.closure
        pins = closure if isinstance(closure, NewtonClosure) else Pins.of(self.model.device)
        return None if pins is None else LoopLimit(pins, self.limits.conditioning)


@dataclass(frozen=True, eq=False)
class LoopLimit:
    """Least distance of loops from flat.

    Attributes:
        loops: pins of linear loops, or loops whose rates vary.
        least: distance, as of `bench.loop_conditioning`.
    """

    loops: Pins | NewtonClosure
    least: float

    def violated(self, q: Array, margin: float) -> tuple[np.ndarray, Array, Callable[[], Array]]:
        """Where the relative violation is above minus a margin, (n,), what it is there, (k,), and its slopes.

        Args:
            q: positions of the active joints, (active, n), rad or m.
            margin: relative to the limit.

        Returns:
            The last as a function, of derivatives by the active joints, (active, k).
        """
        enough = (1 + margin) * self.least
        if isinstance(self.loops, Pins):
            found = self.loops.at(q, enough)
            return found.small, 1 - found.conditioning[found.small] / self.least, lambda: -found.slopes() / self.least
        distance = self._of_varying(q)
        small = distance < enough
        return small, 1 - distance[small] / self.least, lambda: self._differences(q[:, small])

    def _of_varying(self, q: Array) -> Array:
        assert isinstance(self.loops, NewtonClosure)
        return self.loops.conditioning(self.loops.positions(q).T)

    def _differences(self, q: Array) -> Array:
        """Derivatives of the violation by the active joints, (active, n), by central differences."""
        step = DIFFERENCE_STEPS[0]
        sides = [q + sign * step * unit[:, None] for unit in np.eye(len(q)) for sign in (1, -1)]
        found = self._of_varying(np.concatenate(sides, axis=1)).reshape(len(q), 2, -1)
        return np.asarray((found[:, 1] - found[:, 0]) / (2 * step * self.least))


def _check_room(names: list[str], position: Sequence[tuple[float, float]], rates: Mapping[str, Array]) -> None:
    """Raise SettingError if a joint cannot move within its limits."""
    for name, (low, high) in zip(names, position, strict=False):  # their number is checked with the other shapes
        if not low < high:
            raise SettingError(
                f"joint {name} has no room to move: its positions go from {low:g} to {high:g}.",
                where=name,
                found=(low, high),
                advice="Widen its range; a joint that is clamped is fixed in the device file.",
            )
    for what, values in rates.items():
        for name, most in zip(names, values.tolist(), strict=True):
            if not most > 0:
                raise SettingError(
                    f"{what} of joint {name} has to be above 0; found {most:g}.", where=what, found=most, limit=0.0
                )


def _given(what: str, joint: str, value: T | None) -> T:
    if value is None:
        raise IncompleteDeviceError(
            f"joint {joint} has no {what} in the device file, so the motion is not bounded.",
            where=joint,
            advice="Add it to the device file, or to the limits (--speed; --centre with --stroke).",
        )
    return value


def _beyond(x: Array, low: float | Array, high: float | Array) -> Array:
    """Violation of a range, relative to its width, or to 1 rad or m where one end is infinite; -1 where both are."""
    beyond = np.maximum(low - x, x - high) / _width(low, high)
    return np.where(np.isneginf(beyond), -1.0, beyond)


def _outwards(x: Array, low: float | Array, high: float | Array) -> Array:
    """Derivative of `_beyond` by x."""
    above, below = x - high, low - x
    sign = np.where(above > below, 1.0, -1.0) * np.isfinite(np.maximum(above, below))
    return np.asarray(sign / _width(low, high))


def _width(low: float | Array, high: float | Array) -> Array:
    """What a violation of a range is relative to."""
    return np.where(np.isfinite(low) & np.isfinite(high), np.subtract(high, low), 1.0)


def _next(rest: Iterator[Array], many: int) -> Array:
    """The weights of the next limits, (many, n)."""
    return np.array([next(rest) for _ in range(many)])
