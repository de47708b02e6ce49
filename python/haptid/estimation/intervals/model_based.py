"""Standard errors from a model of the residual: white (`Classical`, classical) or autoregressive (`Sandwich`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array, read_only
from haptid._internal.late import dataclass
from haptid._internal.signals import fast_length
from haptid.estimation.intervals.covariance import Spread
from haptid.estimation.method import Fit, expect_whole
from haptid.observation.rows import Rows

# Relative power below which what is left of a series is rounding.
NOTHING_LEFT = 1e-24


@dataclass(frozen=True)
class Classical:
    """Classical (nonrobust) covariance, (W'W)^-1 times the variance of the residual: valid for white residuals only.

    Of whitened rows, as of `GLS()`, it is the method's own.

    Source: Janot et al. (2007), ISIE, eqs 15 and 16.
    """

    name: ClassVar[str] = "classical, for white residuals"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them."""
        covariance = fit.classical_covariance
        if combinations is not None:
            covariance = combinations @ covariance @ combinations.T
        dof = np.full(len(covariance), float(fit.solution.dof))
        return Spread(covariance, dof, _blocks(fit), np.array([], dtype=int))


@dataclass(frozen=True)
class Sandwich:
    """(W'W)^-1 W'C W (W'W)^-1, with C the covariance of an autoregressive model of each motor's residual.

    As wide as the default in the mean where the model is right: stationary residuals, independent across motors, with
    a memory that is short beside the log. Long memory is underestimated: intervals are then up to a fifth narrower
    than the default and hold less. Needs one more pass over the rows.

    Source: cross-spectrum of residual and columns, Hannan (1970), Multiple Time Series, section VII.3; order by BIC.

    Attributes:
        most_order: largest order of the models.
    """

    name: ClassVar[str] = "AR(bic) sandwich, Student t"
    most_order: int = 20

    def __post_init__(self) -> None:
        expect_whole("Sandwich", "most_order", self.most_order, 0)

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them."""
        own, rows = fit.combined(combinations), Rows(fit.observation)
        models = [burg(runs, self.most_order) for runs in residual_runs(rows, fit.solution.beta)]
        middle = _middle(rows, fit, models)
        if fit.solution.pull is not None:
            middle = middle + fit.solution.pull.T @ fit.solution.pull
        dof = np.full(len(own), float(fit.solution.dof))
        return Spread(own @ middle @ own.T, dof, _blocks(fit), fit.moments.alone(own))


def _blocks(fit: Fit) -> int:
    """Number of blocks that have rows, motor by motor."""
    return int(sum((motor.rows > 0).sum() for motor in fit.observation.motors))


def _middle(rows: Rows, fit: Fit, models: Sequence[Autoregression]) -> Array:
    """W'C W in the coordinates of `fit.moments`, (k, k); unused rows are zero, so gaps count as time."""
    k = fit.solution.root.shape[1]
    middle = np.zeros((k, k))
    for chunk in rows:
        length = fast_length(2 * chunk.y.shape[1])
        once = np.full(length // 2 + 1, 2.0)
        once[0] = 1.0
        if length % 2 == 0:
            once[-1] = 1.0
        for W, weight, autoregression, motor in zip(chunk.W, fit.weights, models, rows.observation.motors, strict=True):
            per_dof = motor.rows.sum() / max(1, motor.rows.sum() - len(motor.columns))
            X = fft.rfft(weight**2 * (W @ fit.solution.root), length, axis=0)
            power = per_dof * autoregression.spectrum(length) * once / length
            middle += ((X.conj().T * power) @ X).real
    return middle


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Autoregressive model e_t + a_1 e_(t-1) + ... + a_p e_(t-p) = white noise, with those of all lower orders.

    Attributes:
        filters: 1, a_1, ..., a_m of the orders m = 0..p, each (m + 1,).
        powers: variance of the prediction error of each of them, (p + 1,).
    """

    filters: tuple[Array, ...]
    powers: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "filters", tuple(read_only(a) for a in self.filters))
        object.__setattr__(self, "powers", read_only(self.powers))

    @property
    def order(self) -> int:
        return len(self.filters) - 1

    def whitened(self, series: Array) -> Array:
        """Prediction errors, scaled to unit variance, of an unbroken run, (n,) or (n, columns).

        The first rows are predicted from the fewer rows before them (Prais and Winsten 1954, for any order), so that
        none is lost: the result is the run times the inverse Cholesky factor of its covariance.
        """
        p = min(self.order, len(series))
        white = np.zeros(np.shape(series))
        for k, a in enumerate(self.filters[-1][: len(series)]):
            white[k:] += a * series[: len(series) - k]
        white /= np.sqrt(self.powers[-1])
        for k in range(p):
            white[k] = self.filters[k] @ series[k::-1] / np.sqrt(self.powers[k])
        return np.asarray(white)

    def spectrum(self, length: int) -> Array:
        """Power at each frequency of a real Fourier transform of `length` rows, (length // 2 + 1,)."""
        return np.asarray(self.powers[-1] / np.abs(fft.rfft(self.filters[-1], length)) ** 2)


def burg(parts: Sequence[Array], most: int) -> Autoregression:
    """Burg's autoregressive model of the order up to `most` with the least BIC, from one or several runs of a series.

    Sources: Burg (1975), Maximum Entropy Spectral Analysis; Schwarz (1978), Annals of Statistics 6.
    """
    forward, backward = [np.array(p) for p in parts], [np.array(p) for p in parts]
    n = sum(len(p) for p in parts)
    power = sum(float(p @ p) for p in parts) / n
    filters, powers = [np.ones(1)], [power]
    for _ in range(min(most, n // 4)):
        pairs = [(f[1:], b[:-1]) for f, b in zip(forward, backward, strict=True) if len(f) > 1]
        size = sum(float(f @ f + b @ b) for f, b in pairs)
        if size <= NOTHING_LEFT * n * power:
            break
        k = -2.0 * sum(float(f @ b) for f, b in pairs) / size
        forward, backward = [f + k * b for f, b in pairs], [b + k * f for f, b in pairs]
        longer = np.append(filters[-1], 0.0)
        filters.append(longer + k * longer[::-1])
        powers.append(powers[-1] * (1.0 - k**2))
    best = int(np.argmin(n * np.log(np.maximum(powers, np.finfo(float).tiny)) + np.log(n) * np.arange(len(powers))))
    return Autoregression(tuple(filters[: best + 1]), np.array(powers[: best + 1]))


def residual_runs(rows: Rows, beta: Array, stride: int = 1) -> list[list[Array]]:
    """The unbroken runs of every motor's residual, motor by motor; of every `stride`-th row each."""
    parts: list[list[Array]] = [[] for _ in rows.observation.motors]
    for chunk in rows:
        for own, e, used in zip(parts, chunk.residual(beta), chunk.used, strict=True):
            own.extend(e[run] for run in runs_of(used, stride))
    return parts


def runs_of(used: np.ndarray, stride: int = 1) -> Iterator[slice]:
    """Unbroken runs of used rows, of a mask (rows,); a stride splits each into runs of every `stride`-th row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], used, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        for first in range(int(start), min(int(start) + stride, int(stop))):
            yield slice(first, int(stop), stride)
