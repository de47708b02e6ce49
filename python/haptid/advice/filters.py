"""Another cut-off of the position filter, tried on the log itself: the only change for which it is treated again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.edits import Edit
from haptid.advice.rows import TrialRows, trial_rows
from haptid.advice.search import finer, large_enough, paired, unseen_percent, weights_of
from haptid.advice.trial import Bench, Gain, Setting, gain
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from haptid.inference.diagnosis.subsample import MOST_SAMPLES
from haptid.motion.motion import Motion, treat
from haptid.observation.plan import Plan

# Cut-offs that are tried, over the one in use.
_SHARES = (0.125, 0.25, 0.5, 2.0, 4.0)
# Least cut-off over the bandwidth of the motion: a lower one fits this log's motion, and is of no use for another.
_LEAST = 5.0


@dataclass(frozen=True, eq=False)
class OtherFilter:
    """A cut-off with a lower error on unseen blocks.

    Attributes:
        cutoff_hz: of each position channel, or of all.
        motions: treated with it.
        gain: over the cut-off in use.
        before, after, se: unseen errors, per cent, and the paired standard error of their difference.
    """

    cutoff_hz: tuple[float, ...]
    motions: tuple[Motion, ...]
    gain: Gain
    before: float
    after: float
    se: float

    @property
    def edit(self) -> Edit:
        """Of the study."""
        value = list(self.cutoff_hz) if len(self.cutoff_hz) > 1 else self.cutoff_hz[0]
        return Edit("study", "set", ("treatment", "cutoff_hz"), value)


def other_filter(
    model: DynamicModel, motions: Sequence[Motion], beta: Array, bandwidth_hz: float, zero: Sequence[int] = ()
) -> OtherFilter | None:
    """The cut-off of the largest proven gain; None where none is proven, or the log is too long to be treated again.

    The torque and the parallel filter stay as they are, and the rows are those that both have, so that errors compare.

    Args:
        motions: treated signals of the fit.
        beta: base parameters, (p,), SI.
        bandwidth_hz: of the motion.
        zero: those parameters that are fixed at zero.
    """
    cutoff = motions[0].treatment.cutoff_hz
    if cutoff is None or any(m.log is None for m in motions) or sum(map(len, motions)) > MOST_SAMPLES:
        return None
    now = tuple(finer(motion) for motion in motions)
    rows = trial_rows(model, now, beta)
    cutoffs = [np.atleast_1d(cutoff) * share for share in _SHARES]
    tried = [_tried(model, now, rows, beta, zero, hz) for hz in cutoffs if hz.min() >= _LEAST * bandwidth_hz]
    held = [
        one for one in tried if one is not None and one.gain.p * len(_SHARES) < SIGNIFICANCE and large_enough(one.gain)
    ]
    return max(held, key=lambda one: one.gain.share, default=None)


def _tried(
    model: DynamicModel, now: Sequence[Motion], rows: TrialRows, beta: Array, zero: Sequence[int], cutoff: Array
) -> OtherFilter | None:
    """One cut-off, Hz; None where the log has too few samples for it."""
    hz = tuple(float(f"{x:.4g}") for x in cutoff)
    try:
        made = tuple(
            treat(m.log, replace(m.treatment, cutoff_hz=hz if len(hz) > 1 else hz[0])) for m in now if m.log is not None
        )
        # Other positions on the same rows.
        there = trial_rows(model, [replace(m, q=other.q) for m, other in zip(now, made, strict=True)], beta)
    except HaptidError:
        return None
    both = rows.used & there.used & _inside(model, rows, made)
    kept = np.array([k for k in range(len(beta)) if k not in zero])
    bench = Bench(
        {"used": rows.grams(both), "filter": there.grams(both)},
        len(beta), kept, weights_of(rows, len(beta), beta), np.eye(len(rows.y)),
    )  # fmt: skip
    before, after = (bench.run(Setting(rows=key)) for key in ("used", "filter"))
    errors = unseen_percent(model, bench, before), unseen_percent(model, bench, after)
    return OtherFilter(hz, made, gain(before, after), *errors, paired(model, bench, before, after))


def _inside(model: DynamicModel, rows: TrialRows, motions: Sequence[Motion]) -> np.ndarray:
    """Rows clear of the transients of other filters, (rows,)."""
    kept = np.zeros(len(rows.sample), dtype=bool)
    for k, motion in enumerate(motions):
        shared, (low, high) = Plan.of(model, motion).filter, motion.usable
        own = (rows.sample >= low + shared.before) & (rows.sample < high - shared.after)
        kept |= own & (rows.log == k)
    return kept
