"""Which columns are independent, and what the others are made of, modulo a prime."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from haptid.dynamics.symbolic.chain import ExactChain
from haptid.dynamics.symbolic.regressor import regressor
from haptid.dynamics.symbolic.residues import Field, Residues, UnluckyDrawError
from haptid.dynamics.symbolic.symbols import Symbol, draw


@dataclass(frozen=True)
class Pivots:
    """Which columns are independent.

    Attributes:
        kept: independent of those before them.
        idle: zero whatever the motion.
        samples: states at which those kept show that they are independent.
    """

    kept: tuple[int, ...]
    idle: tuple[int, ...]
    samples: int


@dataclass(frozen=True)
class Columns:
    """The standard parameters' columns, in order of preference.

    Attributes:
        chain: the mechanism.
        members: raw columns that add up to each standard parameter's.
    """

    chain: ExactChain
    members: tuple[tuple[int, ...], ...]

    def sample(self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], samples: int) -> Residues:
        """Rows at so many states for each set of lengths, (sets, samples * rows, standard parameters)."""
        W = regressor(self.chain, field, rng, values, samples)
        made = W[:, :, [members[0] for members in self.members]]
        for k, members in enumerate(self.members):
            for raw in members[1:]:
                made[:, :, k] = field.reduce(made[:, :, k] + W[:, :, raw])
        return made

    def pivots(self, field: Field, rng: np.random.Generator) -> Pivots:
        """Columns independent of those before them, at lengths drawn at random.

        Independence is certain: a minor that is not zero modulo a prime is not zero. States are added until twice as
        many show no more: rows alone do not count, where a torque depends on few of the columns.
        """
        values = draw(self.chain.symbols, field, rng, 1)
        samples = -(-len(self.members) // self.chain.torques) + 1
        W = self.sample(field, rng, values, samples)
        kept = field.echelon(W)[1]
        while True:
            W = np.concatenate([W, self.sample(field, rng, values, samples)], axis=1)
            before, kept = kept, field.echelon(W)[1]
            if kept == before:
                break
            samples *= 2
        enough = -(-len(kept) // self.chain.torques) + 1
        while len(field.echelon(W[:, : enough * self.chain.torques, kept])[1]) < len(kept):
            enough += 1
        return Pivots(tuple(kept), tuple(np.flatnonzero(~W[0].any(axis=0)).tolist()), enough + 1)

    def relations(
        self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], pivots: Pivots, others: list[int]
    ) -> Residues:
        """Coefficients of other columns in those kept, (sets of lengths, kept, others).

        Raises:
            UnluckyDrawError: the columns kept are not independent at some of these lengths.
        """
        kept = len(pivots.kept)
        W = self.sample(field, rng, values, pivots.samples)[:, :, [*pivots.kept, *others]]
        made, found = field.echelon(W, kept)
        if len(found) < kept:
            raise UnluckyDrawError
        return made[:, :, kept:]


def scatter(
    symbols: tuple[Symbol, ...], field: Field, rng: np.random.Generator, count: int, moves: int
) -> dict[str, Residues]:
    """Sets of lengths: `count` of them at random, then the first with one quantity after the other drawn `moves` times.

    Returns:
        residues of every symbol, (count + moves * quantities,) each; a quantity is a length or an angle.
    """
    made = draw(symbols, field, rng, count)
    for names in quantities(symbols):
        moved = draw(symbols, field, rng, moves)
        for name in made:
            fixed = np.repeat(made[name][:1], moves)
            made[name] = np.append(made[name], moved[name] if name in names else fixed)
    return made


def quantities(symbols: tuple[Symbol, ...]) -> list[tuple[str, ...]]:
    """Names of symbols that change together: one for a length, cosine and sine for an angle."""
    groups: dict[str, list[str]] = {}
    for symbol in symbols:
        groups.setdefault(f"angle {symbol.angle}" if symbol.angle else symbol.name, []).append(symbol.name)
    return [tuple(names) for names in groups.values()]
