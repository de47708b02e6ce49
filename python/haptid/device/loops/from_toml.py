"""The [[loops]] of a device file: relations that are given, or derived from cut joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.expressions import JointPolynomial, relation
from haptid.device.geometry import Reader, frame_on
from haptid.device.loops.chain import Chain
from haptid.device.loops.formula import AnyClosure, FormulaClosure, formula_closure
from haptid.device.loops.linear import Closure, ClosureProblem, LinearMotion, find_linear_motions
from haptid.device.loops.newton import NewtonClosure, measured_closure, newton_closure, open_loops
from haptid.device.loops.relations import EXACT, nearest, polynomial_text, relation_text
from haptid.device.parts import Cut, Joint
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import CutTable, LoopTable
from haptid.errors import DeviceFileError, LoopClosureError, SingularityError

# A loop is closed if its gap stays below this share of the mechanism's size.
_CLOSED = 1e-6
# Random poses at which closure is tested.
_POSES = 100


@dataclass(frozen=True)
class Loops:
    """The loops of a file, names resolved.

    Attributes:
        passive: indices of the joints that loops move.
        known: relations of passive joints, joint index -> polynomial in symbols q<name>.
        cuts: joints cut.
        guess: rough positions of passive joints where the active joints are `at`.
        at: positions of active joints; others are at zero.
        place: of the loops in the file.
    """

    passive: tuple[int, ...]
    known: Mapping[int, JointPolynomial]
    cuts: tuple[Cut, ...]
    guess: Mapping[int, float]
    at: Mapping[int, float]
    place: Place


def read_loops(
    tables: Sequence[LoopTable], joints: Sequence[Joint], base: Array, reader: Reader, place: Place
) -> Loops:
    """Resolve names, expressions and frames of all loops."""
    index = {joint.name: k for k, joint in enumerate(joints)}
    known: dict[int, JointPolynomial] = {}
    passive: dict[int, Place] = {}
    guess: dict[int, float] = {}
    start_values: dict[int, float] = {}
    cuts: list[Cut] = []
    for k, table in enumerate(tables):
        loop_place = place.at(k)
        named = [(name, loop_place.at("passive", i)) for i, name in enumerate(table.passive)]
        for i, text in enumerate(table.relations):
            symbol, polynomial = relation(
                text, [f"q{name}" for name in index], reader.lengths, loop_place.at("relations", i)
            )
            if index[symbol[1:]] in known:
                raise loop_place.at("relations", i).error(
                    f"{symbol} already has a relation", "Keep one for each passive joint."
                )
            known[index[symbol[1:]]] = polynomial
            named.append((symbol[1:], loop_place.at("relations", i)))
        for name, named_place in named:
            passive.setdefault(_found(name, index, named_place), named_place)
        for key, values, known_as in (("guess", table.guess, guess), ("at", table.at, start_values)):
            for name, value in values.items():
                known_as[_found(name, index, loop_place.at(key, name))] = reader.number(value, loop_place.at(key, name))
        if table.cut is not None:
            _refuse_taken(table.cut.name, index, cuts, loop_place.at("cut", "name"))
            cuts.append(_cut(table.cut, joints, base, reader, loop_place.at("cut")))
        elif not table.relations:
            raise loop_place.error(
                "this loop has neither relations nor a cut", 'Add relations = ["q3 = ..."] or cut = {...}.'
            )
        elif missing := [name for name in table.passive if index[name] not in known]:
            raise loop_place.error(
                f"nothing says how {', '.join(missing)} move", f'Add "q{missing[0]} = ..." to its relations.'
            )
    for j in guess:
        if j not in passive:
            raise place.error(f"guess names joint {joints[j].name}, which no loop moves", "Guess passive joints only.")
    for j in start_values:
        if j in passive:
            found = f"at names joint {joints[j].name}, which a loop moves"
            raise place.error(found, "Place active joints there, and passive ones under guess.")
    return Loops(tuple(sorted(passive)), known, tuple(cuts), guess, start_values, place)


def active_joints(
    joints: Sequence[Joint], declared: Sequence[bool | None], loops: Loops, place: Place
) -> tuple[int, ...]:
    """Indices of the independent joints: those that no loop moves.

    Raises:
        DeviceFileError: a joint is declared active but a loop moves it, or passive and no loop moves it; or loops
            leave no joint that moves by itself.
    """
    for j, (joint, active) in enumerate(zip(joints, declared, strict=True)):
        joint_place = place.at(j, "active")
        if active and j in loops.passive:
            found = "is declared active, but is a passive joint of a loop"
            raise joint_place.error(
                f'joint "{joint.name}" {found}', "Remove active = true, or the joint from the loop."
            )
        if active is False and j not in loops.passive:
            found = "is declared passive, but no loop says how it moves"
            raise joint_place.error(
                f'joint "{joint.name}" {found}', "Add it to a loop's passive list, or give it a relation."
            )
    independent = tuple(j for j in range(len(joints)) if j not in loops.passive)
    if not independent:
        raise loops.place.error("all joints are passive, so nothing moves", "Leave one out of the passive lists.")
    return independent


def close(joints: Sequence[Joint], active: tuple[int, ...], loops: Loops) -> tuple[AnyClosure, tuple[str, ...]]:
    """The loop closure, and notes on how it was chosen.

    Raises:
        LoopClosureError: the cuts do not close, or close in several assembly modes and nothing chooses.
        SingularityError: they are singular at the start pose.
        DeviceFileError: cuts or relations do not determine the passive joints.
    """
    names = [joint.name for joint in joints]
    if any(polynomial.linear is None for polynomial in loops.known.values()):
        return _by_formulas(joints, active, loops), ()
    G, offset, solved = _from_relations(names, active, loops)
    unknown = [j for j in loops.passive if j not in solved]
    notes: tuple[str, ...] = ()
    error = 0.0
    if loops.cuts:
        chain = Chain.of(joints, loops.cuts, active)
        start_pose = np.array([loops.at.get(k, 0.0) for k in active])
        problem = ClosureProblem(chain, G, offset, unknown, loops.guess, start_pose)
        if unknown:
            problem, notes = _with_linear_motions(problem, loops.place)
        G, offset, left = problem.G, problem.offset, problem.unknown
        if left:
            known = {j: relation_text(names, j, active, G[j], offset[j]) for j in loops.passive if j not in left}
            return newton_closure(problem, known, loops.place), notes
        error = chain.gap(G, offset, _POSES)
        if error > _CLOSED * chain.size:
            attempts = "with the relations given," if not unknown else "at best,"
            raise open_loops(loops.place, error, _CLOSED * chain.size, attempts)
    relations = tuple(relation_text(names, j, active, G[j], offset[j]) for j in loops.passive)
    return Closure(G, offset, error, relations, loops.cuts), notes


def close_as(
    known: AnyClosure, joints: Sequence[Joint], active: tuple[int, ...], loops: Loops
) -> tuple[AnyClosure, tuple[str, ...]]:
    """As `close`; a known closure that closes these loops too, up to rounding, needs no search."""
    fits = loops.cuts and not loops.known and known.constant.shape == (len(joints), len(active))
    if fits and isinstance(known, Closure | NewtonClosure):
        chain = Chain.of(joints, loops.cuts, active)
        with suppress(LoopClosureError, SingularityError):
            moved = _moved(known, chain)
            if moved.error < EXACT * chain.size and np.array_equal(moved.varying, known.varying):
                return moved, ()
    return close(joints, active, loops)


def _moved(known: Closure | NewtonClosure, chain: Chain) -> Closure | NewtonClosure:
    """The closure for a chain of other lengths, its error measured."""
    if isinstance(known, NewtonClosure):
        return measured_closure(known.moved_to(chain))
    return replace(known, error=chain.gap(known.G, known.offset, _POSES), cuts=chain.cuts)


def _cut(table: CutTable, joints: Sequence[Joint], base: Array, reader: Reader, place: Place) -> Cut:
    """A cut joint, its two frames in normal form."""
    index = {"base": -1, **{joint.name: k for k, joint in enumerate(joints)}}
    a, b = (_found(name, index, place.at(key)) for key, name in (("body_a", table.body_a), ("body_b", table.body_b)))
    return Cut(
        table.type,
        frame_on(joints, a, reader.frame(table.frame_a, place.at("frame_a")), base),
        frame_on(joints, b, reader.frame(table.frame_b, place.at("frame_b")), base),
        table.name,
    )


def _refuse_taken(name: str | None, index: Mapping[str, int], cuts: Sequence[Cut], place: Place) -> None:
    """Raise DeviceFileError if the name of a cut is another joint's."""
    if name is None:
        return
    if name in index or name == "base":
        raise place.taken("joint", name, "the base" if name == "base" else "one of joints")
    if name in [cut.name for cut in cuts]:
        raise place.taken("joint", name, "the cut of an earlier loop")


def _found(name: str, index: Mapping[str, int], place: Place) -> int:
    if name not in index:
        raise place.unknown("joint", name, index)
    return index[name]


def _by_formulas(joints: Sequence[Joint], active: tuple[int, ...], loops: Loops) -> FormulaClosure:
    """The closure of relations of which some are of higher degree: all in the active joints, by substitution."""
    if loops.cuts:
        found = "it has a relation that is not linear, and a loop with a cut"
        raise loops.place.error(found, "Close all loops by cuts, or write relations for all passive joints.")
    polynomials: dict[int, JointPolynomial] = {}
    while len(polynomials) < len(loops.known):
        ready = {f"q{joints[k].name}" for k in (*active, *polynomials)}
        free = [j for j, polynomial in loops.known.items() if j not in polynomials and polynomial.symbols <= ready]
        if not free:
            rest = next(j for j in loops.known if j not in polynomials)
            other = min(loops.known[rest].symbols - ready)
            found = f"the relation of q{joints[rest].name} uses {other}, which has none, or they are circular"
            raise loops.place.error(found, "Write passive joints in terms of active ones.")
        by_symbol = {f"q{joints[j].name}": polynomial for j, polynomial in polynomials.items()}
        try:
            polynomials |= {j: loops.known[j].replaced(by_symbol) for j in free}
        except OverflowError as error:
            raise loops.place.error(f"with relations put into each other, {error}", "Use fewer powers.") from None
    return formula_closure(
        joints, active, polynomials, [polynomial_text(joints[j].name, polynomials[j]) for j in sorted(polynomials)]
    )


def _from_relations(names: list[str], active: tuple[int, ...], loops: Loops) -> tuple[Array, Array, list[int]]:
    """G and offset of active joints and of joints with a relation; other rows are zero."""
    n, solved = len(names), sorted(loops.known)
    G, offset = np.zeros((n, len(active))), np.zeros(n)
    G[list(active), np.arange(len(active))] = 1.0
    if not solved:
        return G, offset, solved
    index = {f"q{name}": k for k, name in enumerate(names)}
    factors = np.zeros((len(solved), n))
    for row, j in enumerate(solved):
        for product, factor in loops.known[j].terms.items():
            if product:
                factors[row, index[product[0]]] += factor
    open_ended = [k for k in np.flatnonzero(factors.any(axis=0)) if k not in solved and k not in active]
    if open_ended:
        found = f"the relations use q{names[open_ended[0]]}, which is itself passive and has no relation"
        raise loops.place.error(found, "Write them in active joints, or add its relation.")
    among = np.eye(len(solved)) - factors[:, solved]
    if np.linalg.matrix_rank(among) < len(solved):
        raise loops.place.error("the relations are circular", "Write passive joints in terms of active ones.")
    G[solved] = np.linalg.solve(among, factors[:, list(active)])
    offset[solved] = np.linalg.solve(among, [loops.known[j].terms.get((), 0.0) for j in solved])
    return G, offset, solved


def _with_linear_motions(problem: ClosureProblem, place: Place) -> tuple[ClosureProblem, tuple[str, ...]]:
    """The problem with the linear motions that close its cuts, and notes; joints whose rates vary are still unknown."""
    search = find_linear_motions(problem, _CLOSED)
    if not search.closed:
        limit = _CLOSED * problem.chain.size
        raise open_loops(place, search.best, limit, search.attempts)
    if search.free:
        count = len(problem.unknown)
        raise DeviceFileError(
            f"{place}: the loop constraints determine only {count - search.free} of {count} passive joints; "
            f"{search.free} can still move with the active ones at rest.",
            where=place.key,
            found=count - search.free,
            limit=count,
            advice=f"Make {search.free} more of them active, or add a cut.",
        )
    if not search.linear:
        return _by_groups(problem, place)
    notes: tuple[str, ...] = ()
    if len(search.linear) > 1 and not problem.guess:
        notes = (
            f"the loops close in {len(search.linear)} linear assembly modes; the one with the smallest constants was "
            "taken. Add guess = {...} to a loop to choose another.",
        )
    return problem.with_motion(_preferred(problem, search.linear)), notes


def _by_groups(problem: ClosureProblem, place: Place) -> tuple[ClosureProblem, tuple[str, ...]]:
    """Linear motions where not all loops have one: groups that share no passive joint are searched one by one."""
    groups = problem.chain.independent(problem.unknown)
    if len(groups) == 1:
        return _by_single_loops(problem), ()
    left: list[int] = []
    notes: tuple[str, ...] = ()
    for cuts, joints in groups:
        part, added = _with_linear_motions(problem.of(cuts, joints), place)
        problem = replace(problem, G=part.G, offset=part.offset)
        left, notes = left + part.unknown, notes + added
    return replace(problem, unknown=sorted(left)), notes


def _by_single_loops(problem: ClosureProblem) -> ClosureProblem:
    """Linear motions of single loops within one group of loops, such as the parallelograms of a leg."""
    waiting = list(problem.chain.cuts)
    while waiting:
        cut = waiting.pop(0)
        own = problem.of((cut,), problem.unknown)
        part = replace(own, unknown=[j for _, joints in own.chain.independent(problem.unknown) for j in joints])
        if not 0 < len(part.unknown) < len(problem.unknown):
            continue
        search = find_linear_motions(part, _CLOSED)
        if search.linear and not search.free:
            motion = _preferred(part, search.linear)
            left = [j for j in problem.unknown if j not in part.unknown]
            problem = replace(problem, G=motion.G, offset=motion.offset, unknown=left)
            waiting = list(problem.chain.cuts)
    return problem


def _preferred(problem: ClosureProblem, motions: Sequence[LinearMotion]) -> LinearMotion:
    """Of motions with rounded constants, the one nearest to the guess, then the one with the smallest constants."""

    def preference(motion: LinearMotion) -> tuple[float, float]:
        positions = motion.G @ problem.start_pose + motion.offset
        distance = sum(abs(positions[j] - value) for j, value in problem.guess.items() if j in problem.unknown)
        return round(float(distance), 6), round(float(np.abs(motion.offset[problem.unknown]).sum()), 6)

    return min((_rounded(problem, motion) for motion in motions), key=preference)


def _rounded(problem: ClosureProblem, motion: LinearMotion) -> LinearMotion:
    """The motion with constants within a turn, and constants and rates rounded to simple fractions."""
    G, offset, guess = motion.G.copy(), motion.offset.copy(), problem.guess
    for j in problem.unknown:
        G[j] = [nearest(g, 1 / 12) for g in G[j]]
        if not problem.chain.joints[j].prismatic:
            centre = guess[j] - float(G[j] @ problem.start_pose) if j in guess else 0.0
            turns = math.ceil((offset[j] - centre) / (2 * math.pi) - 0.5 - 1e-9)
            offset[j] = nearest(offset[j] - 2 * math.pi * turns, math.pi / 12)
        elif abs(offset[j]) < EXACT:
            offset[j] = 0.0
    return LinearMotion(G, offset, motion.at)
