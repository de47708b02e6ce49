"""Which columns are independent, and what the others are made of, modulo a prime."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from haptid.exact.chain import ExactChain
from haptid.exact.regressor import regressor
from haptid.exact.residues import Field, Residues, UnluckyDrawError
from haptid.exact.symbols import Symbol, draw

# Rows beyond those that the columns need: each makes an accident of the draw a billion times less likely.
SPARE_ROWS = 2


@dataclass(frozen=True)
class Columns:
    """The standard parameters' columns, in order of preference.

    Attributes:
        chain: the mechanism.
        members: raw columns that add up to each standard parameter's.
        rows: measured torques at each state.
    """

    chain: ExactChain
    members: tuple[tuple[int, ...], ...]
    rows: int

    def sample(self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], columns: int) -> Residues:
        """More rows than a number of columns, (sets of lengths, rows, standard parameters)."""
        samples = -(-(columns + SPARE_ROWS) // self.rows)
        W = regressor(self.chain, field, rng, values, samples)
        made = W[:, :, [members[0] for members in self.members]]
        for k, members in enumerate(self.members):
            for raw in members[1:]:
                made[:, :, k] = field.reduce(made[:, :, k] + W[:, :, raw])
        return made

    def pivots(self, field: Field, rng: np.random.Generator) -> tuple[list[int], list[int]]:
        """Columns independent of those before them, and columns without effect.

        Independence is certain: a minor that is not zero modulo a prime is not zero.
        """
        W = self.sample(field, rng, draw(self.chain.symbols, field, rng, 1), len(self.members))
        return field.echelon(W)[1], np.flatnonzero(~W[0].any(axis=0)).tolist()

    def relations(
        self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], kept: list[int], others: list[int]
    ) -> Residues:
        """Coefficients of other columns in those kept, (sets of lengths, kept, others).

        Raises:
            UnluckyDrawError: the columns kept are not independent at some of these lengths.
        """
        W = self.sample(field, rng, values, len(kept))[:, :, [*kept, *others]]
        made, pivots = field.echelon(W, len(kept))
        if len(pivots) < len(kept):
            raise UnluckyDrawError
        return made[:, :, len(kept) :]


def scatter(symbols: tuple[Symbol, ...], field: Field, rng: np.random.Generator, count: int) -> dict[str, Residues]:
    """Sets of lengths: `count` of them at random, then the first with one symbol after the other drawn again.

    Returns:
        residues of every symbol, (count + number of quantities,) each; a quantity is a length or an angle.
    """
    made = draw(symbols, field, rng, count)
    moved = draw(symbols, field, rng, 1)
    for names in quantities(symbols):
        for name in made:
            made[name] = np.append(made[name], moved[name] if name in names else made[name][:1])
    return made


def quantities(symbols: tuple[Symbol, ...]) -> list[tuple[str, ...]]:
    """Names of symbols that change together: one for a length, cosine and sine for an angle."""
    groups: dict[str, list[str]] = {}
    for symbol in symbols:
        groups.setdefault(f"angle {symbol.angle}" if symbol.angle else symbol.name, []).append(symbol.name)
    return [tuple(names) for names in groups.values()]
