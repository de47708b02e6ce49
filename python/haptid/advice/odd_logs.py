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
    logs, of_blocks = np.unique(rows.log), rows.log[np.searchsorted(rows.block, np.arange(rows.blocks))]
    if len(logs) < 3:  # of two, none is the odd one
        return
    grams = bench.grams["used"]

    def squares(weights: Array) -> Array:
        """Weighted squared residuals under a fit in which blocks have these weights, (motors, rows)."""
        weighted = replace(grams, values=grams.values * weights[:, None, None, None])
        fitted = bench.fit(Setting(), np.arange(bench.blocks), weighted)
        e = np.where(rows.used, rows.y - rows.W[:, :, fitted.columns] @ fitted.theta, 0.0)
        return np.asarray((e * bench.weights[:, None]) ** 2)

    def stands_out(e2: Array, k: int, limit: float) -> bool:
        own, others = (e2[:, part].sum() / max(rows.used[:, part].sum(), 1) for part in (rows.log == k, rows.log != k))
        return bool(own > limit * others)

    alike = squares(1.0 / np.array([max(rows.used[:, rows.log == k].sum(), 1) for k in of_blocks]))
    for k in logs:
        if stands_out(alike, k, _BEARS_MOST) and stands_out(squares((of_blocks != k).astype(float)), k, _FAR_OFF):
            yield int(k)
