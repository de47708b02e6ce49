"""Simulation of a model along a log: many short overlapping segments in parallel, each from the measured state.

Each segment starts early, so that the error of its initial state has decayed where its own samples begin. A log of a
minute then takes as many steps as one of a second or two, and a poor estimate cannot diverge far.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import SettingError, SimulationError
from haptid.motion.channels import position_map, state
from haptid.motion.motion import Motion
from haptid.simulation.control import PID, ControllerState, MotorRates, reference

# Speed at which a simulation counts as diverged, rad/s or m/s.
FASTEST = 1e3
# Stability limit of the fourth-order Runge-Kutta method on the real axis: rate times step.
STABLE = 2.5
# Least width of smooth dry friction, rad/s or m/s.
LEAST_WIDTH = 1e-6


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of a log that are simulated in parallel (multiple shooting): the sample of each at every step.

    Attributes:
        sample: at every step of each segment, (steps, segments); the last sample is repeated past the end.
        own: whether the step is one of the segment's own samples, and not of its run-in, (steps, segments).
        samples: of the log.
    """

    sample: np.ndarray
    own: np.ndarray
    samples: int

    @staticmethod
    def of(samples: int, length: int, run_in: int) -> Segments:
        """Segments of `length` samples, each after a run-in of `run_in` samples, except the first."""
        length = max(1, min(length, samples))
        first = np.arange(0, samples, length)
        begin = np.maximum(first - run_in, 0)
        step = np.arange(length + min(run_in, samples))[:, None]
        sample = begin + step
        own = (sample >= first) & (sample < np.minimum(first + length, samples))
        return Segments(np.minimum(sample, samples - 1), own, samples)

    @property
    def count(self) -> int:
        """Number of segments."""
        return int(self.sample.shape[1])

    def joined(self, values: Array) -> Array:
        """Every sample from its own segment: (steps, ..., segments) to (..., samples)."""
        last = np.moveaxis(values, -1, 1)
        joined = np.empty((self.samples, *last.shape[2:]))
        joined[self.sample[self.own]] = last[self.own]
        return np.ascontiguousarray(np.moveaxis(joined, 0, -1))


@dataclass(frozen=True, eq=False)
class Course:
    """Simulated trajectory on the samples of a motion.

    Attributes:
        motion: along which the model was simulated.
        c, cd, cdd: of the coordinates that torque rows belong to, each (n, samples), SI.
        tau: torque of the rows from each sample to the next, (n, samples), N m or N.
    """

    motion: Motion
    c: Array
    cd: Array
    cdd: Array
    tau: Array


@dataclass(frozen=True, eq=False)
class Steps:
    """Simulated states and torques at every control period of every segment.

    Attributes:
        segments: the segments.
        per: control periods per sample.
        c, cd, cdd, tau: each (steps * per, n, segments * sets).
        free: which motors were not saturated, (steps * per, motors, segments * sets).
        motors: torque of each motor, of the same shape; none in an open loop, where that of the rows is given.
    """

    segments: Segments
    per: int
    c: Array
    cd: Array
    cdd: Array
    tau: Array
    free: np.ndarray
    motors: Array

    def course(self, motion: Motion, k: int = 0) -> Course:
        """Trajectory of the k-th set of parameters."""
        count = self.segments.count
        samples = slice(k * count, (k + 1) * count)
        parts = (
            freeze(self.segments.joined(x[:: self.per, :, samples])) for x in (self.c, self.cd, self.cdd, self.tau)
        )
        return Course(motion, *parts)


# From control period k, positions and velocities to torques of the rows and of the motors, and which motors are not
# saturated.
_TorqueLaw = Callable[[int, Array, Array], tuple[Array, Array, np.ndarray]]


def measured_state(model: DynamicModel, motion: Motion) -> tuple[Array, Array]:
    """Treated positions and velocities of the coordinates at every sample, each (n, samples); ends are repeated."""
    change = position_map(model.device, motion)
    return change(np.ascontiguousarray(motion.q.T)), change(np.ascontiguousarray(motion.qd.T))


def between(values: Array, segments: Segments, per: int) -> Array:
    """Linear interpolation to every control period, (steps * per, n, segments), from (n, samples)."""
    last = values.shape[1] - 1
    position = segments.sample[:, None, :] + np.arange(per)[None, :, None] / per
    low = np.minimum(position.astype(int), last)
    share = position - low
    values_between = values[:, low] * (1 - share) + values[:, np.minimum(low + 1, last)] * share
    return np.ascontiguousarray(np.moveaxis(values_between.reshape(len(values), -1, segments.count), 0, 1))


def closed_loop(forward: ForwardDynamics, law: PID, motion: Motion, place: int, segments: Segments) -> Steps:
    """Simulate the model under its controller.

    Args:
        forward: with one or several sets of parameters.
        law: the controller.
        motion: along which; segments begin at its states.
        place: index of the motion in the observation.
        segments: the segments.

    Raises:
        SimulationError: the simulation diverges, or a mass matrix cannot be inverted.
        SettingError: the controller does not fit the device or the motion.
    """
    model, sets, per = forward.model, len(forward.chi), law.periods(motion.dt)
    target = MotorRates.positions(model, reference(law, model, motion, place))
    speed = np.gradient(target, motion.dt, axis=1)
    wanted, rate = (np.tile(between(x, segments, per), sets) for x in (target, speed))
    c, cd = (np.tile(x[:, segments.sample[0]], sets) for x in measured_state(model, motion))
    static = forward.inverse(c, cd, np.zeros_like(c))
    motors = MotorRates.at(model, c)
    d, velocity = MotorRates.positions(model, c), motors.of_motors(cd)
    running = ControllerState(law, model, motion.dt / per, d, velocity)
    running.settle(wanted[0] - d, rate[0] - velocity, motors.torque_in_total(static))

    def drive(k: int, c: Array, cd: Array) -> tuple[Array, Array, np.ndarray]:
        motors = MotorRates.at(model, c)
        command, free = running.torque(MotorRates.positions(model, c), motors.of_motors(cd), wanted[k], rate[k])
        return motors.of_rows(command), command, free

    return _run(forward, motion, segments, per, (c, cd), drive)


def open_loop(
    forward: ForwardDynamics, motion: Motion, torque: Array, start: tuple[Array, Array], segments: Segments
) -> Steps:
    """Simulate the model under the measured torque.

    Args:
        forward: with one or several sets of parameters.
        motion: along which.
        torque: of the rows from each sample to the next, (n, samples), N m or N.
        start: positions and velocities at the first step of every segment, each (n, segments).
        segments: the segments.

    Raises:
        SimulationError: as for `closed_loop`.
    """
    sets = len(forward.chi)
    applied = np.tile(np.ascontiguousarray(np.moveaxis(torque[:, segments.sample], 0, 1)), sets)
    free = np.ones((len(forward.model.device.motors), applied.shape[2]), dtype=bool)
    none = np.zeros(free.shape)
    c, cd = (np.tile(x, sets) for x in start)
    return _run(forward, motion, segments, 1, (c, cd), lambda k, _c, _cd: (applied[k], none, free))


def _run(
    forward: ForwardDynamics,
    motion: Motion,
    segments: Segments,
    per: int,
    start: tuple[Array, Array],
    law: _TorqueLaw,
) -> Steps:
    """All steps, with constant torque within a control period."""
    c, cd = start
    forward.check(c[:, : segments.count])
    period, steps = motion.dt / per, len(segments.sample) * per
    begin = c[:, : segments.count]
    smooth_parts, dry_parts = (
        max(1, int(np.ceil(period * dynamics.stiffness(begin) / STABLE)))
        for dynamics in (forward.without_dry(), forward)
    )
    states = np.empty((4, steps, *c.shape))
    free = np.empty((steps, len(forward.model.device.motors), c.shape[1]), dtype=bool)
    motors = np.empty(free.shape)
    for k in range(steps):
        tau, motors[k], free[k] = law(k, c, cd)
        cdd = forward.acceleration(c, cd, tau)
        states[:, k] = c, cd, cdd, tau
        turning = forward.turning(c, cd, cdd, period)
        after_c, after_cd = np.empty_like(c), np.empty_like(cd)
        for mask, parts in ((turning, dry_parts), (~turning, smooth_parts)):
            now = c[:, mask], cd[:, mask], cdd[:, mask], tau[:, mask]
            after_c[:, mask], after_cd[:, mask] = _control_period(forward, now, period, parts)
        c, cd = after_c, after_cd
        if not np.abs(cd).max() < FASTEST:
            raise _diverged(forward.model, motion, segments, k // per, cd)
    return Steps(segments, per, states[0], states[1], states[2], states[3], free, motors)


def _control_period(
    forward: ForwardDynamics, now: tuple[Array, Array, Array, Array], period: float, parts: int
) -> tuple[Array, Array]:
    """One control period in equal steps, from positions, velocities, accelerations and torques; constant torque."""
    c, cd, cdd, tau = (np.ascontiguousarray(x) for x in now)
    if not c.size:
        return c, cd
    for part in range(parts):
        first = cdd if part == 0 else None
        c, cd = runge_kutta_step(lambda at, speed: forward.acceleration(at, speed, tau), c, cd, period / parts, first)
    return c, cd


def runge_kutta_step(
    acceleration: Callable[[Array, Array], Array], c: Array, cd: Array, h: float, first: Array | None = None
) -> tuple[Array, Array]:
    """One step of the classical Runge-Kutta method of order four.

    Args:
        acceleration: of positions and velocities.
        c, cd: positions and velocities at the beginning.
        h: step, s.
        first: acceleration at the beginning, where it is known.
    """
    a1 = acceleration(c, cd) if first is None else first
    v2 = cd + 0.5 * h * a1
    a2 = acceleration(c + 0.5 * h * cd, v2)
    v3 = cd + 0.5 * h * a2
    a3 = acceleration(c + 0.5 * h * v2, v3)
    v4 = cd + h * a3
    a4 = acceleration(c + h * v3, v4)
    return c + h / 6 * (cd + 2 * v2 + 2 * v3 + v4), cd + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def _diverged(model: DynamicModel, motion: Motion, segments: Segments, step: int, cd: Array) -> SimulationError:
    """Error of a simulation that diverges at this step."""
    row, column = np.unravel_index(int(np.argmax(np.nan_to_num(np.abs(cd), nan=np.inf))), cd.shape)
    time = motion.t0 + motion.dt * int(segments.sample[step, int(column) % segments.count])
    label, speed = model.device.row_labels[int(row)], float(abs(cd[row, column]))
    return SimulationError(
        f"the simulated model diverges: at {time:.3f} s {label} moves at {speed:.3g} rad/s or m/s (limit {FASTEST:g}).",
        where=time,
        found=speed,
        limit=FASTEST,
        advice="Check the controller's gains and reference, or start from physically consistent parameters, such as "
        "those of Consistent().",
    )


def expect_no_history(model: DynamicModel) -> None:
    """Raise SettingError if a column depends on more than the state, which a simulation in short segments lacks."""
    names = [term.name for term in model.terms if term.historic]
    if names:
        raise SettingError(
            f"{model.device.name}: {', '.join(names)} depend on the motion before or on time, which methods that "
            "simulate the device do not have.",
            where=names[0],
            found=tuple(names),
            advice="Choose wls, gls, iv or another method that computes columns along the log, or write Coulomb and "
            "viscous friction in their place.",
        )


def smooth(model: DynamicModel, motions: Sequence[Motion], share: float) -> DynamicModel:
    """The model with tanh(v / width) in place of sgn(v) wherever its dry friction has no width of its own.

    A sticking joint then creeps, and the integration requires no event detection.

    Args:
        motions: the width is a share of each term's root mean square speed along them.
        share: of that speed.
    """
    states = [state(model.device, motion, *part) for motion in motions for part in motion.usable_segments]
    terms = []
    for term in model.terms:
        if term.dry and term.constant("width") == 0:
            power = np.concatenate([model.speed(term, c, cd) ** 2 for c, cd in states])
            term = term.with_constant("width", max(share * float(np.sqrt(power.mean())), LEAST_WIDTH))
        terms.append(term)
    return model.with_terms(terms)
