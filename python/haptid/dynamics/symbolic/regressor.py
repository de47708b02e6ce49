"""The regressor modulo a prime, at random states and many sets of lengths at once, and its independent columns.

The columns of link inertia are computed by the core (Kane's form, `crates/core/src/exact/rows.rs`), those of other
terms here.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from haptid import _core
from haptid.dynamics.symbolic.arithmetic import Points, PrimeField, Residues, UnluckyDrawError
from haptid.dynamics.symbolic.chain import States, SymbolicChain
from haptid.dynamics.symbolic.geometry import joint_placements
from haptid.dynamics.symbolic.symbols import Symbol, draw

Functions = dict[Hashable, Residues]


def regressor(chain: SymbolicChain, rng: np.random.Generator, points: Points, samples: int) -> Residues:
    """Rows of measured torque by raw standard parameter, (sets, samples * rows, columns).

    Args:
        chain: the mechanism.
        rng: random generator.
        points: sets of lengths.
        samples: states for each set.
    """
    field, repeated = points.field, points.repeated(samples)
    states = chain.motion.states(rng, repeated)
    blocks = [_links(chain, states, points, repeated)]
    functions = _functions(chain, field, rng, repeated.count)
    blocks += [column.modulo(states, repeated, functions)[:, :, None] for column in chain.columns]
    W = np.concatenate(blocks, axis=2)
    if chain.rows is not None:
        W = _measured(chain, field, W)
    return W.reshape(points.count, samples * W.shape[1], W.shape[2])


def _links(chain: SymbolicChain, states: States, points: Points, repeated: Points) -> Residues:
    """Torques of the active joints by XX XY XZ YY YZ ZZ MX MY MZ M of all links, (n, active, 10 links).

    `repeated` are the points of every state.
    """
    field = points.field
    minus_gravity = np.stack([field.reduce(-part.modulo(repeated)) for part in chain.gravity], axis=1)
    return _core.exact_rows(
        [joint.parent for joint in chain.joints],
        [joint.prismatic for joint in chain.joints],
        np.stack(joint_placements(chain.joints, points)),
        np.stack([states.cos, states.sin, states.slide, states.velocity, states.acceleration]),
        np.ascontiguousarray(states.G),
        minus_gravity,
        repeated.count // points.count,
        field.prime,
    )


def _functions(chain: SymbolicChain, field: PrimeField, rng: np.random.Generator, count: int) -> Functions:
    """Random values at every state of functions that are not polynomial, drawn independently for each."""
    keys = dict.fromkeys(part.key for column in chain.columns for part in column.parts)
    return {key: field.draw(rng, count) for key in keys if key is not None}


def _measured(chain: SymbolicChain, field: PrimeField, W: Residues) -> Residues:
    """The measured rows, (n, rows, columns), of all active joints', (n, active, columns)."""
    rows = []
    for weights in chain.rows or ():
        total = np.zeros((W.shape[0], W.shape[2]), dtype=np.int64)
        for k, weight in enumerate(weights):
            total = field.reduce(total + field.of(weight) * W[:, k])
        rows.append(total)
    return np.stack(rows, axis=1)


@dataclass(frozen=True)
class Pivots:
    """Which columns are independent.

    Attributes:
        free_parameters: independent of those before them.
        no_effect: zero at all states.
        samples: states required for those kept to be independent.
    """

    kept: tuple[int, ...]
    no_effect: tuple[int, ...]
    samples: int


@dataclass(frozen=True)
class Columns:
    """The standard parameters' columns, in order of preference.

    Attributes:
        chain: the mechanism.
        members: raw columns of which each standard parameter's column is the sum, each with its sign.
    """

    chain: SymbolicChain
    members: tuple[tuple[tuple[int, int], ...], ...]

    def sample(self, rng: np.random.Generator, points: Points, samples: int) -> Residues:
        """Rows at this many states for each set of lengths, (sets, samples * rows, standard parameters)."""
        raw = regressor(self.chain, rng, points, samples)
        W = raw[:, :, [members[0][0] for members in self.members]]
        for k, members in enumerate(self.members):
            for j, sign in members[1:]:
                W[:, :, k] = points.field.reduce(W[:, :, k] + sign * raw[:, :, j])
        return W

    def pivots(self, field: PrimeField, rng: np.random.Generator) -> Pivots:
        """Columns independent of those before them, at random lengths.

        Independence is certain: a minor that is not zero modulo a prime is not zero. States are added until twice as
        many give no more: the number of rows is no criterion where a torque depends on few of the columns.
        """
        points = draw(self.chain.symbols, field, rng, 1)
        samples = -(-len(self.members) // self.chain.torques) + 1
        W = self.sample(rng, points, samples)
        independent = field.echelon(W)[1]
        while True:
            W = np.concatenate([W, self.sample(rng, points, samples)], axis=1)
            before, independent = independent, field.echelon(W)[1]
            if independent == before:
                break
            samples *= 2
        enough = -(-len(independent) // self.chain.torques) + 1
        while len(field.echelon(W[:, : enough * self.chain.torques, independent])[1]) < len(independent):
            enough += 1
        return Pivots(tuple(independent), tuple(np.flatnonzero(~W[0].any(axis=0)).tolist()), enough + 1)

    def relations(self, rng: np.random.Generator, points: Points, pivots: Pivots, others: list[int]) -> Residues:
        """Coefficients of other columns in those kept, (sets of lengths, kept, others).

        Raises:
            UnluckyDrawError: the columns kept are not independent at some of these lengths.
        """
        count = len(pivots.kept)
        W = self.sample(rng, points, pivots.samples)[:, :, [*pivots.kept, *others]]
        form, pivots_found = points.field.echelon(W, count)
        if len(pivots_found) < count:
            raise UnluckyDrawError
        return form[:, :, count:]


def scatter(symbols: tuple[Symbol, ...], field: PrimeField, rng: np.random.Generator, count: int, moves: int) -> Points:
    """Sets of lengths: `count` at random, then the first one with each quantity in turn drawn `moves` times."""
    groups = quantities(symbols)
    values = dict(draw(symbols, field, rng, count).values)
    for names in groups:
        moved = draw(symbols, field, rng, moves).values
        for name, residues in values.items():
            values[name] = np.append(residues, moved[name] if name in names else np.repeat(residues[:1], moves))
    return Points(field, values, count + moves * len(groups))


def quantities(symbols: tuple[Symbol, ...]) -> list[tuple[str, ...]]:
    """Names of symbols that vary together: one for a length, cosine and sine for an angle."""
    groups: dict[str, list[str]] = {}
    for symbol in symbols:
        groups.setdefault(f"angle {symbol.angle}" if symbol.angle else symbol.name, []).append(symbol.name)
    return [tuple(names) for names in groups.values()]
