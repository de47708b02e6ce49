"""Logs that are of another device than the others, or of another setting of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.advice.rows import TrialRows
from haptid.advice.trial import Bench, Setting

# Power of a log's residual under the fit of the others, over theirs, above which it is another device.
_FAR_OFF = 4.0
# The same under the fit of all logs, each of the same weight: that of another device bears most of their disagreement,
# where a log whose motion the others merely do not tell is fitted as well as they are.
_BEARS_MOST = 1.5


def odd_logs(rows: TrialRows, bench: Bench) -> Iterator[int]:
    """Numbers of the logs whose residual is far above that of the others, under the fit of these and under that of all.

    Args:
        rows: of all logs.
        bench: of these rows; candidates are left aside.
    """
    bench = bench.without_candidates()
    logs, number = np.unique(rows.log, return_inverse=True)
    if len(logs) < 3:  # of two, none is the odd one
        return
    # The blocks of a trial may span the end of one log and the start of the next.
    grams = replace(rows, block=number).grams(columns=bench.base)

    def squares(weights: Array) -> Array:
        """Weighted squared residuals under a fit in which logs have these weights, (motors, rows)."""
        weighted = replace(grams, values=grams.values * weights[:, None, None, None])
        fitted = bench.fit(Setting(), np.arange(len(logs)), weighted)
        e = np.where(rows.used, rows.y - rows.W[:, :, fitted.columns] @ fitted.theta, 0.0)
        return np.asarray((e * bench.weights[:, None]) ** 2)

    def stands_out(e2: Array, k: int, limit: float) -> bool:
        own, others = (e2[:, part].sum() / max(rows.used[:, part].sum(), 1) for part in (number == k, number != k))
        return bool(own > limit * others)

    alike = squares(1.0 / np.maximum(np.bincount(number, rows.used.sum(axis=0)), 1))
    for k, log in enumerate(logs):
        others = (np.arange(len(logs)) != k).astype(float)
        if stands_out(alike, k, _BEARS_MOST) and stands_out(squares(others), k, _FAR_OFF):
            yield int(log)
