"""How a log is best treated, from the log itself, with the reasons.

What filters do to a reversal costs more than what they leave of the noise: dry friction jumps there, the motion bends,
and no filter that sees the jump treats torque and columns alike. So the filter is as narrow as the motion allows, and
rows whose filter would see a reversal are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, MotionTooShortError, NoRowsError, TreatmentValueError
from haptid.log import Log
from haptid.motion.channels import check_log, state
from haptid.motion.treatment import Treatment, treat
from haptid.observation.observation import Plan
from haptid.treatment_choice.delay_estimate import find_delay

# Share of the velocity's power that counts as motion.
MOTION = 0.98
# The filter that torque and columns share passes so many times the motion's highest frequency, and the positions'
# filter so many times its own: what the one passes, the other leaves alone.
ABOVE_MOTION, ABOVE_PARALLEL = 3.0, 3.0
# Rows in the period of that filter's cut-off: what folds back is 75 dB down.
ROWS_IN_PERIOD = 10
# A coordinate is slow below this share of its root mean square speed.
SLOW = 0.05
# The filter is widened until each motor keeps this share of its rows, by this factor at a time, so many times at most.
KEPT, WIDER, WIDENINGS = 0.25, 1.25, 6
# A delay is known where its deviation is below this share of the sampling period, and is taken to be none, or half a
# period, where it is nearer than this share and two deviations.
KNOWN, NEAR = 0.1, 0.02
# Frequencies, as shares of half the sampling rate, at which a position has noise alone.
NOISE_BAND = (0.5, 0.9)
# A channel moves where its spectrum rises so far above that noise.
ABOVE_NOISE = 100.0
# Noise above this share of the acceleration is worth a word.
NOISY = 0.1
# A log tells how it is to be treated in much less than its whole length, s.
ENOUGH = 120.0
# Length of the stretches whose spectra are averaged, s.
STRETCH = 8.0
# Samples of such a stretch at least.
FEWEST = 64
# Highest cut-off as a share of half the sampling rate; lowest as a number of periods in the log.
HIGHEST, SHORTEST = 0.7, 10.0


@dataclass(frozen=True)
class Proposal:
    """A treatment and why it is so.

    Attributes:
        treatment: what was asked for, and the rest as proposed.
        reasons: a sentence for each setting that was proposed.
    """

    treatment: Treatment
    reasons: tuple[str, ...]


def propose(model: DynamicModel, *logs: Log, **asked: Any) -> Proposal:
    """A treatment for logs of one device and one instrument.

    Args:
        model: the dynamic model.
        logs: what was recorded; the two minutes of each that move most are looked at.
        asked: settings of `Treatment` that are to be as given.

    Raises:
        TreatmentValueError: a setting that was asked for is impossible.
        CutoffError: a cut-off that was asked for is too high for the sampling rate.
        HaptidError: as `observe` does where a log does not fit the device.
    """
    if asked.get("velocity") is not None:  # it takes positions as they are
        asked = {"cutoff_hz": None, **asked}
    unknown = set(asked) - {field.name for field in fields(Treatment)}
    if unknown or not logs:
        wanted = f"one of {', '.join(field.name for field in fields(Treatment))}" if unknown else "one log at least"
        raise TreatmentValueError("setting" if unknown else "logs", ", ".join(sorted(unknown)), wanted)
    Treatment(**asked)  # impossible settings are an error before any work
    for log in logs:
        check_log(model.device, log)
    logs = tuple(log.busiest(ENOUGH) for log in logs)
    filters, why = _filters(logs, asked)
    slow, why_slow = _slow(model, logs, filters, asked)
    kept, why_kept = _wide_enough(model, logs, slow, asked)
    timed, why_timed = _timed(model, logs, kept, asked)
    noise = () if kept.cutoff_hz is None else (_noise_sentence(logs, kept),)
    return Proposal(timed, (*why, *noise, *why_slow, *why_kept, *why_timed))


Step = tuple[Treatment, tuple[str, ...]]


def _filters(logs: Sequence[Log], asked: Mapping[str, Any]) -> Step:
    """Both cut-offs and the decimation, from the motion's highest frequency."""
    dt = max(float(log.dt) for log in logs)
    highest = max(bandwidth(log) for log in logs)
    wanted = max(ABOVE_MOTION * highest, SHORTEST / min(len(log.t) * log.dt for log in logs))
    if asked.get("cutoff_hz") is not None:
        wanted = asked["cutoff_hz"] / ABOVE_PARALLEL
    parallel = asked.get("parallel_cutoff_hz") or min(wanted, _ceiling(dt, asked))
    made = _with_parallel(parallel, dt, asked)
    motion = f"the motion is below {highest:.2g} Hz ({100 * MOTION:.0f} % of the velocity's power)"
    reasons = []
    if parallel < highest:
        reasons.append(
            f"Torque and columns share a filter of {parallel:.3g} Hz, and {motion}: the filter takes part of it away, "
            f"and rows are few. Record at a higher rate, or ask for less decimation."
        )
    elif "parallel_cutoff_hz" not in asked:
        reasons.append(f"Torque and columns share a filter of {parallel:.3g} Hz: {motion}.")
    if "cutoff_hz" not in asked and made.cutoff_hz is not None:
        why = "so that nothing is bent that torque and columns keep"
        if made.cutoff_hz < 0.99 * ABOVE_PARALLEL * parallel:
            why = "which is all that the sampling rate carries"
        reasons.append(f"Positions pass up to {made.cutoff_hz:.3g} Hz, {why}.")
    if "decimation" not in asked:
        in_period = f"{1 / (parallel * dt * made.decimation):.2g} in the filter's period"
        reasons.append(f"One row is kept of {made.decimation} samples, {in_period}.")
    return made, tuple(reasons)


def _ceiling(dt: float, asked: Mapping[str, Any]) -> float:
    """Highest cut-off, Hz, of the filter that torque and columns share: what the rates of samples and rows carry."""
    ceiling = HIGHEST * 0.5 / dt / ABOVE_PARALLEL
    if "decimation" in asked:
        ceiling = min(ceiling, Treatment(**asked).parallel_shape.share * 0.5 / dt / asked["decimation"])
    return ceiling


def _with_parallel(parallel: float, dt: float, asked: Mapping[str, Any]) -> Treatment:
    """What was asked for, and what follows from the cut-off of the filter that torque and columns share."""
    follows = {
        "parallel_cutoff_hz": parallel,
        "cutoff_hz": min(ABOVE_PARALLEL * parallel, HIGHEST * 0.5 / dt),
        "decimation": max(1, int(1 / (ROWS_IN_PERIOD * parallel * dt))),
    }
    return Treatment(**{**follows, **asked})


def bandwidth(log: Log) -> float:
    """Frequency below which a share MOTION of the power of every channel's velocity lies, Hz."""
    highest = 0.0
    for channel in log.position.T:
        f, power = _spectrum(channel, float(log.dt))
        floor = _floor(f, power)
        if power.max() < ABOVE_NOISE * floor:  # it hardly moves
            continue
        velocity = (2 * np.pi * f) ** 2 * np.maximum(power - floor, 0.0)
        highest = max(highest, float(f[np.searchsorted(np.cumsum(velocity), MOTION * velocity.sum())]))
    return highest


def _spectrum(channel: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies, Hz, and power density of a position, rad^2/Hz or m^2/Hz."""
    f, power = signal.welch(channel, 1 / dt, nperseg=min(len(channel), max(FEWEST, round(STRETCH / dt))))
    return np.asarray(f), np.asarray(power)


def _floor(f: Array, power: Array) -> float:
    """Power density of a position's noise: of what is at frequencies without motion."""
    low, high = (share * f[-1] for share in NOISE_BAND)
    return float(np.median(power[(f >= low) & (f <= high)]))


def _noise_sentence(logs: Sequence[Log], treatment: Treatment) -> str:
    """What the positions' noise is beside the acceleration, where it is worst."""
    worst, deviation, unit = 0.0, 0.0, ""
    for log in logs:
        motion = treat(log, treatment)
        start, stop = motion.usable
        power = np.mean(motion.kinematics(start, stop)[2] ** 2, axis=1)
        for k, channel in enumerate(log.position.T):
            floor = _floor(*_spectrum(channel, motion.dt))
            assert treatment.cutoff_hz is not None
            noise = floor * (2 * np.pi) ** 4 * treatment.cutoff_hz**5 / 5  # white positions, differentiated twice
            share = float(np.sqrt(noise / power[k])) if power[k] else 0.0
            if share >= worst:
                worst, deviation = share, float(np.sqrt(floor * 0.5 / motion.dt))
                unit = "m" if log.channels.position.unit in ("m", "mm", "um") else "rad"
    sentence = (
        f"The noise of the positions, {deviation:.1g} {unit}, is {100 * worst:.2g} % of the filtered acceleration"
    )
    return sentence + ("." if worst < NOISY else ": record faster motion, or read the positions finer.")


def _slow(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, asked: Mapping[str, Any]) -> Step:
    """Below which speed a motor's dry friction is not to be trusted."""
    rows = len(model.device.row_names)
    if "reversal_speed" in asked or not any(model.coulomb_terms(row) for row in range(rows)):
        return treatment, ()
    speeds = np.full(rows, np.inf)
    states = [_states(model, log, treatment) for log in logs]
    samples = sum(cd.shape[1] for _, cd in states)
    for row in range(rows):
        for term in model.coulomb_terms(row):
            power = sum(float(np.sum(model.speed(term, c, cd) ** 2)) for c, cd in states) / samples
            speeds[row] = min(speeds[row], SLOW * float(np.sqrt(power)))
    low = tuple(float(f"{v:.2g}") if np.isfinite(v) else 0.0 for v in speeds)
    return replace(treatment, reversal_speed=low), ()


def _states(model: DynamicModel, log: Log, treatment: Treatment) -> tuple[Array, Array]:
    """The coordinates' positions and velocities, each (coordinates, samples)."""
    motion = treat(log, treatment)
    return state(model.device, motion, *motion.usable)


def _wide_enough(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, asked: Mapping[str, Any]) -> Step:
    """A filter short enough for each motor to keep a share of its rows between reversals."""
    if not np.any(treatment.reversal_speed):
        return treatment, ()
    narrow, dt = treatment, max(float(log.dt) for log in logs)
    before = shares = _shares(model, logs, treatment)
    for _ in range(0 if "parallel_cutoff_hz" in asked else WIDENINGS):
        wider = WIDER * (treatment.parallel_cutoff_hz or 0.0)
        if min(shares) >= KEPT or wider > _ceiling(dt, asked):
            break
        treatment = _with_parallel(wider, dt, {**asked, "reversal_speed": treatment.reversal_speed})
        shares = _shares(model, logs, treatment)
    reasons = []
    if min(shares) < KEPT:  # it did not help, and costs noise
        treatment, shares = narrow, before
        reasons.append(
            f"Less than {100 * KEPT:.0f} % of a motor's rows are clear of reversals, whatever the filter: record "
            f"motion that turns round less often, or lower `reversal_speed`."
        )
    elif treatment is not narrow:
        reasons.append(
            f"The filter was widened from {narrow.parallel_cutoff_hz:.3g} to {treatment.parallel_cutoff_hz:.3g} Hz: "
            f"between the many reversals, a longer one leaves a motor less than {100 * KEPT:.0f} % of its rows."
        )
    kept = ", ".join(f"{100 * share:.0f}" for share in shares)
    speeds = ", ".join(f"{v:.2g}" for v in np.atleast_1d(treatment.reversal_speed))
    reasons.append(
        f"Rows whose filter sees a motion slower than {speeds} (of each motor, SI) are left out: dry friction jumps "
        f"there. {kept} % of the motors' rows are kept."
    )
    return treatment, tuple(reasons)


def _shares(model: DynamicModel, logs: Sequence[Log], treatment: Treatment) -> list[float]:
    """Of each motor whose torque is known, the share of rows that are kept."""
    kept, many = np.zeros(len(model.device.row_names)), 0
    for log in logs:
        try:
            plan = Plan.of(model, treat(log, treatment))
        except MotionTooShortError:  # not one row: a wider filter may find some
            continue
        for start, stop in plan.segments():
            kept += plan.weights(start, stop).sum(axis=1)
        many += plan.rows
    return [float(share) for share in kept[list(model.device.measured)] / max(many, 1)]


def _timed(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, asked: Mapping[str, Any]) -> Step:
    """With the torque's delay."""
    if "torque_delay_s" in asked:
        return treatment, ()
    rates = sorted({f"{log.rate_hz:.4g}" for log in logs})
    if len(rates) > 1:
        many = " and ".join(rates)
        return treatment, (
            f"How late the torque is was not looked for: the logs have {many} Hz. Give `torque_delay_s`.",
        )
    dt = float(logs[0].dt)
    plain = treatment
    if treatment.velocity is not None:  # a differentiator is late itself, which is no delay of the torque
        cutoff = ABOVE_PARALLEL * min(treatment.parallel_cutoff_hz or np.inf, _ceiling(dt, {}))
        plain = replace(treatment, velocity=None, cutoff_hz=cutoff)
    try:
        delay = find_delay(model, logs, plain)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        delay = None
    if delay is None or delay.se > KNOWN * dt:
        return treatment, ("The logs do not tell how late the torque is; it is taken as it is.",)
    found = f"{1e3 * delay.seconds:.3g} ms (deviation {1e3 * delay.se:.1g} ms)"
    near = NEAR * dt + 2 * delay.se
    if abs(delay.seconds) < near:
        return treatment, (f"The torque is not late, within what the logs tell: {found}.",)
    if abs(delay.seconds - dt / 2) < near:
        held = f"The torque is late by {found}: half a sampling period, as a command is that is held until the next."
        return replace(treatment, torque_delay_s=dt / 2), (held,)
    return replace(treatment, torque_delay_s=delay.seconds), (f"The torque is late by {found}: compensated.",)
