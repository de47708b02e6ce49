"""How the residual is spread: normal or not, single wild rows, and whether it grows with speed or torque."""

from __future__ import annotations

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array
from haptid.inference.diagnosis.block_jackknife import regress
from haptid.inference.diagnosis.finding import LEVEL, Finding, Status, holm, listed
from haptid.inference.diagnosis.residual import Residuals
from haptid.inference.diagnosis.serial import memory

# Median absolute deviation of a normal variable of unit deviation.
NORMAL_MAD = 0.6744897501960817
# A test of the distribution needs so many rows.
FEWEST = 30
# Wild rows that hold more than this share of the residual's power draw the fit.
WILD = 0.1
# A residual this much larger at twice the typical speed or torque is worth another weighting.
GROWTH = 2.0


def standardised(e: Array) -> Array:
    """Residual in robust deviations about its median, (rows,), NaN where a row does not count."""
    centred = e - np.nanmedian(e)
    return np.asarray(centred * NORMAL_MAD / max(float(np.nanmedian(np.abs(centred))), np.finfo(float).tiny))


def independent(e: Array, stride: int) -> Array:
    """Rows of a residual so far apart that they hardly know of each other."""
    kept = e[:: max(stride, int(np.ceil(memory(e))))]
    return np.asarray(kept[np.isfinite(kept)])


def wild_rows(e: Array, rows: float) -> np.ndarray:
    """Rows beyond what a normal residual of so many independent rows reaches once in a hundred logs, (rows,)."""
    limit = stats.norm.isf(0.5 * LEVEL / max(rows, 1.0))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(standardised(e)) > limit)


def normality(left: Residuals) -> Finding:
    """Is the residual normal (D'Agostino and Pearson 1973, Biometrika 60), and are there wild rows?"""
    p, wild, power = [], 0, 0.0
    figures: dict[str, float] = {}
    for label, e in zip(left.labels, left.e, strict=True):
        apart = independent(e, left.filter_stride)
        p.append(float(stats.normaltest(apart).pvalue) if len(apart) >= FEWEST else 1.0)
        out = wild_rows(e, np.isfinite(e).sum() / memory(e))
        wild += int(out.sum())
        power = max(power, float(np.sum(e[out] ** 2) / np.nansum(e**2)))
        figures |= {f"skewness {label}": stats.skew(apart), f"excess_kurtosis {label}": stats.kurtosis(apart)}
    least = float(holm(p).min())
    status: Status = "ok" if least >= LEVEL else "bad" if power > WILD else "doubt"
    figures |= {"p": least, "wild_rows": wild, "wild_power": power}
    odd = listed([label for label, each in zip(left.labels, holm(p), strict=True) if each < LEVEL])
    if status == "ok":
        sentence = f"The residual is as good as normal (p = {least:.2g}, limit {LEVEL:g})."
    elif status == "doubt":
        sentence = (
            f"The residual of {odd} is not normal (p = {least:.1e}, limit {LEVEL:g}): intervals are still good where "
            f"the log is long, but look for a missing term."
        )
    else:
        sentence = (
            f"The residual of {odd} has {wild} wild rows that hold {100 * power:.0f} % of a motor's residual power "
            f"(limit {100 * WILD:.0f} %): look at the log there for touches, end stops and lost samples, and cut them."
        )
    return Finding("normality", status, figures, sentence)


def spread(left: Residuals, velocity: Array) -> Finding:
    """Does the residual grow with speed or torque? Koenker's studentised test (1981, J. Econometrics 17), by blocks.

    Args:
        left: what the estimate leaves.
        velocity: of every motor's own coordinate, (motors, rows).
    """
    p, growth, names = [], [], []
    for m, label in enumerate(left.labels):
        used = left.used(m)
        if not used.any():
            continue
        sizes = np.array([np.abs(velocity[m, used]), np.abs(left.predicted[m, used])])
        typical = sizes.mean(axis=1, keepdims=True)
        X = np.vstack([np.ones(used.sum()), sizes / np.where(typical > 0, typical, 1.0) - 1.0]).T
        e = left.e[m, used]
        found = regress(X, e**2, left.block[used])
        for k, what in enumerate(("speed", "torque") if found else ()):
            assert found is not None
            t = found.value[k + 1] / found.se[k + 1] if found.se[k + 1] > 0 else 0.0
            p.append(float(2 * stats.t.sf(abs(t), found.dof[k + 1])))
            growth.append(float(1.0 + found.value[k + 1] / found.value[0]))
            names.append(f"{label} with {what}")
    if not p:
        return Finding("even spread", "ok", {}, "There are too few blocks to tell whether the residual grows.")
    together = holm(p)
    first = int(np.argmin(together))
    figures = {"p": together[first], **{f"growth {name}": g for name, g in zip(names, growth, strict=True)}}
    if together[first] >= LEVEL:
        text = f"The residual is as large at any speed and torque (p = {together[first]:.2g}, limit {LEVEL:g})."
        return Finding("even spread", "ok", figures, text)
    way = "grows" if growth[first] > 1 else "shrinks"
    text = (
        f"The residual's power of {names[first]} {way} by {100 * abs(growth[first] - 1):.0f} % from its mean to twice "
        f"its mean (p = {together[first]:.1e}, limit {LEVEL:g}): the default intervals allow for it. Look for friction "
        f"or backlash that the model lacks {'there' if growth[first] > 1 else 'at the other end'}."
    )
    return Finding("even spread", "bad" if abs(growth[first] - 1) > GROWTH - 1 else "doubt", figures, text)
