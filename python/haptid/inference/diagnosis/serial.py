"""How far one row of the residual tells the next: whiteness, and how many independent rows there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.inference.diagnosis.finding import LEVEL, Finding, Status, holm, listed
from haptid.inference.diagnosis.residual import BETWEEN, Residuals

# Lags of the portmanteau test.
LAGS = 10
# A residual that remembers for more than this share of a block makes neighbouring blocks alike.
MEMORY = 0.2


@dataclass(frozen=True)
class Serial:
    """Serial correlation of one motor's residual.

    Attributes:
        rows: that count.
        ljung_box: Q over LAGS lags, of rows that the filter leaves apart (Ljung and Box 1978, Biometrika 65, eq. 1.2).
        p: its probability if these rows are white.
        durbin_watson: of the same rows (Durbin and Watson 1950, Biometrika 37): 2 if they are white.
        memory: rows of the residual that count as one, 1 + 2 sum rho_k.
        effective: rows over `memory`.
        half_power_hz: half of the residual's power is below.
    """

    rows: int
    ljung_box: float
    p: float
    durbin_watson: float
    memory: float
    effective: float
    half_power_hz: float


def autocorrelation(e: Array, lags: int) -> tuple[Array, np.ndarray]:
    """Of a series with missing values (NaN): sums over the pairs there are, over the sum of squares, and the pairs.

    Source: Parzen (1963), Sankhya A 25. Both (lags + 1,).
    """
    known = np.isfinite(e)
    x = np.where(known, e - np.nanmean(e), 0.0)
    lags = min(lags, len(x) - 1)
    power = max(float(x @ x), np.finfo(float).tiny)
    rho = np.array([x[: len(x) - k] @ x[k:] for k in range(lags + 1)]) / power
    pairs = np.array([np.sum(known[: len(x) - k] & known[k:]) for k in range(lags + 1)])
    return rho, pairs


def memory(e: Array) -> float:
    """Rows that count as one, 1 + 2 sum rho_k, 1 or more.

    Summed while neighbouring pairs of correlations are positive (Geyer 1992, Statistical Science 7, section 3.3).
    """
    rho, pairs = autocorrelation(e, min(BETWEEN - 1, len(e) // 4))
    scaled = rho * pairs[0] / np.maximum(pairs, 1)  # as if no row were missing
    couples = scaled[: len(scaled) // 2 * 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(couples <= 0)
    return max(1.0, 2.0 * float(couples[: ends[0] if len(ends) else None].sum()) - 1.0)


def portmanteau(e: Array, lags: int = LAGS) -> tuple[float, float]:
    """Q of Ljung and Box, and its probability if the series is white; missing values as in Stoffer and Toloi (1992)."""
    rho, pairs = autocorrelation(e, lags)
    n, there = pairs[0], pairs[1:] > 0
    Q = float(n * (n + 2) * np.sum(rho[1:][there] ** 2 / pairs[1:][there]))
    return Q, float(stats.chi2.sf(Q, max(int(there.sum()), 1)))


def serial(e: Array, stride: int, step: float) -> Serial:
    """Serial correlation of one motor's residual, (rows,), NaN where a row does not count."""
    apart = e[::stride]
    Q, p = portmanteau(apart)
    known = apart - np.nanmean(apart)
    steps = np.diff(known)
    pairs = np.isfinite(steps)
    watson = float(np.mean(steps[pairs] ** 2) / np.nanmean(known**2)) if pairs.any() else np.nan
    rows, each = int(np.isfinite(e).sum()), memory(e)
    return Serial(rows, Q, p, watson, each, rows / each, half_power(e, step))


def half_power(e: Array, step: float) -> float:
    """Frequency below which half of the power lies, Hz, from windowed correlations (Blackman and Tukey 1958)."""
    rho, pairs = autocorrelation(e, min(BETWEEN - 1, len(e) // 4))
    k = np.arange(1, len(rho))
    window = 0.5 * (1 + np.cos(np.pi * k / len(rho)))
    weight = rho[1:] * pairs[0] / np.maximum(pairs[1:], 1) * window
    f = np.linspace(0.0, 0.5, 1001)
    below = 2 * f + 2 * np.sin(2 * np.pi * np.outer(f, k)) @ (weight / (np.pi * k))
    return float(f[int(np.argmax(below >= 0.5))] / step)


def whiteness(estimate: Estimate, left: Residuals) -> Finding:
    """Is what is left of every motor's torque noise without memory?"""
    found = [serial(e, left.filter_stride, left.step) for e in left.e]
    p = holm([motor.p for motor in found])
    block = float(np.median([b.stop - b.start for b in estimate.observation.blocks]))
    longest = max(motor.memory for motor in found) * left.step
    status: Status = "ok" if p.min() >= LEVEL else "doubt"
    if longest > MEMORY * block:
        status = "bad"
    coloured = [label for label, each in zip(left.labels, p, strict=True) if each < LEVEL]
    rows, effective = sum(m.rows for m in found), sum(m.effective for m in found)
    sentence = (
        f"The {rows} rows are worth {effective:.0f} independent ones: the residual remembers for up to {longest:.2g} s"
    )
    if status == "bad":
        sentence += (
            f", longer than {100 * MEMORY:.0f} % of a block of {block:.2g} s: neighbouring blocks are alike and the "
            f"intervals too narrow. Look for a missing term, and write block = {round(10 * longest, 1):g} under "
            f"[treatment] in the study file, or Treatment(block={round(10 * longest, 1):g}) in Python."
        )
    elif coloured:
        sentence += (
            f". Beyond what the filter does, the residual of {listed(coloured)} is no plain noise (not white, "
            f"p = {p.min():.1e}, limit {LEVEL:g}): trust the default intervals, not the textbook's, and look for a "
            f"missing term."
        )
    else:
        sentence += f", and nothing but the filter makes it so (p = {p.min():.2g}, limit {LEVEL:g})."
    figures = {"rows": rows, "effective_rows": effective, "memory": longest, "block": block, "p": float(p.min())}
    for label, motor in zip(left.labels, found, strict=True):
        figures |= {
            f"ljung_box {label}": motor.ljung_box,
            f"durbin_watson {label}": motor.durbin_watson,
            f"half_power_hz {label}": motor.half_power_hz,
        }
    return Finding("whiteness", status, figures, sentence)
