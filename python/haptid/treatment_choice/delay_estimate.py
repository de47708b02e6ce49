"""Delays of a log's torque channels, estimated jointly with the base parameters.

A command acts late: it is constant from one sample to the next (zero-order hold), and amplifiers and buses add latency.
To first order a delay d adds d dtau/dt to the residual, so each delay is one more column, the rate of the *model's*
torque (the measured one is noisy, and would bias its own parameter towards zero). Above three times the motion's
bandwidth, where the parallel filter is wider, only the jumps of friction are in it: what else the model has there is
noise of the positions. Columns change with the parameters: Gauss-Newton steps, with a prior, since friction that the
model lacks is late or early as well. Intervals are Student's t, with the degrees of freedom of the time blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters, rigid
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Spread
from haptid.estimation.intervals.cluster_robust import clustered
from haptid.estimation.methods.gls import Whitening
from haptid.log import Log
from haptid.motion.motion import Motion, treat, with_delay
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation, observe
from haptid.treatment_choice.delay_columns import delay_columns, smooth_part
from haptid.treatment_choice.first_fit import least_squares, solve_excited
from haptid.treatment_choice.nuisance_problem import NuisanceProblem
from haptid.treatment_choice.parallel_choice import LOG_PARTS, parts_of
from haptid.uncertainty.quantities import LEVEL, half_width

# Prior of the delays, samples: mean for a command that is held from one sample to the next, standard deviations of what
# all channels share and of each channel's own part.
HOLD, COMMON, OWN = 0.5, 3.0, 0.25
# Most commands are late by their hold and little more, some by samples: the standard deviation of what most share,
# samples, and how many are so.
_CLOSE, _MOST = 0.5, 2 / 3
# A delay of all channels so much longer or shorter than the prior mean, or channels so far apart, samples, are more
# likely friction or a missing term; they are compensated only where the rigid bodies' torque shows them too.
_LATEST, _EARLIEST, _APART = 6.0, 1.5, 3.0
# Standard deviation of a delay that is not identifiable, samples.
_UNKNOWN = 1.0
# Turn of the motion's phase by the prior's delays, rad, from which on steps may end beside the delay that leaves least.
_TURNS = 0.5
# Gauss-Newton steps, and the changes, samples and standard errors, below which they end; samples of the last one beyond
# which, and beyond a standard error, they lead nowhere.
_STEPS, _STILL, _SMALL, _MOVES = 4, 0.005, 0.05, 0.25
# A delay this far from the prior mean, samples, must not make the torque near reversals worse by so many of its errors.
_FAR, _WORSE = 1.0, 1.0
# Rows of the residual's memory from which it is a drift's: two periods of the bandwidth behind the usual filter.
_DRIFTS = 50
# Standard errors within which delays by rows that are whitened in time have to agree with those by ordinary ones (of
# these), and what goes with the second rate of the torque with nothing; by how many times surer they have to be.
_AGREES, _SURER = 2.0, 3.0
# Standard deviation of the part that goes with the second rate of the torque, samples squared: a mean over 15 samples
# has it. In slow motion far more is not told, and harms no delay.
_SECOND = 10.0
# Standard errors by which the rigid bodies' delay must be seen.
_SEEN = 4.0
# Frequency above which the torque without dry friction is noise, over the motion's bandwidth: products of sines have
# twice and three times its frequencies.
_NOISE = 3.0
# Relative error above which a delay beyond these limits has to lower the squared error, and to which share.
_ROUGH, _MUCH = 0.1, 0.5
# Standard error of the usual delay where rows near reversals contradict another one, as a share of the distance between
# the two: of what contradicts each other either may be wrong, and the interval of 95 % ends at the one refused.
_HALF = 0.5


@dataclass(frozen=True, eq=False)
class Delays:
    """Delays of the torque channels: the acting torque is the channel's of so much earlier.

    Attributes:
        seconds: to compensate, (channels,), s.
        covariance: their cluster-robust covariance with the prior's, (channels, channels), s^2.
        found: as estimated for each channel alone, (channels,), s.
        accepted: whether what was found is compensated, and not taken for friction or a missing term.
        dt: sampling period, s.
        samples: of the logs that they were estimated from.
        white: whether by rows that are whitened in time.
        noise_hz: frequency above which the torque without dry friction was taken for noise, Hz.
        dof: degrees of freedom of their intervals, (channels,): of the blocks that show them, under the wide prior. The
            prior's variance counts as known: where it is most of the variance, they are many times those of the blocks,
            and the interval is nearly normal. Infinite where the delays are not those found.
        by_positions: by how much one standard error of each part of the positions' errors moves them, (k, channels),
            s; not in `covariance`, because the parameters move with them.
    """

    seconds: Array
    covariance: Array
    found: Array
    accepted: bool
    dt: float
    samples: int = 0
    white: bool = False
    noise_hz: float = np.inf
    dof: Array = field(default_factory=lambda: np.full(1, np.inf))
    by_positions: Array = field(default_factory=lambda: np.zeros((0, 1)))

    def __post_init__(self) -> None:
        freeze_fields(self, "seconds", "covariance", "found", "dof", "by_positions")

    @property
    def se(self) -> Array:
        """Standard errors, (channels,), s."""
        return np.asarray(np.sqrt(np.diag(self.covariance) + np.sum(self.by_positions**2, axis=0)))

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals of the delays, (channels, 2), s; a standard error of few blocks has wider ones."""
        half = half_width(self.se, self.dof, level)
        return np.stack([self.seconds - half, self.seconds + half], axis=1)

    @property
    def setting(self) -> float | tuple[float, ...]:
        """`Treatment.torque_delay_s`: one value where all channels have the same."""
        return delay_setting(self.seconds)

    @property
    def sentence(self) -> str:
        """The delays as text, with what was done."""
        many, ms = len(self.seconds) > 1, 1e3 * (self.seconds if self.accepted else self.found)
        size = (
            f"{_numbers(ms)} ms (standard error {_numbers(1e3 * self.se)} ms; sampling period {1e3 * self.dt:.3g} ms)"
        )
        if not self.accepted:
            if float(np.median(ms)) >= 0:
                seems = (
                    f"The torque channels seem late by {_numbers(ms)} ms, which is no delay of a drive but friction or "
                    f"a term that the model lacks"
                )
                other = "it is a delay all the same, give `torque_delay_s`"
            else:
                seems = (
                    f"The torque seems to act {_numbers(-ms)} ms before it is recorded, which is no delay of a drive: "
                    f"its sensor is late (a measured current behind a filter), or the model lacks friction or another "
                    f"term"
                )
                other = "the sensor is late, give `torque_delay_s`, below zero"
            return (
                f"{seems}; {1e3 * self.seconds[0]:.3g} ms is compensated, with a standard error of "
                f"{_numbers(1e3 * self.se)} ms in every interval. If {other}."
            )
        held = np.abs(self.seconds / self.dt - HOLD) < 2 * self.se / self.dt + 0.02
        hold = ": half a sampling period, as of a command with zero-order hold" if held.all() else ""
        if (self.se > _UNKNOWN * self.dt).all():
            return f"The torque delay is hardly identifiable: {size}; its uncertainty is in every interval."
        return f"Torque delay{'s' if many and len(set(self.seconds)) > 1 else ''}: {size}{hold}; compensated."


def find_delays(
    model: DynamicModel,
    logs: Sequence[Log],
    treatment: Treatment,
    start: Delays | None = None,
    bandwidth_hz: float = np.inf,
) -> Delays:
    """Delays of the torque channels, jointly with the base parameters.

    Args:
        logs: recorded by one instrument.
        treatment: settings; its own `torque_delay_s` is ignored.
        start: found before, with another treatment.
        bandwidth_hz: of the motion, as in `Proposal`; infinite where unknown.

    Raises:
        HaptidError: as `treat` and `observe`.
    """
    dt, channels = max(float(log.dt) for log in logs), logs[0].torque.shape[1]
    samples = sum(len(log.t) for log in logs)
    prior = delay_prior(channels, dt)
    mean = np.full(channels, usual_delay(logs))
    d = mean if start is None else np.array(start.found)
    motions = [treat(log, replace(treatment, torque_delay_s=0.0)) for log in logs]
    rows = _Search(model, motions, (mean, prior), _NOISE * bandwidth_hz)
    beta = least_squares(rows.observed(d))
    found = rows.steps(d, beta, near=start is not None)
    turns = 2 * np.pi * bandwidth_hz * COMMON * dt > _TURNS and np.isfinite(bandwidth_hz)
    if not found.settled or (turns and start is None):
        found = rows.from_the_nearest(found) or found
    white = rows.beside_a_drift(found)
    d, beta, problem, spread, _ = white or rows.settled(found)
    off = (d - mean) / dt
    common = float(np.median(off))
    odd = not -_EARLIEST <= common <= _LATEST or np.abs(off - common).max() > _APART
    far = np.abs(off).max() > _FAR
    agrees = (
        _rigid_agrees(problem, float(np.median(d)), dt, rows.noise_hz) and rows.explains(d, beta)
        if odd
        else not far or not _contradicted(model, motions, d, mean)
    )
    if not agrees:
        # What is refused for its size alone says nothing of the delay.
        doubt = _UNKNOWN * dt if odd else min(_HALF * float(np.abs(d - mean).max()), COMMON * dt)
        covariance, known = doubt**2 * np.ones((channels, channels)), np.full(channels, np.inf)
        return Delays(mean, covariance, d, False, dt, samples, dof=known)
    likely, covariance = likely_delays(d - mean, spread.covariance, dt)
    return Delays(mean + likely, covariance, d, True, dt, samples, white is not None, rows.noise_hz, spread.dof)


def likely_delays(off: Array, covariance: Array, dt: float) -> tuple[Array, Array]:
    """Mean and covariance of the delays where most are close to the hold and some are not.

    The prior is a mixture of two normal ones, which hardly changes a delay with much information in the log: one with
    little stays near the hold, and what is left open is in the covariance.

    Args:
        off: delays over the hold under the wide prior alone, (channels,), s.
        covariance: theirs, (channels, channels), s^2.
        dt: sampling period, s.
    """
    wide, close = delay_prior(len(off), dt), delay_prior(len(off), dt, _CLOSE)
    precision = np.linalg.inv(covariance)
    values, vectors = np.linalg.eigh(precision - np.linalg.inv(wide))
    information, pull = (vectors * np.maximum(values, 0.0)) @ vectors.T, precision @ off
    made = []
    for share, prior in ((_MOST, close), (1 - _MOST, wide)):
        own = np.linalg.inv(information + np.linalg.inv(prior))
        size = np.linalg.slogdet(own)[1] - np.linalg.slogdet(prior)[1]
        made.append((np.log(share) + 0.5 * size + 0.5 * float(pull @ own @ pull), own @ pull, own))
    weights = np.exp(np.array([log for log, _, _ in made]) - max(log for log, _, _ in made))
    weights /= weights.sum()
    mean = np.asarray(sum(w * m for w, (_, m, _) in zip(weights, made, strict=True)))
    spread = sum(w * (own + np.outer(m - mean, m - mean)) for w, (_, m, own) in zip(weights, made, strict=True))
    return mean, np.asarray(spread)


class _Found(NamedTuple):
    """Delays that a search found, s, with the base parameters, the problem of its last step, at the delays before that
    step, the delays' spread, and whether the step was small."""

    delays: Array
    beta: Array
    problem: NuisanceProblem
    spread: Spread
    settled: bool = True


def _se(spread: Spread) -> Array:
    """Standard errors of a spread."""
    return np.asarray(np.sqrt(np.diag(spread.covariance)))


@dataclass(frozen=True, eq=False)
class _Search:
    """Gauss-Newton steps to the delays, from rows as they are, whitened in time, or by the smooth torque.

    Attributes:
        motions: of logs, without a delay.
        prior: mean and covariance of the delays, s.
        noise_hz: frequency above which the torque without dry friction is noise, Hz.
    """

    model: DynamicModel
    motions: Sequence[Motion]
    prior: tuple[Array, Array]
    noise_hz: float

    def _at(self, d: Array, beta: Array, smooth: bool = False) -> NuisanceProblem:
        late = [with_delay(motion, _setting(d)) for motion in self.motions]
        return delay_problem(self.model, late, beta, self.noise_hz, smooth)

    def observed(self, d: Array) -> Observation:
        """Rows with delays, s."""
        return observe(self.model, *(with_delay(motion, _setting(d)) for motion in self.motions))

    def from_the_nearest(self, before: _Found) -> _Found | None:
        """Steps from the delay of all channels that leaves least, to half a sample; None where they do not end either.

        A column is a delay's slope only while the delay turns the motion's phase a little: far from the delay, as of
        three samples with fourteen in a period, steps lead anywhere.

        Args:
            before: found already; where it is settled and leaves less there is nothing to look for.
        """
        dt, (mean, _) = self.motions[0].dt, self.prior
        least, (left, beta) = mean, self._left(mean)
        for off in np.arange(-_EARLIEST, _LATEST, 0.5) * dt:
            if (there := self._left(mean + off))[0] < left:
                least, (left, beta) = mean + off, there
        if before.settled and self._left(before.delays)[0] <= left:
            return None
        found = self.steps(least, beta)
        return found if found.settled else None

    def _left(self, d: Array) -> tuple[float, Array]:
        """Relative squared residual of all motors with delays, s, and the base parameters that leave it."""
        rows = self.observed(d)
        beta = least_squares(rows)
        return sum((m.residual(beta) / m.norm) ** 2 for m in rows.motors if m.norm > 0), beta

    def steps(self, d: Array, beta: Array, near: bool = False, whitening: Whitening | None = None) -> _Found:
        """Steps from delays, s, and parameters.

        Args:
            d, beta: to begin with.
            near: whether the delays to begin with were found before.
            whitening: of the rows in time, whose columns are then rates of the torque's smooth part; they stay as they
                are where None.
        """
        (mean, covariance), dt, memory = self.prior, self.motions[0].dt, None
        for k in range(_STEPS):
            problem = replace(self._at(d, beta, smooth=whitening is not None), known_memory=memory)
            beta, step, spread = (problem.whitened(whitening) if whitening else problem).solve(mean - d, covariance)
            # The prior's share in the rows: after the first step, or from a known delay on, its change is negligible.
            memory = problem.memory if whitening is None and (k or near) else None
            # A step beyond the linear range of the columns would overshoot.
            step = np.clip(step, -COMMON * dt, COMMON * dt)
            d = d + step
            if np.abs(step).max() < _STILL * dt or (np.abs(step) < _SMALL * _se(spread)).all():
                break
        settled = bool((np.abs(step) < np.maximum(_MOVES * dt, _se(spread))).all())
        return _Found(d, beta, problem, spread, settled)

    def beside_a_drift(self, found: _Found) -> _Found | None:
        """What rows that are whitened in time show, where a drift hid the delays from the others.

        Under a drift of the torque the residual's memory is long, few rows count as independent, and the prior decides,
        although what goes with the motion is seen above the drift. Whitened rows show it. They are sensitive to what is
        above the motion, too: in a loop that feeds disturbances back they are wrong. So they are taken only where both
        agree and the whitened ones are much surer, and where the torque has no part in proportion to its second rate: a
        delay leaves none, feedback, a filter or friction that the model lacks does. The jumps of dry friction, which a
        small change of the delay moves by a sample or not at all, tell whitened rows most, and wrongly: delays are
        those of the smooth part of the torque.

        Args:
            found: by the ordinary rows.
        """
        d, beta, problem, spread, _ = found
        dt, se = self.motions[0].dt, _se(spread)
        rows = problem.memory / (self.motions[0].treatment.decimation * dt)
        if rows < _DRIFTS:
            return None
        whitening = problem.whitening
        white = self.steps(d, beta, whitening=whitening)
        surer = (_SURER * _se(white.spread) < se).all() and (np.abs(white.delays - d) < _AGREES * se).all()
        return white if surer and self._alone(white, whitening) else None

    def _alone(self, found: _Found, whitening: Whitening) -> bool:
        """Whether whitened rows have nothing in proportion to the second rate of the torque beside a delay."""
        d, beta = found.delays, found.beta
        (mean, covariance), channels, dt = self.prior, len(d), self.motions[0].dt
        first, second = (
            delay_columns(self.model, self.motions[0], order=order, noise_hz=self.noise_hz) for order in (1, 2)
        )
        columns = [*first, *((channels + k, column) for k, column in second)]
        late = [with_delay(motion, _setting(d)) for motion in self.motions]
        chi = raw_parameters(self.model, beta)
        problem = NuisanceProblem.of(self.model, late, beta, chi, [columns] * len(late))
        free = (_SECOND * dt**2) ** 2 * np.eye(channels)
        known = linalg.block_diag(covariance, free)
        _, step, spread = problem.whitened(whitening).solve(np.append(mean - d, np.zeros(channels)), known)
        return bool((np.abs(step) < _AGREES * _se(spread))[channels:].all())

    def explains(self, d: Array, beta: Array) -> bool:
        """Whether the torque follows the model with these delays, or much better than with those of the prior.

        Where a sign or a channel is wrong, some delay leaves a little less than none, and the bodies' torque shows it
        as that of friction does.
        """
        problem = self._at(d, beta)
        size = np.array([0.0 if m.free else 1.0 / max(m.norm, np.finfo(float).tiny) for m in problem.rows.motors])
        left = problem.residual(size)
        if left <= _ROUGH**2 * np.count_nonzero(size):
            return True
        return left < _MUCH * self._at(self.prior[0], beta).residual(size)

    def settled(self, found: _Found) -> _Found:
        """What was found, or what the smooth part of the torque alone shows.

        Dry friction jumps from one sample to the next. A small change of the delay moves a jump by a sample or not at
        all: where all reversals of a motion lie alike between two samples, the jumps leave the residual as it is over a
        range of delays, and the slope of the sampled torque says otherwise. From there, steps with the smooth torque
        find the minimum within that range. They are taken where they are longer than the standard error and leave a
        smaller residual.

        Args:
            found: by the rate of the whole torque.
        """
        if not any(term.jumps for term in self.model.terms):
            return found
        d, beta, problem, spread, _ = found
        mean, covariance = self.prior
        dt, weights, se = self.motions[0].dt, problem.weights, _se(spread)
        before = np.inf
        for k in range(_STEPS + 1):
            problem = replace(self._at(d, beta, smooth=True), known_memory=problem.memory)
            left = problem.residual(weights)
            beta, step, spread = problem.solve(mean - d, covariance)
            if k == 0:
                before = left
                if (np.abs(step) < se).all():
                    return found
            if k == _STEPS or np.abs(step).max() < _STILL * dt:
                break
            d = d + np.clip(step, -COMMON * dt, COMMON * dt)
        return _Found(d, beta, problem, spread) if left < before else found


def delay_setting(seconds: Array) -> float | tuple[float, ...]:
    """`Treatment.torque_delay_s` of delays, (channels,), s: one value where all channels have the same."""
    values = tuple(float(f"{value:.4g}") for value in seconds)
    return values[0] if len(set(values)) == 1 else values


def usual_delay(logs: Sequence[Log]) -> float:
    """Delay of torques that are commanded from sample to sample, s; none of measured joint torques."""
    return HOLD * max(float(log.dt) for log in logs) if logs[0].channels.torque.side == "motor" else 0.0


def delay_prior(channels: int, dt: float, common: float = COMMON) -> Array:
    """Prior covariance of the delays, (channels, channels), s^2.

    Args:
        channels: of torque.
        dt: sampling period, s.
        common: standard deviation of what all channels share, samples.
    """
    return np.asarray(dt**2 * (common**2 * np.ones((channels, channels)) + OWN**2 * np.eye(channels)))


def _contradicted(model: DynamicModel, motions: Sequence[Motion], d: Array, usual: Array) -> bool:
    """Whether rows near reversals, that the delays are not estimated from, have a greater residual with them.

    The sign of dry friction changes at known times: a drive's delay shows there as well as in smooth motion.

    Args:
        motions: of logs, without a delay.
        d, usual: delays of the channels, and those that they stand against, (channels,), s.
    """
    losses = []
    for delay in (d, usual):
        beta = least_squares(observe(model, *(with_delay(motion, _setting(delay)) for motion in motions)))
        whole = [
            replace(motion, treatment=replace(motion.treatment, reversal_speed=0.0, reversal_guard_s=None))
            for motion in motions
        ]
        rows = observe(model, *(with_delay(motion, _setting(delay)) for motion in whole))
        loss = np.zeros(LOG_PARTS * len(whole))
        part = parts_of(rows, [motion.log for motion in whole if motion.log is not None])
        for motor in (own for own in rows.motors if not own.free):
            e = motor.r_factors[:, :, -1] - motor.r_factors[:, :, :-1] @ beta[motor.columns]
            np.add.at(loss, part, (e**2).sum(axis=1) / max(motor.norm**2, np.finfo(float).tiny))
        losses.append(loss)
    worse = losses[0] - losses[1]
    return bool(worse.sum() > _WORSE * np.sqrt(len(worse)) * worse.std())


def delay_problem(
    model: DynamicModel, motions: Sequence[Motion], beta: Array, noise_hz: float = np.inf, smooth: bool = False
) -> NuisanceProblem:
    """The delays of the channels as nuisances, by the rate of the whole torque, or of its smooth part."""
    columns = delay_columns(model, motions[0], smooth_part if smooth else None, noise_hz=noise_hz)
    return NuisanceProblem.of(model, motions, beta, raw_parameters(model, beta), [columns] * len(motions))


def _rigid_agrees(problem: NuisanceProblem, delay: float, dt: float, noise_hz: float) -> bool:
    """Whether the torque of the rigid bodies alone, next to that of friction, is late by as much.

    Friction that the model lacks is late or early on its own; a drive delays every torque alike.
    """
    model, beta = problem.model, problem.beta
    bodies, everything = (delay_columns(model, problem.motions[0], only, noise_hz=noise_hz) for only in (rigid, None))
    # One delay of the bodies for all channels; what is added for all torque is each channel's own.
    p, n = len(beta), 1 + max(channel for channel, _ in everything)
    columns = [*((0, column) for _, column in bodies), *((1 + channel, column) for channel, column in everything)]
    motions = [with_delay(m, HOLD * dt) for m in problem.motions]
    rows = NuisanceProblem.of(model, motions, beta, raw_parameters(model, beta), [columns] * len(motions)).rows
    solution = solve_excited(rows.motors, problem.weights, np.zeros((0, p + n + 2)))
    spread = clustered(rows, problem.weights, solution, np.eye(p + n + 1)[[p]])
    # The second column holds all torque, the first the bodies' once more: equal delays leave the first at zero.
    own, total = float(solution.beta[p]), float(np.median(solution.beta[p + 1 :]))
    se, late = float(np.sqrt(spread.covariance[0, 0])), own + total + HOLD * dt
    return se < abs(late - HOLD * dt) / _SEEN and abs(late - delay) < 2 * se + 0.5 * dt


def _setting(d: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in d)


def _numbers(values: Array) -> str:
    """Values as text, once where they agree to three digits."""
    texts = [f"{value:.2g}" if abs(value) < 0.1 else f"{value:.3g}" for value in values]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts)
