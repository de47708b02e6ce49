"""Intervals by drawing the log's blocks anew, with replacement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, whole
from haptid.errors import MethodSettingError
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.spread import Spread

# Draws without a direction of the parameters, in which less than this share of it is left, are drawn again.
LEFT = 0.05
# Draws that are tried for each that is wanted.
TRIES = 20


@dataclass(frozen=True)
class Bootstrap:
    """Block bootstrap: blocks of time, all motors together, drawn with replacement, and the fit made of each draw.

    Needs only the triangles of the blocks. The interval is Student's, with one degree of freedom less than blocks.

    Sources: Kunsch (1989), Annals of Statistics 17(3); Freedman (1981), Annals of Statistics 9(6), for pairs.

    Attributes:
        draws: how many.
        seed: of the draws.
    """

    draws: int = 499
    seed: int = 0

    def __post_init__(self) -> None:
        if not (whole(self.draws) and self.draws >= 2):
            raise MethodSettingError("Bootstrap", "draws", self.draws, "a whole number, 2 or more")

    @property
    def name(self) -> str:
        return "block bootstrap, Student t"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Of base parameters, or of combinations of them, (q, p)."""
        made, spread = fit.together, fit.combined(combinations)
        (blocks, k), rng = made.s.shape, np.random.default_rng(self.seed)
        pull = np.zeros((0, k)) if fit.solution.pull is None else fit.solution.pull
        alone = made.alone(spread)
        moved: list[Array] = []
        for _ in range(TRIES * self.draws):
            counts = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks))
            H = np.tensordot(counts, made.G, 1) + pull.T @ pull
            score = counts @ made.s + self._drawn(pull, made.s, rng)
            if np.linalg.eigvalsh(H)[0] > LEFT:
                moved.append(np.asarray(np.linalg.solve(H, score), dtype=np.float64))
            if len(moved) == self.draws:
                break
        if len(moved) < 2:  # hardly a draw has all directions
            moved, alone = [np.zeros(k)] * 2, np.arange(len(spread))
        shifts = np.array(moved) @ spread.T
        covariance = np.atleast_2d(np.cov(shifts, rowvar=False)) * blocks / max(1, blocks - 1)
        return Spread(covariance, np.full(len(spread), float(max(1, blocks - 1))), blocks, alone)

    @staticmethod
    def _drawn(pull: Array, s: Array, rng: np.random.Generator) -> Array:
        """What knowledge asks for, its values drawn with their deviations, (k,); all scores together are zero."""
        return np.asarray(-s.sum(axis=0) + pull.T @ rng.standard_normal(len(pull)))
