"""Delays of a log's torque channels, estimated jointly with the base parameters.

A command acts late: it is constant from one sample to the next (zero-order hold), and amplifiers and buses add latency.
To first order a delay d adds d dtau/dt to the residual, so each delay is one more column, the rate of the *model's*
torque (the measured one is noisy, and would bias its own parameter towards zero). Columns change with the parameters:
Gauss-Newton steps, with a prior, since friction that the model lacks is late or early as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.dynamics.inverse import raw_parameters, rigid
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.estimation.intervals.cluster_robust import clustered
from haptid.estimation.methods.wls import WLS
from haptid.log import Log
from haptid.motion.channels import torque_map
from haptid.motion.treatment import Motion, Treatment, treat, with_delay
from haptid.observation.augmented import CandidateColumns, ResidualContext, augmented_plan, reduced
from haptid.observation.observation import Observation, observe
from haptid.observation.plan import Block
from haptid.treatment_choice.first_fit import least_squares, residual_memory, solve_excited

# Prior of the delays, samples: mean for a command that is held from one sample to the next, standard deviations of what
# all channels share and of each channel's own part.
HOLD, COMMON, OWN = 0.5, 3.0, 0.25
# A delay of all channels so much longer or shorter than the prior mean, or channels so far apart, samples, are more
# likely friction or a missing term; they are compensated only where the rigid bodies' torque shows them too.
_LATEST, _EARLIEST, _APART = 6.0, 1.5, 3.0
# Standard deviation of a delay that is not identifiable, samples.
_UNKNOWN = 1.0
# Share of the largest entry of a matrix below which a channel has no part in a row.
_NO_PART = 1e-12
# Gauss-Newton steps, and the change, samples, below which they end.
_STEPS, _STILL = 4, 0.005
# Standard errors by which the rigid bodies' delay must be seen.
_SEEN = 4.0


@dataclass(frozen=True, eq=False)
class Delays:
    """Delays of the torque channels: the acting torque is the channel's of so much earlier.

    Attributes:
        seconds: to compensate, (channels,), s.
        covariance: their cluster-robust covariance with the prior's, (channels, channels), s^2.
        found: as estimated for each channel alone, (channels,), s.
        accepted: whether what was found is compensated, and not taken for friction or a missing term.
        dt: sampling period, s.
    """

    seconds: Array
    covariance: Array
    found: Array
    accepted: bool
    dt: float

    def __post_init__(self) -> None:
        for name in ("seconds", "covariance", "found"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def se(self) -> Array:
        """Standard errors, (channels,), s."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def setting(self) -> float | tuple[float, ...]:
        """`Treatment.torque_delay_s`: one value where all channels have the same."""
        values = tuple(float(f"{value:.4g}") for value in self.seconds)
        return values[0] if len(set(values)) == 1 else values

    @property
    def sentence(self) -> str:
        """The delays as text, with what was done."""
        many, ms = len(self.seconds) > 1, 1e3 * self.found
        size = (
            f"{_numbers(ms)} ms (standard error {_numbers(1e3 * self.se)} ms; sampling period {1e3 * self.dt:.3g} ms)"
        )
        if not self.accepted:
            return (
                f"The torque channels seem late by {_numbers(ms)} ms, which is no delay of a drive but friction or a "
                f"term that the model lacks: {1e3 * self.seconds[0]:.3g} ms is compensated, and one sampling period of "
                f"uncertainty is in every interval. If the channels truly differ so much, give `torque_delay_s`."
            )
        held = np.abs(self.seconds / self.dt - HOLD) < 2 * self.se / self.dt + 0.02
        hold = ": half a sampling period, as of a command with zero-order hold" if held.all() else ""
        if (self.se > _UNKNOWN * self.dt).all():
            return f"The torque delay is hardly identifiable: {size}; its uncertainty is in every interval."
        return f"Torque delay{'s' if many and len(set(self.seconds)) > 1 else ''}: {size}{hold}; compensated."


def find_delays(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, start: Delays | None = None) -> Delays:
    """Delays of the torque channels, jointly with the base parameters.

    Args:
        model: the dynamic model.
        logs: recorded by one instrument.
        treatment: settings; its own `torque_delay_s` is ignored.
        start: found before, with another treatment.

    Raises:
        HaptidError: as `treat` and `observe`.
    """
    dt, channels = max(float(log.dt) for log in logs), logs[0].torque.shape[1]
    hold = HOLD if logs[0].channels.torque.side == "motor" else 0.0
    prior = dt**2 * (COMMON**2 * np.ones((channels, channels)) + OWN**2 * np.eye(channels))
    mean = np.full(channels, hold * dt)
    d = mean if start is None else np.array(start.found)
    motions = [treat(log, replace(treatment, torque_delay_s=0.0)) for log in logs]
    beta, covariance = least_squares(observe(model, *(with_delay(motion, _setting(d)) for motion in motions))), prior
    for _ in range(_STEPS):
        problem = _Problem.of(model, [with_delay(motion, _setting(d)) for motion in motions], beta)
        beta, step, covariance = problem.solve(mean - d, prior)
        # A step beyond the linear range of the columns would overshoot.
        step = np.clip(step, -COMMON * dt, COMMON * dt)
        d = d + step
        if np.abs(step).max() < _STILL * dt:
            break
    off = (d - mean) / dt
    common = float(np.median(off))
    odd = not -_EARLIEST <= common <= _LATEST or np.abs(off - common).max() > _APART
    if odd and not problem.rigid_agrees(float(np.median(d)), dt):
        return Delays(mean, (_UNKNOWN * dt) ** 2 * np.ones((channels, channels)), d, False, dt)
    return Delays(d, covariance, d, True, dt)


def with_delay_uncertainty(estimate: Estimate, delays: Delays) -> Estimate:
    """An estimate whose covariance includes what the uncertainty of the delays adds.

    The parameters move by (W'W)^-1 W'D for a delay of D's channel, D the rate of the model's torque, as in a fit with
    the delays as further columns.

    Args:
        estimate: from logs treated with these delays.
        delays: of the torque channels.
    """
    motions = estimate.observation.motions
    if not np.any(delays.covariance) or any(m.log is None or m.treatment.momentum for m in motions):
        return estimate
    problem = _Problem.of(estimate.model, motions, estimate.free)
    values, vectors = np.linalg.eigh(delays.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return estimate.with_nuisance("torque delay", (problem.sensitivity(estimate) @ root).T)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least squares in the base parameters and the delays' changes, from R factors by motor and block.

    Attributes:
        model, motions: of the rows.
        rows: R factors with a column for the delay of each channel after those of the base parameters.
        beta: parameters that the columns were computed with, (p,).
    """

    model: DynamicModel
    motions: Sequence[Motion]
    rows: Observation
    beta: Array

    @staticmethod
    def of(model: DynamicModel, motions: Sequence[Motion], beta: Array) -> _Problem:
        """From treated motions of logs, and parameters."""
        return _Problem(model, motions, _augmented(model, motions, beta, _delay_columns(model, motions[0])), beta)

    @cached_property
    def weights(self) -> Array:
        """One over each motor's residual, less for residuals with memory: rows count as many as are independent."""
        motors, weight = self.rows.motors, WLS().weight
        without = np.zeros(1 + max(int(motor.columns.max()) for motor in motors))
        without[: len(self.beta)] = self.beta
        w = np.array([weight(motor, without) for motor in motors])
        memory = residual_memory(self.model, self.motions, self.beta)
        step = self.motions[0].treatment.decimation * self.motions[0].dt
        return np.asarray(w / np.sqrt(max(memory / step, 1.0)))

    def solve(self, off: Array, prior: Array) -> tuple[Array, Array, Array]:
        """Parameters (p,), the delays' change (channels,), and its covariance.

        Args:
            off: prior mean of the change, (channels,), s.
            prior: its covariance, s^2.
        """
        p, m = len(self.beta), len(off)
        whiten = np.linalg.inv(np.linalg.cholesky(prior))
        known = np.zeros((m, p + m + 1))
        known[:, p:-1], known[:, -1] = whiten, whiten @ off
        solution = solve_excited(self.rows.motors, self.weights, known)
        spread = clustered(self.rows, self.weights, solution, np.eye(p + m)[p:])
        return solution.beta[:p], solution.beta[p:], spread.covariance

    def sensitivity(self, estimate: Estimate) -> Array:
        """Derivative of an estimate's parameters by each channel's delay, (p, channels), SI per s."""
        assert self.motions[0].log is not None
        p, root = len(self.beta), estimate.fit.solution.root
        made = np.zeros((p, self.motions[0].log.torque.shape[1]))
        for motor, weight in zip(self.rows.motors, estimate.weights, strict=True):
            own = motor.columns < p
            cross = motor.whole[:, :-1].T @ motor.whole[:, :-1]
            made[np.ix_(motor.columns[own], motor.columns[~own] - p)] += weight**2 * cross[np.ix_(own, ~own)]
        return np.asarray(root @ (root.T @ made))

    def rigid_agrees(self, delay: float, dt: float) -> bool:
        """Whether the torque of the rigid bodies alone, next to that of friction, is late by as much.

        Friction that the model lacks is late or early on its own; a drive delays every torque alike.
        """
        bodies, everything = (_delay_columns(self.model, self.motions[0], only) for only in (True, False))
        # One delay of the bodies for all channels; what is added for all torque is each channel's own.
        p, n = len(self.beta), 1 + max(channel for channel, _ in everything)
        columns = [*((0, column) for _, column in bodies), *((1 + channel, column) for channel, column in everything)]
        motions = [with_delay(m, HOLD * dt) for m in self.motions]
        rows = _augmented(self.model, motions, self.beta, columns)
        solution = solve_excited(rows.motors, self.weights, np.zeros((0, p + n + 2)))
        spread = clustered(rows, self.weights, solution, np.eye(p + n + 1)[[p]])
        # The second column holds all torque, the first the bodies' once more: equal delays leave the first at zero.
        own, total = float(solution.beta[p]), float(np.median(solution.beta[p + 1 :]))
        se, late = float(np.sqrt(spread.covariance[0, 0])), own + total + HOLD * dt
        return se < abs(late - HOLD * dt) / _SEEN and abs(late - delay) < 2 * se + 0.5 * dt


def _setting(d: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in d)


# The delay that a column belongs to, and the column.
_DelayColumn = tuple[int, CandidateColumns]


def _delay_columns(model: DynamicModel, motion: Motion, bodies: bool = False) -> list[_DelayColumn]:
    """The rate of each channel's torque, by the model, in every row that the channel acts on.

    Args:
        model: the dynamic model.
        motion: of a log.
        bodies: only the torque of rigid bodies and rotors.
    """
    assert motion.log is not None
    to_rows = torque_map(model.device, motion.log)
    to_channels = np.linalg.pinv(to_rows)

    def column(row: int, channel: int) -> CandidateColumns:
        def rate(context: ResidualContext) -> Array:
            torque = context.torque(rigid(model, context.chi)) if bodies else context.predicted
            own = to_rows[row, channel] * (to_channels[channel] @ torque)
            return np.asarray(np.gradient(own, context.plan.motion.dt)[None])

        return CandidateColumns(np.eye(len(to_rows))[row], 1, rate)

    acts = np.abs(to_rows) > _NO_PART * np.abs(to_rows).max()
    return [(int(channel), column(int(row), int(channel))) for row, channel in np.argwhere(acts)]


def _augmented(
    model: DynamicModel, motions: Sequence[Motion], beta: Array, columns: Sequence[_DelayColumn]
) -> Observation:
    """Every motion's rows; columns of one delay share their place after the base parameters'."""
    chi, more = raw_parameters(model, beta), [column for _, column in columns]
    rows = [int(k) for k in np.flatnonzero(model.device.measured)]
    place = np.append(np.arange(len(beta)), [len(beta) + delay for delay, _ in columns])
    blocks: list[Block] = []
    parts = []
    for motion in motions:
        wide = augmented_plan(model, motion, chi, more)
        parts.append(reduced(wide, rows, list(wide.segments())))
        blocks.extend(wide.blocks())
    motors = tuple(
        replace(
            same[0],
            columns=place[same[0].columns],
            triangles=np.concatenate([motor.triangles for motor in same]),
            rows=np.concatenate([motor.rows for motor in same]),
        )
        for same in zip(*parts, strict=True)
    )
    return Observation(model, motors, tuple(blocks), tuple(motions))


def _numbers(values: Array) -> str:
    """Values as text, once where they agree to three digits."""
    texts = [f"{value:.2g}" if abs(value) < 0.1 else f"{value:.3g}" for value in values]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts)
