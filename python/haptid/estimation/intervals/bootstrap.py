"""Block bootstrap standard errors: time blocks resampled with replacement."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation.intervals.covariance import Spread
from haptid.estimation.method import Fit, expect_whole

# Least share of the information on any direction in a draw; with less, the draw is rejected and repeated.
LEAST_INFORMATION = 0.05
# Draws attempted for each that is wanted.
TRIES = 20


@dataclass(frozen=True)
class Bootstrap:
    """Block bootstrap: blocks of time, all motors together, drawn with replacement, and one fit for each draw.

    Needs only the R factors of the blocks. The interval is Student's, with one degree of freedom less than blocks.

    Sources: Kunsch (1989), Annals of Statistics 17(3); Freedman (1981), Annals of Statistics 9(6), for pairs.

    Attributes:
        draws: number of draws.
        seed: of the random draws.
    """

    name: ClassVar[str] = "block bootstrap, Student t"
    draws: int = 499
    seed: int = 0

    def __post_init__(self) -> None:
        expect_whole("Bootstrap", "draws", self.draws, 2)

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them."""
        moments, own = fit.pooled_moments, fit.combined(combinations)
        (blocks, k), rng = moments.s.shape, np.random.default_rng(self.seed)
        pull = np.zeros((0, k)) if fit.solution.pull is None else fit.solution.pull
        alone = moments.alone(own)
        shifts: list[Array] = []
        for _ in range(TRIES * self.draws):
            counts = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks))
            H = np.tensordot(counts, moments.G, 1) + pull.T @ pull
            # The prior's values are drawn with their standard deviations; all scores together are zero.
            prior = np.asarray(-moments.s.sum(axis=0) + pull.T @ rng.standard_normal(len(pull)))
            score = counts @ moments.s + prior
            if np.linalg.eigvalsh(H)[0] > LEAST_INFORMATION:
                shifts.append(np.asarray(np.linalg.solve(H, score), dtype=np.float64))
            if len(shifts) == self.draws:
                break
        if len(shifts) < 2:  # almost no draw excites all directions
            shifts, alone = [np.zeros(k)] * 2, np.arange(len(own))
        covariance = np.atleast_2d(np.cov(np.array(shifts) @ own.T, rowvar=False)) * blocks / max(1, blocks - 1)
        return Spread(covariance, np.full(len(own), float(max(1, blocks - 1))), blocks, alone)
