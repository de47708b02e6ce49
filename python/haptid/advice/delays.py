"""Delays of torque channels, of all together or of one: the torques themselves shifted in time, as one change.

Small shifts of each channel are tried from the slope of the model's torque. Where a bus or a recorder delays torques by
many samples, the slope does not reach so far. The shift that one half of the time blocks gives is judged on the other
half.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.advice.grams import Grams
from haptid.advice.proof import LARGEST_CHANGE
from haptid.advice.search import LEAST_GAIN, LEAST_SE, Trials, TriedChange
from haptid.advice.trial import Setting, Trial, gain
from haptid.errors import HaptidError
from haptid.motion.motion import Motion, shifted, with_delay
from haptid.motion.streaming import CUBIC
from haptid.observation.plan import Plan

COMMON_DELAY, TIME_SHIFT = "common delay", "time shift"
# The least shift that is tried, samples, and the ratio of each to the one before; times that it is made finer.
_LEAST, _RATIO, _FINER = 0.25, 1.4, 2


def with_delays(search: Trials) -> Trials:
    """The search with shifts of torques as candidates, where they raise no motor's unseen error.

    One of all channels, where there are several, and one of each channel for which the slope of its torque helps. None
    of motions without a log.
    """
    bench, motions = search.bench, search.motions
    if any(motion.log is None for motion in motions) or not search.rows.movable:
        return search
    measured = search.torques.measured
    which = [measured] if len(measured) > 1 else []
    if search.torques.scales is not None:
        base = search.base()
        slopes = [one for one in search.candidates if one.kind == TIME_SHIFT]
        which += [one.indices for one in slopes if gain(base, bench.run(one.setting)).share > LEAST_GAIN]
    if not which:
        return search
    shifts = _shifts(motions)
    try:
        tried = _halves(search, shifts)
        for motors in which:
            search = _with_delay(search, motors, shifts, tried)
    except HaptidError:  # the log is too short for such a shift
        return search
    return search


def with_shift(search: Trials, motions: Sequence[Motion], one: TriedChange) -> tuple[Motion, ...]:
    """The motions of logs with the torques shifted as a candidate of `with_delays`, of this search, has them."""
    made = []
    for motion in motions:
        now = np.broadcast_to(motion.treatment.torque_delay_s, motion.tau.shape[1]).astype(float)
        now[shifted_channels(search, one)] += one.seconds
        made.append(with_delay(motion, tuple(now.tolist())))
    return tuple(made)


def _with_delay(search: Trials, which: tuple[int, ...], shifts: Array, tried: Sequence[Grams]) -> Trials:
    """The search with a shift of some torque channels; as it is where there is no such shift, or it harms.

    Args:
        search: of a log.
        which: motors whose torques are shifted.
        shifts: that were tried, s.
        tried: Gram matrices of the base columns for each shift of all channels, summed over each half of the blocks.
    """
    bench, every = search.bench, np.arange(search.bench.blocks)
    name = COMMON_DELAY if len(which) > 1 else TIME_SHIFT
    setting, errors = Setting(rows=f"{name} {which}"), np.empty((bench.blocks, bench.motors))
    for half in (0, 1):
        shift = _best(search, which, shifts, tried, slice(half, half + 1))
        if shift is None:
            return search
        late = bench.without_candidates().with_rows("used", _grams(search, shift, which, bench.base))
        fitted, unseen = late.fit(Setting(), every[half::2]), slice(1 - half, None, 2)
        errors[unseen] = late.errors(fitted, Setting(), None, unseen)
    whole = _best(search, which, shifts, tried, slice(None))
    if whole is None or _harms((search.base().errors - errors)[:, list(search.torques.measured)]):
        return search
    bench = bench.with_rows(setting.rows, _grams(search, whole, which))
    bench = replace(bench, known=bench.known | {setting: Trial(setting, errors, bench.fit(setting, every))})
    labels = [search.model.device.row_labels[row] for row in search.model.known_rows]
    places = ("all torque channels",) if name == COMMON_DELAY else tuple(labels[k] for k in which)
    one = TriedChange(name, places, setting, indices=which, seconds=whole)
    return replace(search, bench=bench, candidates=(*search.candidates, one))


def shifted_channels(search: Trials, one: TriedChange) -> list[int] | slice:
    """Torque channels that a candidate of `with_delays` shifts: that of a motor, or all."""
    own = search.torques.of(one.indices[0])
    return slice(None) if one.kind == COMMON_DELAY or own is None else [own]


def _shifts(motions: Sequence[Motion]) -> Array:
    """Shifts that are tried, s: of both signs, and none."""
    dt = min(motion.dt for motion in motions)
    count = int(np.log(LARGEST_CHANGE[TIME_SHIFT] / (_LEAST * dt)) / np.log(_RATIO)) + 1
    sizes = _LEAST * dt * _RATIO ** np.arange(max(count, 2))
    return np.concatenate([-sizes[::-1], [0.0], sizes])


def _best(search: Trials, which: tuple[int, ...], shifts: Array, tried: Sequence[Grams], half: slice) -> float | None:
    """The shift of the least error of the fit, s, as of `_with_delay`; None where it is the largest one, or hardly any.

    Args:
        search, which, shifts, tried: as of `_with_delay`.
        half: of the blocks that are fitted, or both.
    """
    plain = tried[len(shifts) // 2]
    losses = [_loss(search, _mixed(grams, plain, which)[half]) for grams in tried]
    at = int(np.argmin(losses))
    if at in (0, len(shifts) - 1) or shifts[at] == 0:
        return None
    x, y = shifts[at - 1 : at + 2], losses[at - 1 : at + 2]
    for _ in range(_FINER):  # the losses of shifts many samples apart are no parabola
        x = _lowest(x, y) + 0.25 * (x[-1] - x[0]) * np.array([-0.5, 0.0, 0.5])
        y = [_loss(search, _mixed(grams, plain, which)[half]) for grams in _halves(search, x)]
    return _lowest(x, y)


def _mixed(late: Grams, plain: Grams, which: tuple[int, ...]) -> Grams:
    """Gram matrices of a shift of some motors' torques: each motor's own is that of its rows."""
    values = plain.values.copy()
    values[:, which] = late.values[:, which]
    return replace(plain, values=values)


def _lowest(x: Array, y: Sequence[float]) -> float:
    """Where the parabola through three points is lowest, between them."""
    curve = np.polynomial.Polynomial.fit(x, y, 2)
    return float(np.clip(curve.deriv().roots()[0], x[0], x[-1]) if curve.coef[2] > 0 else x[int(np.argmin(y))])


def _loss(search: Trials, grams: Grams) -> float:
    """Squared error of the fit to all of these blocks."""
    bench = search.bench.without_candidates().with_rows("used", grams)
    return float(bench.errors(bench.fit(Setting(), np.arange(len(grams))), Setting()).sum())


def _harms(gains: Array) -> bool:
    """Whether the error of a motor is larger, by more than block errors differ, from gains, (blocks, motors).

    Not asked of joints that nothing drives: less is left of their rows where parameters are too small, by late torques.
    """
    spread = np.sqrt(len(gains)) * gains.std(axis=0, ddof=1)
    return bool((gains.sum(axis=0) < -LEAST_SE * spread).any())


def _halves(search: Trials, shifts: Array) -> list[Grams]:
    """Gram matrices of the base columns for each shift of all channels, summed over each half of the blocks."""
    inside = _inside(
        search, LARGEST_CHANGE[TIME_SHIFT]
    )  # rows that one shift has and another has not are no measure of it
    rows, order = replace(search.rows, used=search.rows.used & inside).halves(search.bench.base)
    grams = rows.grams()
    return [rows.grams_with_torque(grams, _torque(search, shift)[:, order]) for shift in shifts]


def _grams(search: Trials, shift: float, which: tuple[int, ...], columns: int | None = None) -> Grams:
    """Gram matrices with the torques of so much earlier, s, as acting: as `TrialRows.grams`."""
    y = np.array(search.rows.y)
    y[list(which)] = _torque(search, shift)[list(which)]
    return replace(search.rows, y=y).grams(columns=columns)


def _torque(search: Trials, shift: float) -> Array:
    """Torque with that of so much earlier, s, as acting, (motors, rows)."""
    taus = [shifted(motion.tau, shift / motion.dt, CUBIC) for motion in search.motions]
    return np.where(_inside(search, abs(shift)), search.rows.torque_of(taus), search.rows.y)


def _inside(search: Trials, seconds: float) -> np.ndarray:
    """Rows whose torque so much earlier or later, s, is in the log, (rows,); of the others it stays as it is."""
    kept, sample = np.zeros(len(search.rows.sample), dtype=bool), search.rows.sample
    for k, (low, high) in _segments(search.motions):
        shared, margin = Plan.of(search.model, search.motions[k]).filter, int(np.ceil(seconds / search.motions[k].dt))
        own = (sample >= low + margin + shared.before) & (sample < high - margin - shared.after)
        kept |= (search.rows.log == k) & own
    return kept


def _segments(motions: Sequence[Motion]) -> Iterator[tuple[int, tuple[int, int]]]:
    """Every part without a gap, with the index of its motion."""
    return ((k, segment) for k, motion in enumerate(motions) for segment in motion.segments)
