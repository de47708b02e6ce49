"""Proposed treatment of a log, from the log itself, with the reasons.

Distortion of reversals by a filter costs more than the noise that it leaves: dry friction is discontinuous there, and
no filter across the jump treats torque and columns alike. So the filter is as short as the motion allows, and rows
whose filter window contains a reversal are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, MotionTooShortError, NoRowsError
from haptid.log import Log
from haptid.motion.channels import check_log, state
from haptid.motion.filters import bad_setting
from haptid.motion.treatment import Treatment, treat
from haptid.observation.plan import Plan
from haptid.treatment_choice.delay_estimate import find_delay

# Share of the velocity's power that counts as motion.
_MOTION = 0.98
# Cut-off of the parallel filter over the motion's highest frequency, and of the position filter over that of the
# parallel filter: each passes the band of the one before unchanged.
ABOVE_MOTION, ABOVE_PARALLEL = 3.0, 3.0
# Rows per period of the parallel filter's cut-off: aliases are 75 dB down.
ROWS_IN_PERIOD = 10
# Share of its root mean square speed below which a coordinate is slow.
SLOW = 0.05
# Least share of each motor's rows to keep; the filter is widened by a factor, this many times at most, to reach it.
KEPT, WIDER, WIDENINGS = 0.25, 1.25, 6
# Largest standard error of a known delay, and distance from zero or half a period below which it is taken as that (plus
# two standard errors), as shares of the sampling period.
KNOWN, NEAR = 0.1, 0.02
# Frequencies without motion, as shares of half the sampling rate, where a position's noise is measured.
NOISE_BAND = (0.5, 0.9)
# A channel moves where its spectrum exceeds that noise by this factor.
ABOVE_NOISE = 100.0
# Noise above this share of the acceleration is reported.
NOISY = 0.1
# Length of the part of each log that is analysed, s.
_ENOUGH = 120.0
# Length of the segments whose spectra are averaged (Welch), s, and their fewest samples.
STRETCH, FEWEST = 8.0, 64
# Highest cut-off as a share of half the sampling rate; lowest as a number of periods in the log.
HIGHEST, SHORTEST = 0.7, 10.0


@dataclass(frozen=True)
class Proposal:
    """Proposed treatment with reasons.

    Attributes:
        treatment: the settings that were given, and the others as proposed.
        reasons: a sentence for each proposed setting.
    """

    treatment: Treatment
    reasons: tuple[str, ...]


def propose(model: DynamicModel, *logs: Log, **given: Any) -> Proposal:
    """Propose a treatment for logs of one device, recorded by one instrument.

    Args:
        model: the dynamic model.
        logs: recordings; the two most active minutes of each are analysed.
        given: settings of `Treatment` that are fixed.

    Raises:
        TreatmentError: a given setting is impossible, or a given cut-off too high for the sampling rate.
        HaptidError: as `observe` where a log does not fit the device.
    """
    if given.get("velocity") is not None:  # it takes unfiltered positions
        given = {"cutoff_hz": None, **given}
    unknown = set(given) - {field.name for field in fields(Treatment)}
    if unknown or not logs:
        wanted = f"one of {', '.join(field.name for field in fields(Treatment))}" if unknown else "one log at least"
        raise bad_setting("setting" if unknown else "logs", ", ".join(sorted(unknown)), wanted)
    Treatment(**given)  # impossible settings are an error before any work
    for log in logs:
        check_log(model.device, log)
    logs = tuple(part for log in logs for part in log.busiest(_ENOUGH).parts())
    filters, why = _filters(logs, given)
    slow, why_slow = _slow(model, logs, filters, given)
    kept, why_kept = _wide_enough(model, logs, slow, given)
    timed, why_timed = _timed(model, logs, kept, given)
    noise = () if kept.cutoff_hz is None else (_noise_sentence(logs, kept),)
    return Proposal(timed, (*why, *noise, *why_slow, *why_kept, *why_timed))


_Step = tuple[Treatment, tuple[str, ...]]


def _filters(logs: Sequence[Log], given: Mapping[str, Any]) -> _Step:
    """Both cut-offs and the decimation, from the motion's highest frequency."""
    dt = max(float(log.dt) for log in logs)
    highest = max(bandwidth(log) for log in logs)
    wanted = max(ABOVE_MOTION * highest, SHORTEST / min(len(log.t) * log.dt for log in logs))
    if given.get("cutoff_hz") is not None:
        wanted = given["cutoff_hz"] / ABOVE_PARALLEL
    parallel = given.get("parallel_cutoff_hz") or min(wanted, _ceiling(dt, given))
    made = _with_parallel(parallel, dt, given)
    motion = f"the motion is below {highest:.2g} Hz ({100 * _MOTION:.0f} % of the velocity's power)"
    reasons = []
    if parallel < highest:
        reasons.append(
            f"Parallel filter of torque and columns: {parallel:.3g} Hz, but {motion}: the filter removes part of it, "
            f"and rows are few. Record at a higher rate, or reduce the decimation."
        )
    elif "parallel_cutoff_hz" not in given:
        reasons.append(f"Parallel filter of torque and columns: {parallel:.3g} Hz; {motion}.")
    if "cutoff_hz" not in given and made.cutoff_hz is not None:
        why = "three times the parallel filter, so it does not distort its pass band"
        if made.cutoff_hz < 0.99 * ABOVE_PARALLEL * parallel:
            why = "the highest cut-off at this sampling rate"
        reasons.append(f"Position filter: {made.cutoff_hz:.3g} Hz, {why}.")
    if "decimation" not in given:
        in_period = f"{1 / (parallel * dt * made.decimation):.2g} rows per period of the parallel filter's cut-off"
        reasons.append(f"Decimation: one row of {made.decimation} samples, {in_period}.")
    return made, tuple(reasons)


def _ceiling(dt: float, given: Mapping[str, Any]) -> float:
    """Highest cut-off of the parallel filter, Hz, by the rates of samples and rows."""
    ceiling = HIGHEST * 0.5 / dt / ABOVE_PARALLEL
    if "decimation" in given:
        ceiling = min(ceiling, Treatment(**given).parallel_shape.share * 0.5 / dt / given["decimation"])
    return ceiling


def _with_parallel(parallel: float, dt: float, given: Mapping[str, Any]) -> Treatment:
    """The given settings, and those that follow from the cut-off of the parallel filter."""
    follows = {
        "parallel_cutoff_hz": parallel,
        "cutoff_hz": min(ABOVE_PARALLEL * parallel, HIGHEST * 0.5 / dt),
        "decimation": max(1, int(1 / (ROWS_IN_PERIOD * parallel * dt))),
    }
    return Treatment(**{**follows, **given})


def bandwidth(log: Log) -> float:
    """Bandwidth of the motion: frequency below which a share MOTION of every channel's velocity power lies, Hz."""
    highest = 0.0
    for channel in log.position.T:
        f, power = _spectrum(channel, float(log.dt))
        floor = _floor(f, power)
        if power.max() < ABOVE_NOISE * floor:  # it hardly moves
            continue
        velocity = (2 * np.pi * f) ** 2 * np.maximum(power - floor, 0.0)
        highest = max(highest, float(f[np.searchsorted(np.cumsum(velocity), _MOTION * velocity.sum())]))
    return highest


def _spectrum(channel: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies, Hz, and power density of a position, rad^2/Hz or m^2/Hz."""
    f, power = signal.welch(channel, 1 / dt, nperseg=min(len(channel), max(FEWEST, round(STRETCH / dt))))
    return np.asarray(f), np.asarray(power)


def _floor(f: Array, power: Array) -> float:
    """Power density of a position's noise, from frequencies without motion."""
    low, high = (share * f[-1] for share in NOISE_BAND)
    return float(np.median(power[(f >= low) & (f <= high)]))


def _noise_sentence(logs: Sequence[Log], treatment: Treatment) -> str:
    """Report of the positions' noise compared with the acceleration, for the worst channel."""
    worst, noise_rms, unit = 0.0, 0.0, ""
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
                worst, noise_rms = share, float(np.sqrt(floor * 0.5 / motion.dt))
                unit = "m" if log.channels.position.unit in ("m", "mm", "um") else "rad"
    sentence = (
        f"The noise of the positions, {noise_rms:.1g} {unit} RMS, is {100 * worst:.2g} % of the filtered acceleration"
    )
    return sentence + ("." if worst < NOISY else ": record faster motion, or with a finer encoder.")


def _slow(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, given: Mapping[str, Any]) -> _Step:
    """With `reversal_speed`: the speed below which the sign of a motor's dry friction is uncertain."""
    rows = len(model.device.row_names)
    if "reversal_speed" in given or not any(model.coulomb_terms(row) for row in range(rows)):
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


def _wide_enough(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, given: Mapping[str, Any]) -> _Step:
    """With a parallel filter short enough for each motor to keep a share KEPT of its rows between reversals."""
    if not np.any(treatment.reversal_speed):
        return treatment, ()
    narrow, dt = treatment, max(float(log.dt) for log in logs)
    before = shares = _shares(model, logs, treatment)
    for _ in range(0 if "parallel_cutoff_hz" in given else WIDENINGS):
        wider = WIDER * (treatment.parallel_cutoff_hz or 0.0)
        if min(shares) >= KEPT or wider > _ceiling(dt, given):
            break
        treatment = _with_parallel(wider, dt, {**given, "reversal_speed": treatment.reversal_speed})
        shares = _shares(model, logs, treatment)
    reasons = []
    if min(shares) < KEPT:  # widening did not help, and lets more noise through
        treatment, shares = narrow, before
        reasons.append(
            f"Less than {100 * KEPT:.0f} % of a motor's rows are clear of reversals with any filter: record motion "
            f"with fewer reversals, or lower `reversal_speed`."
        )
    elif treatment is not narrow:
        reasons.append(
            f"The parallel filter was widened from {narrow.parallel_cutoff_hz:.3g} to "
            f"{treatment.parallel_cutoff_hz:.3g} Hz: with a longer one a motor keeps less than {100 * KEPT:.0f} % of "
            f"its rows between the reversals."
        )
    kept = ", ".join(f"{100 * share:.0f}" for share in shares)
    speeds = ", ".join(f"{v:.2g}" for v in np.atleast_1d(treatment.reversal_speed))
    reasons.append(
        f"Rows whose filter window contains motion slower than {speeds} (of each motor, SI) are dropped, because dry "
        f"friction is discontinuous at reversals. {kept} % of the motors' rows are kept."
    )
    return treatment, tuple(reasons)


def _shares(model: DynamicModel, logs: Sequence[Log], treatment: Treatment) -> list[float]:
    """Share of rows that are kept, of each motor with measured torque."""
    kept, many = np.zeros(len(model.device.row_names)), 0
    for log in logs:
        try:
            plan = Plan.of(model, treat(log, treatment))
        except MotionTooShortError:  # no rows with this filter: a wider one may give some
            continue
        for start, stop in plan.segments():
            kept += plan.weights(start, stop).sum(axis=1)
        many += plan.rows
    return [float(share) for share in kept[list(model.device.measured)] / max(many, 1)]


def _timed(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, given: Mapping[str, Any]) -> _Step:
    """With `torque_delay_s`."""
    if "torque_delay_s" in given:
        return treatment, ()
    rates = sorted({f"{log.rate_hz:.4g}" for log in logs})
    if len(rates) > 1:
        many = " and ".join(rates)
        return treatment, (f"The torque delay was not estimated: the logs have {many} Hz. Set `torque_delay_s`.",)
    dt = float(logs[0].dt)
    plain = treatment
    if treatment.velocity is not None:  # the lag of a differentiator is not a delay of the torque
        cutoff = ABOVE_PARALLEL * min(treatment.parallel_cutoff_hz or np.inf, _ceiling(dt, {}))
        plain = replace(treatment, velocity=None, cutoff_hz=cutoff)
    try:
        delay = find_delay(model, logs, plain)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        delay = None
    if delay is None or delay.se > KNOWN * dt:
        return treatment, ("The torque delay is not identifiable from the logs; none is assumed.",)
    found = f"{1e3 * delay.seconds:.3g} ms (standard error {1e3 * delay.se:.1g} ms)"
    near = NEAR * dt + 2 * delay.se
    if abs(delay.seconds) < near:
        return treatment, (f"The torque delay is zero within its uncertainty: {found}.",)
    if abs(delay.seconds - dt / 2) < near:
        hold = f"Torque delay: {found}: half a sampling period, as of a command with zero-order hold."
        return replace(treatment, torque_delay_s=dt / 2), (hold,)
    return replace(treatment, torque_delay_s=delay.seconds), (f"Torque delay: {found}: compensated.",)
