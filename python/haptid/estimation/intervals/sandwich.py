"""Intervals from a model of how each motor's residual remembers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from haptid._internal.arrays import Array, whole
from haptid.errors import MethodSettingError
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.autoregression import Autoregression, burg, unbroken
from haptid.estimation.intervals.spread import Spread
from haptid.observation.rows import Rows


@dataclass(frozen=True)
class Sandwich:
    """(W'W)^-1 W'C W (W'W)^-1, with C of an autoregressive model of each motor's residual.

    A few per cent narrower than the default where the model is right: a residual that stays the same over the log,
    motors that do not share it. Walks through the rows once more.

    Source: shared spectrum of residual and columns, Hannan (1970), Multiple Time Series, section VII.3; order by BIC.

    Attributes:
        most_order: of the models.
    """

    most_order: int = 20

    def __post_init__(self) -> None:
        if not (whole(self.most_order) and self.most_order >= 0):
            raise MethodSettingError("Sandwich", "most_order", self.most_order, "a whole number, 0 or more")

    @property
    def name(self) -> str:
        return "AR(bic) sandwich, Student t"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Of base parameters, or of combinations of them, (q, p)."""
        spread = fit.combined(combinations)
        rows = Rows(fit.observation)
        middle = middles(rows, fit, self._models(rows, fit))
        if fit.solution.pull is not None:
            middle = middle + fit.solution.pull.T @ fit.solution.pull
        blocks = int(sum((motor.rows > 0).sum() for motor in fit.observation.motors))
        dof = np.full(len(spread), float(fit.solution.dof))
        return Spread(spread @ middle @ spread.T, dof, blocks, fit.moments.alone(spread))

    def _models(self, rows: Rows, fit: Fit) -> list[Autoregression]:
        parts: list[list[Array]] = [[] for _ in fit.weights]
        for stretch in rows:
            residual = stretch.residual(fit.solution.beta)
            for own, e, used in zip(parts, residual, stretch.used, strict=True):
                own.extend(e[run] for run in unbroken(used))
        return [burg(own, self.most_order) for own in parts]


def middles(rows: Rows, fit: Fit, models: list[Autoregression]) -> Array:
    """W'C W in the coordinates of `fit.moments`, (k, k); rows that do not count are zero, so gaps count as time."""
    k = fit.solution.root.shape[1]
    made = np.zeros((k, k))
    for stretch in rows:
        length = fft.next_fast_len(2 * stretch.y.shape[1], real=True)
        once = np.full(length // 2 + 1, 2.0)
        once[0] = 1.0
        if length % 2 == 0:
            once[-1] = 1.0
        for W, weight, autoregression, motor in zip(
            stretch.W, fit.weights, models, rows.observation.motors, strict=True
        ):
            taken = motor.rows.sum() / max(1, motor.rows.sum() - len(motor.columns))
            X = fft.rfft(weight**2 * (W @ fit.solution.root), length, axis=0)
            power = taken * autoregression.spectrum(length) * once / length
            made += ((X.conj().T * power) @ X).real
    return made
