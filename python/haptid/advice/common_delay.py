"""A delay that all torque channels share: their torques shifted in time, as one change.

Each channel's own shift is tried too, from the slope of the model's torque. Where a bus or a recorder delays all by
many samples, the slope does not reach so far, and a channel alone shows little of it. Here the torques themselves are
shifted. The shift that one half of the time blocks gives is judged on the other half.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.advice.grams import Grams
from haptid.advice.search import LARGEST_CHANGE, LEAST_SE, Trials, TriedChange
from haptid.advice.trial import Setting, Trial
from haptid.errors import HaptidError
from haptid.motion.motion import Motion, shifted
from haptid.motion.streaming import CUBIC

KIND = "common delay"
# The least shift that is tried, samples, and the ratio of each to the one before.
_LEAST, _RATIO = 0.25, 1.4


def with_common_delay(search: Trials) -> Trials:
    """The search with one shift of all torque channels as a candidate, where it raises no motor's unseen error.

    Not of a single channel, whose own shift is tried, nor of motions without a log.
    """
    bench, motions = search.bench, search.motions
    if bench.motors < 2 or any(motion.log is None for motion in motions) or not search.rows.movable:
        return search
    shifts = _shifts(motions)
    try:
        halves = _halves(search, shifts)
    except HaptidError:  # the log is too short for such a shift
        return search
    every = np.arange(bench.blocks)
    setting, errors = Setting(rows=KIND), np.empty((bench.blocks, bench.motors))
    for half in (0, 1):
        shift = _best(search, shifts, [grams[half : half + 1] for grams in halves])
        if shift is None:
            return search
        shifted = bench.without_candidates().with_rows("used", _grams(search, shift, bench.base))
        fitted, unseen = shifted.fit(Setting(), every[half::2]), slice(1 - half, None, 2)
        errors[unseen] = shifted.errors(fitted, Setting(), None, unseen)
    whole = _best(search, shifts, halves)
    if whole is None or _harms(search.base().errors - errors):
        return search
    bench = bench.with_rows(KIND, _grams(search, whole))
    bench = replace(bench, known={setting: Trial(setting, errors, bench.fit(setting, every))})
    one = TriedChange(KIND, ("all torque channels",), setting, seconds=whole)
    return replace(search, bench=bench, candidates=(*search.candidates, one))


def _shifts(motions: Sequence[Motion]) -> Array:
    """Shifts that are tried, s: of both signs, and none."""
    dt = min(motion.dt for motion in motions)
    count = int(np.log(LARGEST_CHANGE["time shift"] / (_LEAST * dt)) / np.log(_RATIO)) + 1
    sizes = _LEAST * dt * _RATIO ** np.arange(max(count, 2))
    return np.concatenate([-sizes[::-1], [0.0], sizes])


def _best(search: Trials, shifts: Array, halves: Sequence[Grams]) -> float | None:
    """The shift of the least error of the fit, s; None where it is the largest one, or hardly any.

    Args:
        search: of a log.
        shifts: that were tried, s.
        halves: Gram matrices of the base columns for each shift, summed over one or both halves of the blocks.
    """
    losses = []
    for grams in halves:
        bench = search.bench.without_candidates().with_rows("used", grams)
        losses.append(float(bench.errors(bench.fit(Setting(), np.arange(len(grams))), Setting()).sum()))
    at = int(np.argmin(losses))
    if at in (0, len(shifts) - 1) or shifts[at] == 0:
        return None
    near = slice(at - 1, at + 2)
    curve = np.polynomial.Polynomial.fit(shifts[near], losses[near], 2)
    return float(np.clip(curve.deriv().roots()[0], shifts[at - 1], shifts[at + 1]))


def _harms(gains: Array) -> bool:
    """Whether the error of a motor is larger, by more than block errors differ, from gains, (blocks, motors)."""
    spread = np.sqrt(len(gains)) * gains.std(axis=0, ddof=1)
    return bool((gains.sum(axis=0) < -LEAST_SE * spread).any())


def _halves(search: Trials, shifts: Array) -> list[Grams]:
    """Gram matrices of the base columns for each shift, summed over each half of the blocks."""
    rows, order = search.rows.halves(search.bench.base)
    grams = rows.grams()
    return [rows.grams_with_torque(grams, _torque(search, shift)[:, order]) for shift in shifts]


def _grams(search: Trials, shift: float, columns: int | None = None) -> Grams:
    """Gram matrices with all torques of so much earlier, s, as acting: as `TrialRows.grams`."""
    return replace(search.rows, y=_torque(search, shift)).grams(columns=columns)


def _torque(search: Trials, shift: float) -> Array:
    """Torque with that of so much earlier, s, as acting, (motors, rows)."""
    taus = [shifted(motion.tau, shift / motion.dt, CUBIC) for motion in search.motions]
    return np.where(_inside(search), search.rows.torque_of(taus), search.rows.y)


def _inside(search: Trials) -> np.ndarray:
    """Rows whose torque is in the log whatever the shift, (rows,); of the others the torque stays as it is."""
    kept = np.zeros(len(search.rows.sample), dtype=bool)
    for k, (low, high) in _segments(search.motions):
        margin = int(2 * LARGEST_CHANGE["time shift"] / search.motions[k].dt)
        sample = search.rows.sample
        kept |= (search.rows.log == k) & (sample >= low + margin) & (sample < high - margin)
    return kept


def _segments(motions: Sequence[Motion]) -> Iterator[tuple[int, tuple[int, int]]]:
    """Every part without a gap, with the index of its motion."""
    return ((k, segment) for k, motion in enumerate(motions) for segment in motion.segments)
