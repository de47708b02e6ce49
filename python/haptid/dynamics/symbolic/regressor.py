"""The regressor modulo a prime, at random states and many sets of lengths at once, and its independent columns.

The columns of link inertia are computed by the core (Kane's form, `crates/core/src/exact/rows.rs`), those of other
terms here.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from haptid import _core
from haptid._internal.late import dataclass
from haptid.dynamics.symbolic.arithmetic import Points, PrimeField, Reals, Residues, UnluckyDrawError
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
    repeated = points.repeated(samples)
    W = rows_at(chain, chain.motion.states(rng, repeated), points, samples, rng)
    if chain.rows is not None:
        W = _measured(chain, points.field, W)
    return W.reshape(points.count, samples * W.shape[1], W.shape[2])


def rows_at(chain: SymbolicChain, states: States, points: Points, samples: int, rng: np.random.Generator) -> Residues:
    """Torques of the active joints by raw standard parameter, (sets * samples, active, columns), at given states."""
    repeated = points.repeated(samples)
    functions = _functions(chain, points.field, rng, repeated.count)
    first = {column.place: column for column in reversed(chain.columns)}
    coordinates = {place: column.coordinate(points.field, states) for place, column in first.items()}
    blocks = [_links(chain, states, points, repeated)]
    for column in chain.columns:
        blocks.append(column.modulo(coordinates[column.place], repeated, functions)[:, :, None])
    return np.concatenate(blocks, axis=2)


def _links(chain: SymbolicChain, states: States, points: Points, repeated: Points) -> Residues:
    """Torques of the active joints by XX XY XZ YY YZ ZZ MX MY MZ M of all links, (n, active, 10 links).

    `repeated` are the points of every state. Numbers are at rest: see `closed_rows`.
    """
    field = points.field
    minus_gravity = np.stack([field.reduce(-part.modulo(repeated)) for part in chain.gravity], axis=1)
    tree = [joint.parent for joint in chain.joints], [joint.prismatic for joint in chain.joints]
    placed, G = np.stack(joint_placements(chain.joints, points)), np.ascontiguousarray(states.G)
    samples = repeated.count // points.count
    if isinstance(field, Reals):
        motion = [states.cos, states.sin, states.slide, np.zeros_like(states.velocity), states.acceleration]
        return _core.real_rows(*tree, placed, np.stack(motion), G, minus_gravity, samples)
    motion = [states.cos, states.sin, states.slide, states.velocity, states.acceleration]
    return _core.exact_rows(*tree, placed, np.stack(motion), G, minus_gravity, samples, field.prime)


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
class ColumnGroup:
    """Columns that relations connect: those kept, and those that are their combinations.

    Attributes:
        kept: columns kept.
        others: columns that depend on these alone.
        places: which of them depend on which, (column kept, other).
        samples: states at which those kept are independent.
    """

    kept: tuple[int, ...]
    others: tuple[int, ...]
    places: tuple[tuple[int, int], ...]
    samples: int


@dataclass(frozen=True)
class Pivots:
    """Which columns are independent.

    Attributes:
        kept: independent of those before them.
        no_effect: zero at all states.
        groups: those kept and the others that depend on them, apart where no relation connects them.
    """

    kept: tuple[int, ...]
    no_effect: tuple[int, ...]
    groups: tuple[ColumnGroup, ...]


# Relations of some columns: coefficients by (column kept, other column), one residue for each set of lengths.
Relations = dict[tuple[int, int], Residues]


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

        Independence is certain: a minor that is not zero modulo a prime is not zero. States are added until the
        relations hold at as many more: the number of rows is no criterion where a torque depends on few of the columns.
        """
        points = draw(self.chain.symbols, field, rng, 1)
        samples = 1 + -(-len(self.members) // (2 * self.chain.torques))
        rows = samples * self.chain.torques
        both = self.sample(rng, points, 2 * samples)
        W, more = both[:, :rows], both[:, rows:]
        while True:
            form, kept = field.echelon(W)
            # Relations hold at all of these rows if they do for a random sum of them (Freivalds 1977).
            weights = field.draw(rng, more.shape[1], 1)
            row = field.reduce(field.reduce(more[0] * weights).sum(axis=0))
            left = row - field.reduce(form[0] * row[kept][:, None]).sum(axis=0)  # a sum of some hundreds stays small
            if not field.reduce(left).any():
                break
            W = np.concatenate([W, more], axis=1)
            more = self.sample(rng, points, W.shape[1] // self.chain.torques)
        no_effect = np.flatnonzero(~(W[0].any(axis=0) | row.astype(bool)))
        return Pivots(tuple(kept), tuple(no_effect.tolist()), self._groups(field, W, form[0], kept))

    def _groups(self, field: PrimeField, W: Residues, form: Residues, kept: list[int]) -> tuple[ColumnGroup, ...]:
        groups: list[tuple[set[int], list[int]]] = []
        for column in sorted(set(np.flatnonzero(form.any(axis=0)).tolist()) - set(kept)):
            rows, others = set(np.flatnonzero(form[:, column]).tolist()), [column]
            for group in [group for group in groups if group[0] & rows]:
                groups.remove(group)
                rows, others = group[0] | rows, group[1] + others
            groups.append((rows, others))
        made = []
        for rows, others in groups:
            columns, samples = [kept[i] for i in sorted(rows)], -(-len(rows) // self.chain.torques)
            while len(field.echelon(W[:, : samples * self.chain.torques, columns])[1]) < len(columns):
                samples += 1
            places = tuple((kept[i], k) for k in others for i in np.flatnonzero(form[:, k]).tolist())
            made.append(ColumnGroup(tuple(columns), tuple(others), places, samples))
        return tuple(made)

    def relations(self, rng: np.random.Generator, points: Points, groups: Sequence[ColumnGroup]) -> Relations:
        """Coefficients of other columns in those kept on which they depend.

        Raises:
            UnluckyDrawError: the columns kept are not independent at some of these lengths.
        """
        W = self.sample(rng, points, max(group.samples for group in groups))
        relations: Relations = {}
        for group in groups:
            count = len(group.kept)
            rows = W[:, : group.samples * self.chain.torques, [*group.kept, *group.others]]
            form, pivots = points.field.echelon(rows, count)
            if len(pivots) < count:
                raise UnluckyDrawError
            at = {column: place for place, column in enumerate((*group.kept, *group.others))}
            for i, k in group.places:
                relations[i, k] = form[:, at[i], at[k]]
        return relations


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
