"""A torque that repeats along the position, with a period that nobody knows: cogging, teeth, an eccentric capstan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.inference.diagnosis.finding import LEVEL, Finding, graded, holm
from haptid.inference.diagnosis.places import Place
from haptid.inference.diagnosis.residual import Residuals

# Periods that are looked for: from the range of the rows down to this share of it, so many of them.
FINEST, PERIODS = 1 / 60, 120
# Sign changes of whole blocks that say how strong a wave chance makes, and the stream that draws them.
DRAWS, SEED = 999, 0


def waves(x: Array, e: Array, block: np.ndarray) -> tuple[Array, Array]:
    """Waves per unit of position, (periods,), and each block's sums of e exp(i 2 pi f x), (blocks, periods), complex.

    Args:
        x: position, (rows,), SI.
        e: residual, (rows,).
        block: of each row, (rows,).
    """
    span = float(x.max() - x.min())
    f = np.linspace(2.0, 1 / FINEST, PERIODS) / span
    parts = (np.flatnonzero(block == one) for one in np.unique(block))
    return f, np.array([e[part] @ np.exp(2j * np.pi * np.outer(x[part], f)) for part in parts])


def chance(sums: Array) -> tuple[float, int]:
    """Probability of so strong a wave at any period by chance, and which period is the strongest.

    Blocks change sign as wholes, which keeps the serial correlation inside them: the wild bootstrap of Cameron,
    Gelbach and Miller (2008), Review of Economics and Statistics 90, for the largest of all periods.
    """
    noise = (np.abs(sums) ** 2).sum(axis=0)
    strength = np.abs(sums.sum(axis=0)) ** 2 / noise
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], (DRAWS, len(sums)))
    drawn = (np.abs(signs @ sums) ** 2 / noise).max(axis=1)
    return float((1 + (drawn >= strength.max()).sum()) / (DRAWS + 1)), int(np.argmax(strength))


def ripple(places: Sequence[Place], left: Residuals, device_rows: Sequence[int]) -> Finding:
    """Does any motor's torque repeat along its position?

    Args:
        places: motors or joints.
        left: what the estimate leaves.
        device_rows: coordinate of every motor's row.
    """
    p, explained, period, names = [], [], [], []
    for place in places:
        m = max(range(len(left.e)), key=lambda k: abs(place.weights[device_rows[k]]))
        used = left.used(m)
        x, e = (place.weights @ left.position)[used], left.e[m, used] - np.nanmean(left.e[m])
        if used.sum() < PERIODS or x.max() == x.min():
            continue
        f, sums = waves(x, e, left.block[used])
        each, at = chance(sums)
        p.append(each)
        explained.append(float(2 * np.abs(sums[:, at].sum()) ** 2 / (len(e) * (e @ e))))
        period.append(float(1 / f[at]))
        names.append(place.label)
    together = holm(p) if p else np.ones(1)
    first = int(np.argmin(together))
    if not p or together[first] >= LEVEL:
        text = f"No torque repeats along a position (p = {together[first]:.2g}, limit {LEVEL:g})."
        return Finding("ripple", "ok", {"p": together[first]}, text)
    figures = {"p": together[first], "explained": explained[first], "period": period[first]}
    text = (
        f"The residual of {names[first]} repeats every {period[first]:.3g} (SI) of its position: "
        f"{100 * explained[first]:.1f} % of its power (p = {together[first]:.1e}, limit {LEVEL:g}). Look for cogging, "
        f"teeth or an eccentric pulley of that period, and add a sine and a cosine of position as columns."
    )
    return Finding("ripple", graded(float(together[first]), explained[first]), figures, text)
