"""Loops: how passive joints follow active ones, by relations that are given or derived from joints cut."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.device import Cut, Joint
from haptid.device.expressions import Linear, relation
from haptid.device.geometry import Reader, frame_on
from haptid.device.loops.assembly import Branch, Chain, find_branches
from haptid.device.loops.assembly_mode import newton_closure
from haptid.device.loops.linear import Closure
from haptid.device.loops.newton import NewtonClosure
from haptid.device.toml.place import Place
from haptid.device.toml.schema import CutTable, LoopTable
from haptid.errors import (
    ActiveJointError,
    DuplicateNameError,
    LoopOpenError,
    RelationError,
    UndeterminedLoopError,
    UnknownDeviceNameError,
)

# A loop closes where its gap stays below this share of the mechanism's size.
CLOSED = 1e-6
# Constants this close to a multiple of pi / 12, rates this close to one of 1 / 12, are taken as that.
NICE = 1e-9
# Random poses at which closure is tested.
POSES = 100


@dataclass(frozen=True)
class Loops:
    """The loops of a file, names resolved.

    Attributes:
        passive: indices of the joints that loops move.
        known: what relations say of passive joints, as joint index -> linear in symbols q<name>.
        cuts: joints cut.
        guess: wanted positions of passive joints, roughly, where the active joints are `at`.
        at: positions of active joints, those not named at zero.
        place: of the loops in the file.
    """

    passive: tuple[int, ...]
    known: Mapping[int, Linear]
    cuts: tuple[Cut, ...]
    guess: Mapping[int, float]
    at: Mapping[int, float]
    place: Place


def read_loops(
    tables: Sequence[LoopTable], joints: Sequence[Joint], base: Array, reader: Reader, place: Place
) -> Loops:
    """Resolve names, expressions and frames of all loops."""
    index = {joint.name: k for k, joint in enumerate(joints)}
    known: dict[int, Linear] = {}
    passive: dict[int, Place] = {}
    guess: dict[int, float] = {}
    at: dict[int, float] = {}
    cuts: list[Cut] = []
    for k, table in enumerate(tables):
        here = place.at(k)
        named = [(name, here.at("passive", i)) for i, name in enumerate(table.passive)]
        for i, text in enumerate(table.relations):
            symbol, linear = relation(text, [f"q{name}" for name in index], reader.lengths, here.at("relations", i))
            if index[symbol[1:]] in known:
                raise RelationError(
                    str(here.at("relations", i)),
                    f"{symbol} already has a relation",
                    "Keep one for each passive joint.",
                )
            known[index[symbol[1:]]] = linear
            named.append((symbol[1:], here.at("relations", i)))
        for name, where in named:
            passive.setdefault(_found(name, index, where), where)
        for key, values, known_as in (("guess", table.guess, guess), ("at", table.at, at)):
            for name, value in values.items():
                known_as[_found(name, index, here.at(key, name))] = reader.number(value, here.at(key, name))
        if table.cut is not None:
            _refuse_taken(table.cut.name, index, cuts, here.at("cut", "name"))
            cuts.append(_cut(table.cut, joints, base, reader, here.at("cut")))
        elif not table.relations:
            raise RelationError(
                str(here),
                "this loop has neither relations nor a cut",
                'Add relations = ["q3 = ..."] or cut = {...}.',
            )
        elif missing := [name for name in table.passive if index[name] not in known]:
            raise RelationError(
                str(here),
                f"nothing says how {', '.join(missing)} move",
                f'Add "q{missing[0]} = ..." to its relations.',
            )
    for j in guess:
        if j not in passive:
            raise RelationError(
                str(place),
                f"guess names joint {joints[j].name}, which no loop moves",
                "Guess passive joints only.",
            )
    for j in at:
        if j in passive:
            found = f"at names joint {joints[j].name}, which a loop moves"
            raise RelationError(str(place), found, "Place active joints there, and passive ones under guess.")
    return Loops(tuple(sorted(passive)), known, tuple(cuts), guess, at, place)


def active_joints(
    joints: Sequence[Joint], declared: Sequence[bool | None], loops: Loops, place: Place
) -> tuple[int, ...]:
    """Indices of the independent joints: those that no loop moves.

    Raises:
        ActiveJointError: a joint is declared active but a loop moves it, or passive and no loop moves it.
    """
    for j, (joint, active) in enumerate(zip(joints, declared, strict=True)):
        at = str(place.at(j, "active"))
        if active and j in loops.passive:
            found = "is declared active, but is a passive joint of a loop"
            raise ActiveJointError(at, joint.name, found, "Remove active = true, or the joint from the loop.")
        if active is False and j not in loops.passive:
            found = "is declared passive, but no loop says how it moves"
            raise ActiveJointError(at, joint.name, found, "Add it to a loop's passive list, or give it a relation.")
    return tuple(j for j in range(len(joints)) if j not in loops.passive)


def close(
    joints: Sequence[Joint], active: tuple[int, ...], loops: Loops
) -> tuple[Closure | NewtonClosure, tuple[str, ...]]:
    """How all joints follow the active ones, and what is worth noting about the choice.

    Raises:
        LoopOpenError: the cuts do not close.
        UndeterminedLoopError: they leave a passive joint free.
        LoopBranchError: they close in several ways that are not linear, and nothing chooses.
        SingularLoopError: they are singular at the start pose.
        RelationError: the relations do not settle the joints on their left.
    """
    names = [joint.name for joint in joints]
    G, offset, settled = _from_relations(names, active, loops)
    unknown = [j for j in loops.passive if j not in settled]
    notes: tuple[str, ...] = ()
    error = 0.0
    if loops.cuts:
        chain = Chain.of(joints, loops.cuts, active)
        at = np.array([loops.at.get(k, 0.0) for k in active])
        left = unknown
        if unknown:
            G, offset, left, notes = _derived(chain, G, offset, unknown, loops, at)
        if left:
            told = {j: relation_text(names, j, active, G[j], offset[j]) for j in loops.passive if j not in left}
            return newton_closure(chain, G, offset, left, told, (loops.guess, at), str(loops.place)), notes
        error = chain.gap(G, offset, POSES)
        if error > CLOSED * chain.size:
            how = "with the relations given," if not unknown else "at best,"
            raise LoopOpenError(str(loops.place), error, CLOSED * chain.size, how)
    relations = tuple(relation_text(names, j, active, G[j], offset[j]) for j in loops.passive)
    return Closure(G, offset, error, relations, loops.cuts), notes


def _cut(table: CutTable, joints: Sequence[Joint], base: Array, reader: Reader, place: Place) -> Cut:
    """A cut joint, its two frames in normal form."""
    index = {"base": -1, **{joint.name: k for k, joint in enumerate(joints)}}
    on, twin = _found(table.on, index, place.at("on")), _found(table.with_, index, place.at("with"))
    return Cut(
        table.type == "prismatic",
        frame_on(joints, on, reader.frame(table.frame, place.at("frame")), base),
        frame_on(joints, twin, reader.frame(table.twin, place.at("twin")), base),
        table.name,
    )


def _refuse_taken(name: str | None, index: Mapping[str, int], cuts: Sequence[Cut], place: Place) -> None:
    """A cut's name must be no other joint's."""
    if name is None:
        return
    if name in index or name == "base":
        raise DuplicateNameError(str(place), "joint", name, "the base" if name == "base" else "one of joints")
    if name in [cut.name for cut in cuts]:
        raise DuplicateNameError(str(place), "joint", name, "the cut of an earlier loop")


def _found(name: str, index: Mapping[str, int], place: Place) -> int:
    if name not in index:
        raise UnknownDeviceNameError(str(place), "joint", name, index)
    return index[name]


def _from_relations(names: list[str], active: tuple[int, ...], loops: Loops) -> tuple[Array, Array, list[int]]:
    """G and offset of active joints and of those with a relation; rows of the others are zero."""
    n, settled = len(names), sorted(loops.known)
    G, offset = np.zeros((n, len(active))), np.zeros(n)
    G[list(active), np.arange(len(active))] = 1.0
    if not settled:
        return G, offset, settled
    index = {f"q{name}": k for k, name in enumerate(names)}
    factors = np.zeros((len(settled), n))
    for row, j in enumerate(settled):
        for symbol, factor in loops.known[j].factors.items():
            factors[row, index[symbol]] += factor
    open_ended = [k for k in np.flatnonzero(factors.any(axis=0)) if k not in settled and k not in active]
    if open_ended:
        found = f"the relations use q{names[open_ended[0]]}, which is itself passive and has no relation"
        raise RelationError(str(loops.place), found, "Write them in active joints, or add its relation.")
    among = np.eye(len(settled)) - factors[:, settled]
    if np.linalg.matrix_rank(among) < len(settled):
        raise RelationError(
            str(loops.place),
            "the relations go round in a circle",
            "Write passive joints in terms of active ones.",
        )
    G[settled] = np.linalg.solve(among, factors[:, list(active)])
    offset[settled] = np.linalg.solve(among, [loops.known[j].constant for j in settled])
    return G, offset, settled


def _derived(
    chain: Chain, G: Array, offset: Array, unknown: list[int], loops: Loops, at: Array
) -> tuple[Array, Array, list[int], tuple[str, ...]]:
    """G and offset completed with the linear motions that close the cuts, and the joints that no such motion moves."""
    search = find_branches(chain, G, offset, unknown, loops.guess, at, CLOSED)
    where, limit = str(loops.place), CLOSED * chain.size
    if not search.closed:
        raise LoopOpenError(where, search.best, limit, f"from {search.starts} starts, at the best one")
    if search.free:
        raise UndeterminedLoopError(where, search.free, len(unknown))
    if not search.linear:
        return _apart(chain, G, offset, unknown, loops, at)
    rounded = [_nice(chain, branch, unknown, loops.guess, at) for branch in search.linear]
    best = min(rounded, key=lambda branch: _preference(branch, unknown, loops.guess, at))
    notes: tuple[str, ...] = ()
    if len(rounded) > 1 and not loops.guess:
        notes = (
            f"the loops close in {len(rounded)} linear ways; the one with the smallest constants was taken. "
            f"Add guess = {{...}} to a loop to choose another.",
        )
    return best.G, best.offset, [], notes


def _apart(
    chain: Chain, G: Array, offset: Array, unknown: list[int], loops: Loops, at: Array
) -> tuple[Array, Array, list[int], tuple[str, ...]]:
    """The same where not all loops are linear: those that share no passive joint are looked at one by one."""
    groups = chain.independent(unknown)
    left: list[int] = []
    notes: tuple[str, ...] = ()
    if len(groups) == 1:
        return G, offset, unknown, ()
    for cuts, joints in groups:
        part = Chain.of(chain.joints, cuts, chain.active)
        G, offset, more, told = _derived(part, G, offset, joints, loops, at)
        left, notes = left + more, notes + told
    return G, offset, sorted(left), notes


def _nice(chain: Chain, branch: Branch, unknown: list[int], guess: Mapping[int, float], at: Array) -> Branch:
    """The branch with its constants within a turn, and rounding taken off constants and rates."""
    G, offset = branch.G.copy(), branch.offset.copy()
    for j in unknown:
        G[j] = [nearest(g, 1 / 12) for g in G[j]]
        if not chain.joints[j].prismatic:
            centre = guess[j] - float(G[j] @ at) if j in guess else 0.0
            turns = math.ceil((offset[j] - centre) / (2 * math.pi) - 0.5 - 1e-9)
            offset[j] = nearest(offset[j] - 2 * math.pi * turns, math.pi / 12)
        elif abs(offset[j]) < NICE:
            offset[j] = 0.0
    return Branch(G, offset, branch.at)


def nearest(value: float, step: float) -> float:
    """The nearest multiple of a step where it is within NICE, else the value itself."""
    multiple = round(value / step) * step
    return multiple + 0.0 if abs(value - multiple) < NICE else value


def _preference(branch: Branch, unknown: list[int], guess: Mapping[int, float], at: Array) -> tuple[float, float]:
    """Distance from the guess, then size of the constants."""
    there = branch.G @ at + branch.offset
    away = sum(abs(there[j] - value) for j, value in guess.items() if j in unknown)
    return round(float(away), 6), round(float(np.abs(branch.offset[unknown]).sum()), 6)


def relation_text(names: Sequence[str], joint: int, active: tuple[int, ...], row: Array, constant: float) -> str:
    """A relation as the file would have it, such as `q3 = pi/2 - q2 + q7`."""
    parts = [("-" if constant < 0 else "+", _angle(abs(constant)))] if constant else []
    for k, factor in zip(active, row, strict=True):
        if factor:
            size = "" if abs(factor) == 1 else f"{abs(factor):.12g}*"
            parts.append(("-" if factor < 0 else "+", f"{size}q{names[k]}"))
    if not parts:
        return f"q{names[joint]} = 0"
    (sign, first), *rest = parts
    return f"q{names[joint]} = {'-' if sign == '-' else ''}{first}" + "".join(f" {s} {text}" for s, text in rest)


def _angle(value: float) -> str:
    twelfths = round(value / (math.pi / 12))
    if twelfths == 0 or abs(value - twelfths * math.pi / 12) > NICE:
        return f"{value:.12g}"
    shared = math.gcd(twelfths, 12)
    above, below = twelfths // shared, 12 // shared
    return ("pi" if above == 1 else f"{above}*pi") + ("" if below == 1 else f"/{below}")
