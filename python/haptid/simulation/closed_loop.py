"""A model simulated along a log: many short stretches side by side, each from the measured state.

Stretches overlap: each runs in before its own samples, until its start is forgotten. So a log of a minute takes as
many steps as one of a second or two, and an estimate that is still poor cannot run far away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import SimulationLostError
from haptid.motion.channels import position_map
from haptid.motion.treatment import Motion
from haptid.simulation.control import PID, Running, Start, reference

# A coordinate faster than this has run away, rad/s or m/s.
FASTEST = 1e3
# A step of Runge and Kutta's method of order four is stable up to this rate times the step, on the real axis.
STABLE = 2.5


@dataclass(frozen=True, eq=False)
class Stretches:
    """Which samples are simulated side by side, step by step.

    Attributes:
        sample: at every step of each stretch, (steps, stretches); the last sample is repeated past the end.
        own: whether that step is the stretch's own, and not one of running in, (steps, stretches).
        samples: of the log.
    """

    sample: np.ndarray
    own: np.ndarray
    samples: int

    @staticmethod
    def of(samples: int, length: int, settle: int) -> Stretches:
        """Stretches of `length` samples, each after `settle` samples of running in; the first begins at its own."""
        length = max(1, min(length, samples))
        first = np.arange(0, samples, length)
        begin = np.maximum(first - settle, 0)
        step = np.arange(length + min(settle, samples))[:, None]
        sample = begin + step
        own = (sample >= first) & (sample < np.minimum(first + length, samples))
        return Stretches(np.minimum(sample, samples - 1), own, samples)

    @property
    def count(self) -> int:
        """How many."""
        return int(self.sample.shape[1])

    def joined(self, values: Array) -> Array:
        """Every sample from its own stretch: (steps, ..., stretches) to (..., samples)."""
        last = np.moveaxis(values, -1, 1)
        made = np.empty((self.samples, *last.shape[2:]))
        made[self.sample[self.own]] = last[self.own]
        return np.ascontiguousarray(np.moveaxis(made, 0, -1))


@dataclass(frozen=True, eq=False)
class Course:
    """What the model did, on the samples of the motion.

    Attributes:
        motion: along which it was simulated.
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
    """The same, step by step of every stretch and control period: what sensitivities are made of.

    Attributes:
        stretches: which samples.
        per: control periods in a sample.
        c, cd, cdd, tau: each (steps * per, n, stretches * sets).
        free: which motors followed what they were asked for, (steps * per, motors, stretches * sets).
    """

    stretches: Stretches
    per: int
    c: Array
    cd: Array
    cdd: Array
    tau: Array
    free: np.ndarray

    def course(self, motion: Motion, k: int = 0) -> Course:
        """What the k-th set of parameters did."""
        count = self.stretches.count
        here = slice(k * count, (k + 1) * count)
        parts = (freeze(self.stretches.joined(x[:: self.per, :, here])) for x in (self.c, self.cd, self.cdd, self.tau))
        return Course(motion, *parts)


# What acts at control period k of every stretch: from k, positions and velocities to torques, and who is free.
Drive = Callable[[int, Array, Array], tuple[Array, np.ndarray]]


def measured_state(model: DynamicModel, motion: Motion) -> tuple[Array, Array]:
    """Treated positions and velocities of the coordinates at every sample, each (n, samples); ends are repeated."""
    change = position_map(model.device, motion)
    return change(np.ascontiguousarray(motion.q.T)), change(np.ascontiguousarray(motion.qd.T))


def between(values: Array, stretches: Stretches, per: int) -> Array:
    """Values at every control period, by straight lines, (steps * per, n, stretches), from (n, samples)."""
    last = values.shape[1] - 1
    at = stretches.sample[:, None, :] + np.arange(per)[None, :, None] / per
    low = np.minimum(at.astype(int), last)
    share = at - low
    made = values[:, low] * (1 - share) + values[:, np.minimum(low + 1, last)] * share
    return np.ascontiguousarray(np.moveaxis(made.reshape(len(values), -1, stretches.count), 0, 1))


def closed_loop(forward: ForwardDynamics, law: PID, motion: Motion, place: int, stretches: Stretches) -> Steps:
    """The model under its controller.

    Args:
        forward: with one set of parameters, or several.
        law: the controller.
        motion: along which; stretches begin at its states.
        place: of the motion among the observation's.
        stretches: which samples.

    Raises:
        SimulationLostError: the model runs away.
        MasslessError: a mass matrix cannot be inverted.
        ControllerError: the controller does not fit the device or the motion.
    """
    model, sets, per = forward.model, len(forward.chi), law.periods(motion.dt)
    target = reference(law, model, motion, place)
    speed = np.gradient(target, motion.dt, axis=1)
    wanted, rate = (np.tile(between(x, stretches, per), sets) for x in (target, speed))
    c, cd = (np.tile(x[:, stretches.sample[0]], sets) for x in measured_state(model, motion))
    held = forward.inverse(c, cd, np.zeros_like(c))
    running = Running(law, model, motion.dt / per, Start(c, cd, wanted[0], rate[0], held))

    def drive(k: int, c: Array, cd: Array) -> tuple[Array, np.ndarray]:
        return running.torque(c, cd, wanted[k], rate[k])

    return _run(forward, motion, stretches, per, (c, cd), drive)


def open_loop(
    forward: ForwardDynamics, motion: Motion, torque: Array, start: tuple[Array, Array], stretches: Stretches
) -> Steps:
    """The model under the torque that was measured.

    Args:
        forward: with one set of parameters, or several.
        motion: along which.
        torque: of the rows from each sample to the next, (n, samples), N m or N.
        start: positions and velocities at the first step of every stretch, each (n, stretches).
        stretches: which samples.

    Raises:
        SimulationLostError, MasslessError: as for `closed_loop`.
    """
    sets = len(forward.chi)
    held = np.tile(np.ascontiguousarray(np.moveaxis(torque[:, stretches.sample], 0, 1)), sets)
    free = np.ones((len(forward.model.device.motors), held.shape[2]), dtype=bool)
    c, cd = (np.tile(x, sets) for x in start)
    return _run(forward, motion, stretches, 1, (c, cd), lambda k, _c, _cd: (held[k], free))


def _run(
    forward: ForwardDynamics, motion: Motion, stretches: Stretches, per: int, start: tuple[Array, Array], drive: Drive
) -> Steps:
    """All steps, torque held from one control period to the next."""
    c, cd = start
    forward.check(c[:, : stretches.count])
    period, steps = motion.dt / per, len(stretches.sample) * per
    begin = c[:, : stretches.count]
    calm, rough = (
        max(1, int(np.ceil(period * each.stiffness(begin) / STABLE))) for each in (forward.without_dry(), forward)
    )
    made = np.empty((4, steps, *c.shape))
    free = np.empty((steps, len(forward.model.device.motors), c.shape[1]), dtype=bool)
    for k in range(steps):
        tau, free[k] = drive(k, c, cd)
        cdd = forward.acceleration(c, cd, tau)
        made[:, k] = c, cd, cdd, tau
        turning = forward.turning(c, cd, cdd, period)
        after_c, after_cd = np.empty_like(c), np.empty_like(cd)
        for which, parts in ((turning, rough), (~turning, calm)):
            state = c[:, which], cd[:, which], cdd[:, which], tau[:, which]
            after_c[:, which], after_cd[:, which] = _ahead(forward, state, period, parts)
        c, cd = after_c, after_cd
        if not np.abs(cd).max() < FASTEST:
            raise _lost(forward.model, motion, stretches, k // per, cd)
    return Steps(stretches, per, made[0], made[1], made[2], made[3], free)


def _ahead(
    forward: ForwardDynamics, state: tuple[Array, Array, Array, Array], period: float, parts: int
) -> tuple[Array, Array]:
    """One control period in so many parts, from positions, velocities, accelerations and torques; torque held."""
    c, cd, cdd, tau = (np.ascontiguousarray(x) for x in state)
    if not c.size:
        return c, cd
    for part in range(parts):
        c, cd = _step(forward, c, cd, tau, cdd if part == 0 else None, period / parts)
    return c, cd


def _step(
    forward: ForwardDynamics, c: Array, cd: Array, tau: Array, cdd: Array | None, h: float
) -> tuple[Array, Array]:
    """One step of Runge and Kutta's method of order four, torque held."""
    a1 = forward.acceleration(c, cd, tau) if cdd is None else cdd
    v2 = cd + 0.5 * h * a1
    a2 = forward.acceleration(c + 0.5 * h * cd, v2, tau)
    v3 = cd + 0.5 * h * a2
    a3 = forward.acceleration(c + 0.5 * h * v2, v3, tau)
    v4 = cd + h * a3
    a4 = forward.acceleration(c + h * v3, v4, tau)
    return c + h / 6 * (cd + 2 * v2 + 2 * v3 + v4), cd + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def _lost(model: DynamicModel, motion: Motion, stretches: Stretches, step: int, cd: Array) -> SimulationLostError:
    """What to raise of a model that runs away at this step."""
    row, column = np.unravel_index(int(np.argmax(np.nan_to_num(np.abs(cd), nan=np.inf))), cd.shape)
    time = motion.t0 + motion.dt * int(stretches.sample[step, int(column) % stretches.count])
    return SimulationLostError(time, model.device.row_labels[int(row)], float(abs(cd[row, column])), FASTEST)
