"""How the joints of a mechanism move, modulo a prime: all of them from the active ones, at exact points.

Columns beside link inertia, modulo a prime: sums of parts that are independent unless they are the same.

A mechanism with its lengths as symbols: tree, cuts, motion, gravity, terms and measured rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Closure, Counterbalance, Device, TermColumn
from haptid.device.toml.schema import AnyDevice
from haptid.dynamics.symbolic.arithmetic import ZERO, Field, Laurent, Residues, powers
from haptid.dynamics.symbolic.geometry import (
    ExactCut,
    ExactFrame,
    ExactJoint,
    GeometryReader,
    Placement,
    Shift,
    placements,
)
from haptid.dynamics.symbolic.symbols import GRAVITY, LENGTH, PURE, Symbol, Symbols, ratio
from haptid.errors import ManyAnglesError


@dataclass(frozen=True, eq=False)
class States:
    """Joints at states drawn at random, all of them residues.

    The position of a turning joint is drawn apart from its cosine and sine: no polynomial ties them.

    Attributes:
        cos, sin: of turning joints, (joints, n); one and zero for sliding ones.
        slide: of sliding joints, (joints, n); zero for turning ones.
        position, velocity, acceleration: (joints, n).
        G: rates of all joints by active one, (joints, n, active).
        active: position, velocity and acceleration of the active joints, (3, active, n).
    """

    cos: Residues
    sin: Residues
    slide: Residues
    position: Residues
    velocity: Residues
    acceleration: Residues
    G: Residues
    active: Residues


class Motion(Protocol):
    """What a closed chain needs to tell of its loops; a loop of another kind is another class with these two."""

    @property
    def depends(self) -> tuple[Laurent, ...]:
        """What it depends on besides the placements of joints and of the frames of cuts."""

    def states(self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], count: int) -> States:
        """States drawn at random, one for each of `count` sets of lengths.

        Args:
            field: the residues' prime.
            rng: where they are drawn from.
            values: residues of all symbols, (count,) each.
            count: number of states.
        """


@dataclass(frozen=True)
class LinearMotion:
    """Every joint a linear function of the active ones: q = G qa + offset.

    Attributes:
        prismatic: of every joint.
        rates: G, by joint and active joint.
        multiples: angle of a turning joint in units of each active joint's, whole numbers, by joint and active joint.
        turns: cosine and sine of every turning joint's offset.
        offsets: of every joint, as a length or an angle.
    """

    prismatic: tuple[bool, ...]
    rates: tuple[tuple[Laurent, ...], ...]
    multiples: tuple[tuple[int, ...], ...]
    turns: tuple[tuple[Laurent, Laurent], ...]
    offsets: tuple[Laurent, ...]

    @property
    def depends(self) -> tuple[Laurent, ...]:
        """See Motion."""
        return (*self.offsets, *(part for row in (*self.rates, *self.turns) for part in row))

    def states(self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], count: int) -> States:
        """See Motion."""
        actives = len(self.rates[0])
        active = field.draw(rng, 3, actives, count)
        G: Residues = np.array([[entry.modulo(field, values, count) for entry in row] for row in self.rates])
        moved = np.zeros((3, len(self.rates), count), dtype=np.int64)
        for k in range(actives):  # one product at a time: a sum over many active joints could overflow
            moved = field.reduce(moved + G[:, k] * active[:, None, k])
        offsets: Residues = np.array([offset.modulo(field, values, count) for offset in self.offsets])
        position = field.reduce(moved[0] + offsets)
        cos, sin = self._angles(field, rng, values, count)
        slide = np.where(np.array(self.prismatic)[:, None], position, 0)
        return States(cos, sin, slide, position, moved[1], moved[2], np.moveaxis(G, 1, 2), active)

    def _angles(
        self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], count: int
    ) -> tuple[Residues, Residues]:
        units = [field.circle(rng, count) for _ in self.rates[0]]
        cos = np.ones((len(self.rates), count), dtype=np.int64)
        sin = np.zeros_like(cos)
        for j, (multiples, prismatic) in enumerate(zip(self.multiples, self.prismatic, strict=True)):
            if prismatic:
                continue
            c, s = self.turns[j]
            angle = (c.modulo(field, values, count), s.modulo(field, values, count))
            for unit, times in zip(units, multiples, strict=True):
                if times:
                    angle = field.sum_of_angles(angle, field.multiple_of_angle(unit, times))
            cos[j], sin[j] = angle
        return cos, sin


# Where each of these is found among a coordinate's position, velocity and acceleration.
MOTION = {"position": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True)
class Part:
    """A factor times something that varies with the motion.

    Attributes:
        factor: number.
        what: position, velocity, acceleration, one.
        key: of a function that it is multiplied with, of which nothing is known but that functions with the same key
            are the same; None for none.
    """

    factor: Fraction
    what: str
    key: Hashable = None


@dataclass(frozen=True)
class ExactColumn:
    """A column beside link inertia, acting on a joint, or on a cut's or a motor's combination of active joints.

    Attributes:
        joint: index, None for a cut or a motor.
        weights: of a cut or a motor, one for each active joint.
        parts: what the column is at one of its coordinate's states.
        rest: taken off the position.
    """

    joint: int | None
    weights: tuple[Fraction, ...]
    parts: tuple[Part, ...]
    rest: Laurent = ZERO

    def modulo(
        self, field: Field, states: States, values: Mapping[str, Residues], functions: Mapping[Hashable, Residues]
    ) -> Residues:
        """Residues of the active joints' torques, (n, active)."""
        G, motion = self._coordinate(field, states)
        count = G.shape[0]
        total = np.zeros(count, dtype=np.int64)
        for part in self.parts:
            size = np.ones(count, dtype=np.int64) if part.what == "one" else motion[MOTION[part.what]]
            if part.what == "position":
                size = field.reduce(size - self.rest.modulo(field, values, count))
            if part.key is not None:
                size = field.reduce(size * functions[part.key])
            total = field.reduce(total + field.of(part.factor) * size)
        return field.reduce(G * total[:, None])

    def _coordinate(self, field: Field, states: States) -> tuple[Residues, tuple[Residues, ...]]:
        """Rates of the coordinate by active joint, (n, active), and its position, velocity, acceleration."""
        if self.joint is not None:
            each = (states.position, states.velocity, states.acceleration)
            return states.G[self.joint], tuple(quantity[self.joint] for quantity in each)
        weights = np.array([field.of(weight) for weight in self.weights])
        G = np.broadcast_to(weights, (states.active.shape[2], len(weights)))
        moved = field.reduce(field.reduce(states.active * weights[:, None]).sum(axis=1))  # a sum of few stays small
        return G, tuple(moved)


def exact_columns(device: Device, active: Sequence[int], symbols: Symbols) -> tuple[ExactColumn, ...]:
    """All terms of a device, cuts' and motors' by so many of its active joints."""
    names = device.joint_names
    made = []
    for term in device.terms:
        side, _, name = term.on.partition(" ")
        joint = names.index(name) if side == "joint" else None
        weights = tuple(ratio(float(w)) for w in (term.weights @ device.frame)[list(active)])
        made.append(ExactColumn(joint, weights if joint is None else (), _parts(term), _rest(term, device, symbols)))
    return tuple(made)


def _rest(term: TermColumn, device: Device, symbols: Symbols) -> Laurent:
    """Rest of a spring, counted from where its combination of active joints is zero if it acts on a cut."""
    if term.kind != "spring":
        return Laurent()
    side, _, name = term.on.partition(" ")
    sliding = {f"joint {j.name}" for j in device.joints if j.prismatic}
    sliding |= {f"cut {cut.name}" for cut in device.cut_joints if cut.prismatic}
    slides, rest = term.on in sliding, term.settings[0]
    made = symbols.quantity(rest, f"rest{name}", LENGTH if slides else PURE) if rest else Laurent()
    return made - symbols.position(term.offset, slides, f"q{name}") if side == "cut" else made


def _parts(term: TermColumn) -> tuple[Part, ...]:
    """The parts of a term; friction along one direction, forward or backward, faster or slower, is told apart here."""
    plain = {"rotor": "acceleration", "viscous": "velocity", "offset": "one", "spring": "position"}
    if term.kind in plain:
        return (Part(Fraction(1), plain[term.kind]),)
    if term.kind == "external" and not term.side:
        shape = term.shape
        key = shape if isinstance(shape, Counterbalance) else getattr(shape, "text", "")
        return (Part(Fraction(1), "one", key),)
    if not term.weights.any():  # what it acts on never moves
        return ()
    first = float(term.weights[np.flatnonzero(term.weights)[0]])
    direction = tuple(np.round(term.weights / first, 9).tolist())
    sign, scale = Fraction(1 if first > 0 else -1), abs(first)
    if term.kind == "stribeck":
        velocity, exponent, width = term.settings
        return (Part(sign, "one", ("stribeck", direction, velocity / scale, exponent, width / scale)),)
    width = term.settings[0] / scale
    odd, half = ("coulomb", direction, width), Fraction(term.side, 2)
    if term.kind == "coulomb":
        return (Part(sign, "one", odd),)
    if term.nature == "viscous":
        # max(v, 0) = (v + v sgn v) / 2 and min(v, 0) = (v - v sgn v) / 2.
        return (Part(Fraction(1, 2), "velocity"), Part(sign * half, "velocity", odd))
    # sgn max(v, 0) = (|sgn v| + sgn v) / 2 and sgn min(v, 0) = (sgn v - |sgn v|) / 2, and |sgn v| is one but at rest.
    even = Part(half, "one", ("even", direction, width) if width else None)
    return (Part(sign / 2, "one", odd), even)


# Coefficients are polynomials in the cosines and sines of angles that are no quarter turns: of more angles than these
# they have too many terms to be found, or to be read.
MOST_ANGLES = 4
# Measured torques as combinations of the active joints', None for all of them.
Rows = tuple[tuple[Fraction, ...], ...] | None


@dataclass(frozen=True)
class ExactChain:
    """A tree or closed chain with symbols for its lengths.

    Attributes:
        joints: parents before children.
        cuts: joints cut to leave a tree.
        motion: how the joints follow the active ones.
        gravity: in the base frame, by component.
        columns: beside link inertia.
        torques: how many are measured.
        rows: those that are, each as a combination of the active joints'; None where all of them are.
        symbols: those that the mechanism depends on.
    """

    joints: tuple[ExactJoint, ...]
    cuts: tuple[ExactCut, ...]
    motion: Motion
    gravity: tuple[Laurent, ...]
    columns: tuple[ExactColumn, ...]
    torques: int
    rows: Rows
    symbols: tuple[Symbol, ...]


def exact_chain(device: Device) -> ExactChain:
    """A device's mechanism with symbols for its lengths, from the file it was read from."""

    def linear(_: tuple[ExactJoint, ...], __: tuple[ExactCut, ...], symbols: Symbols) -> Motion:
        return linear_motion(device, symbols)

    return assembled(device, device.tables, range(len(device.active)), _rows(device), linear)


def assembled(
    device: Device,
    tables: AnyDevice,
    active: Sequence[int],
    rows: Rows,
    motion_of: Callable[[tuple[ExactJoint, ...], tuple[ExactCut, ...], Symbols], Motion],
) -> ExactChain:
    """A mechanism from its parts.

    Args:
        device: its joints, gravity and terms.
        tables: its geometry and cuts, as written.
        active: which of the device's active joints its motion takes for that.
        rows: see ExactChain.
        motion_of: makes the motion of joints and cuts.

    Raises:
        ManyAnglesError: more angles than MOST_ANGLES are no quarter turns.
    """
    symbols = Symbols()
    reader = GeometryReader(tables.lengths, device.lengths, symbols)
    placed, frames = placements(tables, [joint.parent for joint in device.joints], reader)
    joints = tuple(
        ExactJoint(joint.parent, joint.prismatic, placement)
        for joint, placement in zip(device.joints, placed, strict=True)
    )
    cuts = _cuts(tables, device.joint_names, frames, reader)
    gravity = _gravity(device.gravity, symbols)
    motion = motion_of(joints, cuts, symbols)
    columns = exact_columns(device, active, symbols)
    steps = [*placed, *(frame.placement for cut in cuts for frame in (cut.frame, cut.twin))]
    used = _used(steps, (*gravity, *motion.depends, *(column.rest for column in columns)))
    known = tuple(symbol for symbol in symbols.all if symbol.name in used)
    angles = {symbol.angle for symbol in known if symbol.angle}
    if len(angles) > MOST_ANGLES:
        raise ManyAnglesError(len(angles), MOST_ANGLES)
    return ExactChain(joints, cuts, motion, gravity, columns, len(active) if rows is None else len(rows), rows, known)


def _cuts(
    tables: AnyDevice, names: Sequence[str], frames: Sequence[Placement], reader: GeometryReader
) -> tuple[ExactCut, ...]:
    base = reader.base(tables.base)
    index = {"base": -1, **{name: k for k, name in enumerate(names)}}
    made = []
    for k, cut in enumerate((loop.cut for loop in tables.loops if loop.cut), 1):
        both = []
        for on, table, word in ((cut.on, cut.frame, "cut"), (cut.with_, cut.twin, "twin")):
            link = index[on]
            local = reader.frame(table, f"{word}{k}")
            both.append(ExactFrame(link, (*(base if link < 0 else frames[link]), *local)))
        made.append(ExactCut(cut.type == "prismatic", *both))
    return tuple(made)


def _gravity(gravity: Array, symbols: Symbols) -> tuple[Laurent, ...]:
    """One symbol g where gravity lies along an axis, one for each component where it does not."""
    along = np.count_nonzero(gravity) == 1
    made = []
    for axis, part in zip("xyz", gravity.tolist(), strict=True):
        size = symbols.named("g" if along else f"g{axis}", abs(part), GRAVITY)
        made.append(size if part > 0 else -size)
    return tuple(made)


def linear_motion(device: Device, symbols: Symbols) -> LinearMotion:
    """The motion of a device's joints: every number in it a ratio of whole numbers, or a symbol."""
    closure, slides = device.closure, [joint.prismatic for joint in device.joints]
    assert isinstance(closure, Closure)
    rates, turns, offsets = [], [], []
    for j, joint in enumerate(device.joints):
        rates.append(
            tuple(
                _rate(float(g), slides[j], slides[k], joint.name, symbols)
                for g, k in zip(closure.G[j], device.active, strict=True)
            )
        )
        offset = float(closure.offset[j])
        turns.append(symbols.turn(0.0 if slides[j] else offset, f"q{joint.name}"))
        offsets.append(symbols.position(offset, slides[j], f"q{joint.name}"))
    multiples = _multiples(closure.G, slides, [slides[k] for k in device.active])
    return LinearMotion(tuple(slides), tuple(rates), multiples, tuple(turns), tuple(offsets))


def _rate(g: float, slides: bool, active_slides: bool, name: str, symbols: Symbols) -> Laurent:
    """How fast a joint follows an active one: a plain number, a length, or one over a length."""
    if g == 0 or slides == active_slides:
        return Laurent.number(ratio(g))
    if slides:
        return symbols.quantity(g, f"lead{name}")
    (((exponents, sign),),) = (symbols.quantity(1 / g, f"lead{name}").terms,)
    return Laurent.of([(powers((of, -exponent) for of, exponent in exponents), sign)])


def _multiples(G: Array, slides: Sequence[bool], active_slides: Sequence[bool]) -> tuple[tuple[int, ...], ...]:
    """Angles of turning joints as whole multiples of one small angle for each active joint."""
    made = np.zeros(G.shape, dtype=object)
    for k, slide in enumerate(active_slides):
        turning = [j for j in np.flatnonzero(G[:, k]).tolist() if not slides[j]]
        if not turning:
            continue
        unit = abs(G[turning[0], k]) if slide else 1.0
        shares = [ratio(float(G[j, k] / unit)) for j in turning]
        fine = math.lcm(*(share.denominator for share in shares))
        made[turning, k] = [int(share * fine) for share in shares]
    return tuple(tuple(int(x) for x in row) for row in made)


def _rows(device: Device) -> Rows:
    """Rows of measured torque by active joint; where all are measured, mixing them changes no relation."""
    if all(device.measured):
        return None
    chosen = np.linalg.inv(device.frame).T[list(device.measured)]
    return tuple(tuple(ratio(float(x)) for x in row) for row in chosen)


def _used(placed: Sequence[Placement], others: Sequence[Laurent]) -> set[str]:
    """Names of the symbols that the mechanism depends on, an angle's cosine and sine together."""
    found = list(others)
    for placement in placed:
        for step in placement:
            found += [step.length] if isinstance(step, Shift) else [step.cos, step.sin]
    names = {name for polynomial in found for name in polynomial.symbols}
    return names | {f"{word}({name[4:-1]})" for name in names if name[3:4] == "(" for word in ("cos", "sin")}
