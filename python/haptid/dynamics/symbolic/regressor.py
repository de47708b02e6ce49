"""The regressor modulo a prime, at random states and many sets of lengths at once, and its independent columns.

Source: Kane's form of inverse dynamics, in link frames: the torque of active joint m is the sum over links of the
link's force and moment times its partial velocities by m. Loops are in these partial velocities, so the tree's torques
are never formed (Khalil and Dombre 2002, eq. 10.25, for the same projection).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from haptid.dynamics.symbolic.arithmetic import Points, PrimeField, Residues, UnluckyDrawError
from haptid.dynamics.symbolic.chain import States, SymbolicChain
from haptid.dynamics.symbolic.geometry import SymbolicJoint, about_z, placement_residues
from haptid.dynamics.symbolic.symbols import Symbol, draw

Functions = dict[Hashable, Residues]
# Entries of the map J v over XX XY XZ YY YZ ZZ: row, component of v, parameter.
INERTIA = ((0, 0, 0), (0, 1, 1), (0, 2, 2), (1, 0, 1), (1, 1, 3), (1, 2, 4), (2, 0, 2), (2, 1, 4), (2, 2, 5))


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Motion of a link's frame in its own axes, all residues.

    Attributes:
        w, dw: angular velocity and acceleration, (n, 3).
        a: acceleration of the origin less gravity, (n, 3).
        Jv, Jw: partial velocity of the origin and angular velocity by each active joint, (n, 3, active).
    """

    w: Residues
    dw: Residues
    a: Residues
    Jv: Residues
    Jw: Residues


def regressor(chain: SymbolicChain, rng: np.random.Generator, points: Points, samples: int) -> Residues:
    """Rows of measured torque by raw standard parameter, (sets, samples * rows, columns).

    Args:
        chain: the mechanism.
        rng: random generator.
        points: sets of lengths.
        samples: states for each set.
    """
    field, each = points.field, points.repeated(samples)
    states = chain.motion.states(rng, each)
    blocks = [link_columns(field, link) for link in _links(chain, states, points, each)]
    functions = _functions(chain, field, rng, each.count)
    blocks += [column.modulo(states, each, functions)[:, :, None] for column in chain.columns]
    W = np.concatenate(blocks, axis=2)
    if chain.rows is not None:
        W = _measured(chain, field, W)
    return W.reshape(points.count, samples * W.shape[1], W.shape[2])


def _links(chain: SymbolicChain, states: States, points: Points, each: Points) -> list[LinkMotion]:
    """Motion of all links, parents first; `each` are the points of every state."""
    field, samples = points.field, each.count // points.count
    zero = np.zeros((each.count, 3), dtype=np.int64)
    up = np.stack([field.reduce(-part.modulo(each)) for part in chain.gravity], axis=1)
    still = np.zeros((each.count, 3, states.G.shape[2]), dtype=np.int64)
    base = LinkMotion(zero, zero, up, still, still)
    links: list[LinkMotion] = []
    for j, joint in enumerate(chain.joints):
        placed = np.repeat(placement_residues(joint.placement, points), samples, axis=0)
        links.append(_moved(field, links[joint.parent] if joint.parent >= 0 else base, joint, placed, states, j))
    return links


def _moved(
    field: PrimeField, parent: LinkMotion, joint: SymbolicJoint, placed: Residues, states: States, j: int
) -> LinkMotion:
    """Motion of the link of joint j, from its parent's and its own placement, (n, 4, 4)."""
    back = np.swapaxes(field.product(placed[:, :3, :3], about_z(states.cos[j], states.sin[j])), 1, 2)
    origin = placed[:, :3, 3]
    if joint.prismatic:
        origin = field.reduce(origin + placed[:, :3, 2] * states.slide[j][:, None])
    rate, acceleration, G = states.velocity[j][:, None], states.acceleration[j][:, None], states.G[j]
    swing = field.reduce(_cross(parent.dw) + field.product(_cross(parent.w), _cross(parent.w)))
    a = apply(field, back, field.reduce(parent.a + apply(field, swing, origin)))
    w, dw = apply(field, back, parent.w), apply(field, back, parent.dw)
    Jw = field.product(back, parent.Jw)
    Jv = field.product(back, field.reduce(parent.Jv - field.product(_cross(origin), parent.Jw)))
    z = np.array([0, 0, 1])
    across = field.reduce(np.stack([w[:, 1], -w[:, 0], np.zeros_like(w[:, 0])], axis=1) * rate)  # w x z rate
    if joint.prismatic:
        a = field.reduce(a + z * acceleration + 2 * across)
        Jv[:, 2] = field.reduce(Jv[:, 2] + G)
    else:
        w, dw = field.reduce(w + z * rate), field.reduce(dw + z * acceleration + across)
        Jw[:, 2] = field.reduce(Jw[:, 2] + G)
    return LinkMotion(w, dw, a, Jv, Jw)


def link_columns(field: PrimeField, link: LinkMotion) -> Residues:
    """Torques of the active joints by XX XY XZ YY YZ ZZ MX MY MZ M of a link, (n, active, 10)."""
    spin = _cross(link.w)
    moment = field.reduce(times_inertia(link.dw) + field.product(spin, times_inertia(link.w)))
    force = field.reduce(_cross(link.dw) + field.product(spin, spin))
    of_v, of_w = np.swapaxes(link.Jv, 1, 2), np.swapaxes(link.Jw, 1, 2)
    first = field.reduce(field.product(of_v, force) - field.product(of_w, _cross(link.a)))
    return np.concatenate([field.product(of_w, moment), first, field.product(of_v, link.a[:, :, None])], axis=2)


def _cross(v: Residues) -> Residues:
    """Matrices of the cross product with v, (n, 3, 3)."""
    made = np.zeros((len(v), 3, 3), dtype=np.int64)
    made[:, 2, 1], made[:, 0, 2], made[:, 1, 0] = v[:, 0], v[:, 1], v[:, 2]
    return made - np.swapaxes(made, 1, 2)


def times_inertia(v: Residues) -> Residues:
    """Matrices of J v over XX XY XZ YY YZ ZZ, (n, 3, 6)."""
    made = np.zeros((len(v), 3, 6), dtype=np.int64)
    for row, component, parameter in INERTIA:
        made[:, row, parameter] = v[:, component]
    return made


def apply(field: PrimeField, matrices: Residues, vectors: Residues) -> Residues:
    """Matrices (n, 3, 3) times vectors (n, 3)."""
    return field.product(matrices, vectors[:, :, None])[:, :, 0]


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
        members: raw columns whose sum is each standard parameter's column.
    """

    chain: SymbolicChain
    members: tuple[tuple[int, ...], ...]

    def sample(self, rng: np.random.Generator, points: Points, samples: int) -> Residues:
        """Rows at this many states for each set of lengths, (sets, samples * rows, standard parameters)."""
        raw = regressor(self.chain, rng, points, samples)
        W = raw[:, :, [members[0] for members in self.members]]
        for k, members in enumerate(self.members):
            for j in members[1:]:
                W[:, :, k] = points.field.reduce(W[:, :, k] + raw[:, :, j])
        return W

    def pivots(self, field: PrimeField, rng: np.random.Generator) -> Pivots:
        """Columns independent of those before them, at random lengths.

        Independence is certain: a minor that is not zero modulo a prime is not zero. States are added until twice as
        many give no more: the number of rows is no criterion where a torque depends on few of the columns.
        """
        points = draw(self.chain.symbols, field, rng, 1)
        samples = -(-len(self.members) // self.chain.torques) + 1
        W = self.sample(rng, points, samples)
        kept = field.echelon(W)[1]
        while True:
            W = np.concatenate([W, self.sample(rng, points, samples)], axis=1)
            before, kept = kept, field.echelon(W)[1]
            if kept == before:
                break
            samples *= 2
        enough = -(-len(kept) // self.chain.torques) + 1
        while len(field.echelon(W[:, : enough * self.chain.torques, kept])[1]) < len(kept):
            enough += 1
        return Pivots(tuple(kept), tuple(np.flatnonzero(~W[0].any(axis=0)).tolist()), enough + 1)

    def relations(self, rng: np.random.Generator, points: Points, pivots: Pivots, others: list[int]) -> Residues:
        """Coefficients of other columns in those kept, (sets of lengths, kept, others).

        Raises:
            UnluckyDrawError: the columns kept are not independent at some of these lengths.
        """
        kept = len(pivots.kept)
        W = self.sample(rng, points, pivots.samples)[:, :, [*pivots.kept, *others]]
        form, found = points.field.echelon(W, kept)
        if len(found) < kept:
            raise UnluckyDrawError
        return form[:, :, kept:]


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
