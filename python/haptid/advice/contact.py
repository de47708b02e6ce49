"""Contacts: parts of logs in which something touches the device, found by residuals that its state does not explain."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.signals import running_mean
from haptid.advice.rows import TrialRows
from haptid.advice.trial import Bench, Setting

# Kinds of parts that the residual alone shows.
BY_RESIDUAL = ("contact", "rest", "start")

# A contact: residual power over its median, smoothed over so long, s; the most rows and episodes of it; how near the
# state is to that of other rows, over what is usual; rows further apart than this are other passages, s.
_CONTACT, _CONTACT_S, _MOST_MASKED, _MOST_CONTACTS, _NEAR, _APART_S, _SPACING_S = 12.0, 0.3, 0.4, 12, 2.0, 1.0, 0.05

# Rows whose distance from others is the usual one.
_SOME = 500
# Share of the usual speed below which a coordinate rests, and below which it stands, for so long, s.
_REST, _STANDS, _STANDS_S = 0.1, 0.02, 0.1
# Usual speed over the fastest coordinate's up to which one is held.
_HELD = 0.01
# Share of the flagged rows from which on they are at rest, or after it.
_MOSTLY = 0.5


def contact(rows: TrialRows, bench: Bench) -> tuple[np.ndarray, float]:
    """Rows in which the residual is far above that of the others, for a few parts of the log, (rows,), and how far.

    The latter is the power of their residual over the median one, 0 where there are none. A term that the model lacks
    is a function of the state; a hand on the device is not: `elsewhere`.

    Args:
        rows: of all logs.
        bench: of fits to them, without candidates.
    """
    use: np.ndarray = np.asarray(rows.used.any(axis=0))
    none: np.ndarray = np.zeros(rows.used.shape[1], dtype=bool)
    flagged = none
    step = float(np.median(np.diff(rows.t))) or 1.0
    width = max(3, round(_CONTACT_S / step))
    left_out = None
    # A contact distorts the first fit, so that all of the log has a residual: the first limits are low.
    for limit in (_CONTACT / 4, _CONTACT / 2, _CONTACT, _CONTACT):
        if left_out is None or (flagged != left_out).any():
            left_out, smooth = flagged, running_mean(_power_without(flagged, rows, bench), width)
            median = float(np.median(smooth[use]))
        if limit < _CONTACT:
            flagged = smooth > max(limit * median, _quantile(smooth[use]))
            continue
        high = smooth > limit * median
        if not high.any():
            return none, 0.0
        from scipy import ndimage  # slow to import, and few logs have such rows

        # Rows that are not used, at reversals, do not end an episode.
        flagged = ndimage.binary_closing(high, iterations=width)
        flagged = ndimage.binary_dilation(flagged, iterations=width // 2)
        if not 0 < (flagged & use).sum() < _MOST_MASKED * use.sum():
            return none, 0.0
    runs = int((np.diff(flagged.astype(int)) == 1).sum())
    flagged = flagged & use
    if runs > _MOST_CONTACTS:
        return none, 0.0
    return flagged, float(np.median(smooth[flagged])) / max(median, np.finfo(float).tiny)


def _power_without(flagged: np.ndarray, rows: TrialRows, bench: Bench) -> Array:
    """Power of the residuals of a fit without flagged rows, the mean of all motors, (rows,)."""
    clean = bench.with_rows("clean", rows.grams(np.broadcast_to(~flagged, rows.used.shape), bench.base))
    fitted = clean.fit(Setting(rows="clean"), np.arange(bench.blocks))
    e = np.where(rows.used, rows.y - rows.W[:, :, fitted.columns] @ fitted.theta, np.nan) * bench.weights[:, None]
    return np.asarray(np.nan_to_num(np.nanmean(np.where(rows.used.any(axis=0), e, 0.0) ** 2, axis=0)))


def kind_of(rows: TrialRows, flagged: np.ndarray) -> str:
    """What flagged rows are: a contact, or at rest or just after it, where dry friction is not what it is in motion."""
    if at_rest(rows)[flagged].mean() > _MOSTLY:
        return "rest"
    return "start" if _leaves_rest(rows, flagged) else "contact"


def at_rest(rows: TrialRows, share: float = _REST) -> np.ndarray:
    """Rows in which no coordinate moves at more than a share of its usual speed, (rows,); held ones have none."""
    usual = np.sqrt(np.mean(rows.velocity**2, axis=1, keepdims=True))
    moving = usual[:, 0] > _HELD * usual.max()
    return np.asarray((np.abs(rows.velocity[moving]) <= share * usual[moving]).all(axis=0))


def _leaves_rest(rows: TrialRows, flagged: np.ndarray) -> bool:
    """Whether most flagged rows are of parts that begin as the device sets off, after no coordinate has moved.

    Dry friction is not what it is in motion there: it builds up, breaks away, or a brake lets go.
    """
    width = max(2, round(_STANDS_S / (float(np.median(np.diff(rows.t))) or 1.0)))
    # Of rows that end such a stretch, so that no reversal is one.
    moves = np.cumsum(np.concatenate([np.ones(width, dtype=bool), ~at_rest(rows, _STANDS)]))
    stood = moves[width:] == moves[:-width]
    near, early, before = 0, False, -1
    for k in np.flatnonzero(flagged):
        if before < 0 or rows.log[k] != rows.log[before] or rows.t[k] - rows.t[before] > _CONTACT_S:  # a part begins
            just = (rows.log == rows.log[k]) & (np.abs(rows.t[k] - _CONTACT_S - rows.t) <= _CONTACT_S)
            early = bool(stood[just].any())
        near, before = near + early, int(k)
    return near > _MOSTLY * int(flagged.sum())


def _quantile(power: Array) -> float:
    """Power above which there are half as many rows as may be left out."""
    return float(np.quantile(power, 1 - 0.5 * _MOST_MASKED))


def elsewhere(rows: TrialRows, flagged: np.ndarray) -> bool:
    """Whether the states of flagged rows are as near to those of other passages' unflagged rows as any states are."""
    from scipy.spatial import cKDTree  # slow to import, and few logs have such rows

    use = rows.used.any(axis=0)
    state = np.vstack([rows.position, rows.velocity])
    state = state / np.maximum(state.std(axis=1, keepdims=True), 1e-300)
    stride = max(1, round(_SPACING_S / (float(np.median(np.diff(rows.t))) or 1.0)))
    every = np.flatnonzero(use & ~flagged)
    clean = every[::stride]
    tree = cKDTree(state[:, clean].T)

    def distance(which: np.ndarray) -> float:
        near, at = tree.query(state[:, which].T, k=min(60, len(clean)))
        other = np.where(np.abs(rows.t[clean[at]] - rows.t[which][:, None]) > _APART_S, near, np.inf)
        return float(np.median(other.min(axis=1)))

    # Of all rows: where the motion repeats itself, those of the tree may meet each other exactly.
    some = np.unique(np.linspace(0, len(every) - 1, _SOME).astype(int))
    return distance(np.flatnonzero(flagged & use)) < _NEAR * distance(every[some])
