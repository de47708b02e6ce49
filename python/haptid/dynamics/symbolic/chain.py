"""Mechanisms with symbolic lengths: joint motion modulo a prime, columns in addition to link inertia, and the chain."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence, Set
from fractions import Fraction
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import Closure, Counterbalance, Device, TermColumn
from haptid.device.toml.schema import AnyDevice
from haptid.dynamics.symbolic.arithmetic import ZERO, Laurent, Points, PrimeField, Residues, powers
from haptid.dynamics.symbolic.geometry import (
    GeometryReader,
    Placement,
    SymbolicCut,
    SymbolicFrame,
    SymbolicJoint,
    Translation,
    placements,
)
from haptid.dynamics.symbolic.symbols import DIMENSIONLESS, GRAVITY, LENGTH, Symbol, Symbols, ratio
from haptid.errors import RegroupingError


@dataclass(frozen=True, eq=False)
class States:
    """Joint states drawn at random, all residues.

    The position of a turning joint is drawn independently of its cosine and sine: no polynomial relates them.

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


class SymbolicMotion(Protocol):
    """Protocol of joint motion in a closed chain; each kind of loop is one implementation."""

    @property
    def depends(self) -> tuple[Laurent, ...]:
        """Polynomials that it depends on, in addition to the placements of joints and cut frames."""

    def states(self, rng: np.random.Generator, points: Points) -> States:
        """Random states, one for each set of lengths."""


@dataclass(frozen=True)
class _LinearMotion:
    """Joint positions linear in the active ones': q = G qa + offset.

    Attributes:
        prismatic: of every joint.
        rates: G, by joint and active joint.
        multiples: angle of a turning joint in integer units of each active joint's, by joint and active joint.
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
        """See SymbolicMotion."""
        return (*self.offsets, *(part for row in (*self.rates, *self.turns) for part in row))

    def states(self, rng: np.random.Generator, points: Points) -> States:
        """See SymbolicMotion."""
        field, count, actives = points.field, points.count, len(self.rates[0])
        active = field.draw(rng, 3, actives, count)
        G: Residues = np.zeros((len(self.rates), actives, count), dtype=np.int64)
        for j, row in enumerate(self.rates):
            for k, entry in enumerate(row):
                if entry.terms:
                    G[j, k] = entry.modulo(points)
        moved = np.zeros((3, len(self.rates), count), dtype=np.int64)
        for k in range(actives):  # one product at a time: a longer sum could overflow
            moved = field.reduce(moved + G[:, k] * active[:, None, k])
        offsets: Residues = np.array([offset.modulo(points) for offset in self.offsets])
        position = field.reduce(moved[0] + offsets)
        cos, sin = self._angles(rng, points)
        slide = np.where(np.array(self.prismatic)[:, None], position, 0)
        return States(cos, sin, slide, position, moved[1], moved[2], np.moveaxis(G, 1, 2), active)

    def _angles(self, rng: np.random.Generator, points: Points) -> tuple[Residues, Residues]:
        field = points.field
        units = [field.circle(rng, points.count) for _ in self.rates[0]]
        cos = np.ones((len(self.rates), points.count), dtype=np.int64)
        sin = np.zeros_like(cos)
        for j, (multiples, prismatic) in enumerate(zip(self.multiples, self.prismatic, strict=True)):
            if prismatic:
                continue
            angle = (self.turns[j][0].modulo(points), self.turns[j][1].modulo(points))
            for unit, times in zip(units, multiples, strict=True):
                if times:
                    angle = field.sum_of_angles(angle, field.multiple_of_angle(unit, times))
            cos[j], sin[j] = angle
        return cos, sin


# Rates of a coordinate by active joint, (n, active), and its position, velocity and acceleration.
Coordinate = tuple[Residues, tuple[Residues, ...]]
# Index of each of these among a coordinate's position, velocity and acceleration.
_MOTION = {"position": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True)
class ColumnPart:
    """One summand of a column: a factor times a quantity of the motion.

    Attributes:
        factor: number.
        what: position, velocity, acceleration, one.
        key: identifies a function that multiplies it; functions with the same key are equal, others independent. None
            for none.
    """

    factor: Fraction
    what: str
    key: Hashable = None


@dataclass(frozen=True)
class SymbolicColumn:
    """A column in addition to link inertia, on a joint, or on a cut's or motor's combination of joints.

    Attributes:
        joint: index, None for a cut or a motor.
        weights: of a cut or a motor, one for each active joint; none for a motor that drives passive joints.
        row: of such a motor, a factor for each joint.
        parts: summands of the column at one of its coordinate's states.
        rest: subtracted from the position.
    """

    joint: int | None
    weights: tuple[Fraction, ...]
    parts: tuple[ColumnPart, ...]
    rest: Laurent = ZERO
    row: tuple[Fraction, ...] = ()
    place: int = 0

    def modulo(self, coordinate: Coordinate, points: Points, functions: Mapping[Hashable, Residues]) -> Residues:
        """Residues of the active joints' torques, (n, active)."""
        field, (G, motion) = points.field, coordinate
        total: Residues = np.zeros(points.count, dtype=field.dtype)
        for part in self.parts:
            size = np.ones_like(total) if part.what == "one" else motion[_MOTION[part.what]]
            if part.what == "position" and self.rest.terms:
                size = field.reduce(size - self.rest.modulo(points))
            if part.key is not None:
                size = field.reduce(size * functions[part.key])
            total = field.reduce(total + (size if part.factor == 1 else field.of(part.factor) * size))
        return field.reduce(G * total[:, None])

    def coordinate(self, field: PrimeField, states: States) -> Coordinate:
        """Rates of the coordinate by active joint, (n, active), and its position, velocity and acceleration."""
        if self.joint is not None:
            motion = (states.position, states.velocity, states.acceleration)
            return states.G[self.joint], tuple(quantity[self.joint] for quantity in motion)
        if self.row:
            used = [(j, field.of(factor)) for j, factor in enumerate(self.row) if factor]

            def mixed(x: Residues) -> Residues:
                terms = np.array([field.reduce(x[j] * factor) for j, factor in used])
                return field.reduce(terms.sum(axis=0))  # a sum of few stays small

            return mixed(states.G), tuple(mixed(x) for x in (states.position, states.velocity, states.acceleration))
        weights = np.array([field.of(weight) for weight in self.weights])
        G = np.broadcast_to(weights, (states.active.shape[2], len(weights)))
        moved = field.reduce(field.reduce(states.active * weights[:, None]).sum(axis=1))  # a sum of few stays small
        return G, tuple(moved)


def symbolic_columns(device: Device, active: Sequence[int], symbols: Symbols) -> tuple[SymbolicColumn, ...]:
    """Columns of all terms of a device, those of cuts and motors with respect to these active joints."""
    names = device.joint_names
    columns: list[SymbolicColumn] = []
    places: dict[Hashable, int] = {}
    for term in device.terms:
        side, _, name = term.on.partition(" ")
        joint = names.index(name) if side == "joint" else None
        parts, rest = _parts(term), _rest(term, device, symbols)
        drive = next((d.row for d in device.drives if side == "motor" and d.name == name), np.zeros(len(names)))
        weights: tuple[Fraction, ...] = ()
        row: tuple[Fraction, ...] = ()
        if np.delete(drive, [device.active[k] for k in active]).any():
            joint, row = None, tuple(ratio(float(x)) for x in drive)
        elif joint is None:
            weights = tuple(ratio(float(w)) for w in (term.weights @ device.row_map)[list(active)])
        place = places.setdefault((joint, weights, row), len(places))
        columns.append(SymbolicColumn(joint, weights, parts, rest, row, place))
    return tuple(columns)


def _rest(term: TermColumn, device: Device, symbols: Symbols) -> Laurent:
    """Rest position of a spring; on a cut, relative to the zero of its combination of active joints."""
    if term.kind != "spring":
        return Laurent()
    side, _, name = term.on.partition(" ")
    sliding = {f"joint {j.name}" for j in device.joints if j.prismatic}
    sliding |= {f"cut {cut.name}" for cut in device.cut_joints if cut.prismatic}
    slides, rest = term.on in sliding, term.settings[0]
    offset = symbols.quantity(rest, f"rest{name}", LENGTH if slides else DIMENSIONLESS) if rest else Laurent()
    return offset - symbols.position(term.offset, slides, f"q{name}") if side in ("cut", "coordinate") else offset


def _parts(term: TermColumn) -> tuple[ColumnPart, ...]:
    """The summands of a term; friction is distinguished by direction of motion, sign and smoothing width."""
    plain = {"rotor": "acceleration", "viscous": "velocity", "offset": "one", "spring": "position"}
    if term.kind in plain:
        return (ColumnPart(Fraction(1), plain[term.kind]),)
    if term.kind == "external" and not term.side:
        shape = term.shape
        key = shape if isinstance(shape, Counterbalance) else getattr(shape, "text", "")
        return (ColumnPart(Fraction(1), "one", key),)
    if not term.weights.any():  # its coordinate never moves
        return ()
    first = float(term.weights[np.flatnonzero(term.weights)[0]])
    direction = tuple(np.round(term.weights / first, 9).tolist())
    sign, scale = Fraction(1 if first > 0 else -1), abs(first)
    if term.kind == "stribeck":
        velocity, exponent, width = term.settings
        return (ColumnPart(sign, "one", ("stribeck", direction, velocity / scale, exponent, width / scale)),)
    width = term.settings[0] / scale
    odd, half = ("coulomb", direction, width), Fraction(term.side, 2)
    if term.kind == "coulomb":
        return (ColumnPart(sign, "one", odd),)
    if term.nature == "viscous":
        # max(v, 0) = (v + v sgn v) / 2 and min(v, 0) = (v - v sgn v) / 2.
        return (ColumnPart(Fraction(1, 2), "velocity"), ColumnPart(sign * half, "velocity", odd))
    # sgn max(v, 0) = (|sgn v| + sgn v) / 2, sgn min(v, 0) = (sgn v - |sgn v|) / 2, and |sgn v| is one except at rest.
    even = ColumnPart(half, "one", ("even", direction, width) if width else None)
    return (ColumnPart(sign / 2, "one", odd), even)


# Coefficients are polynomials in the cosines and sines of angles that are no quarter turns: with more angles than these
# they have too many terms to be interpolated, or to be read.
_MOST_ANGLES = 4
# Measured torques as combinations of the active joints', None for all of them.
SymbolicRows = tuple[tuple[Fraction, ...], ...] | None


@dataclass(frozen=True)
class SymbolicChain:
    """A tree or closed chain with symbolic lengths.

    Attributes:
        joints: parents before children.
        cuts: joints cut to leave a tree.
        motion: of all joints, from the active ones.
        gravity: in the base frame, by component.
        columns: in addition to link inertia.
        torques: number of measured ones.
        rows: measured torques, each a combination of the active joints'; None where all are measured.
        symbols: those that the mechanism depends on.
        opened: cuts that the motion does not close.
        beyond: symbols that only these depend on.
    """

    joints: tuple[SymbolicJoint, ...]
    cuts: tuple[SymbolicCut, ...]
    motion: SymbolicMotion
    gravity: tuple[Laurent, ...]
    columns: tuple[SymbolicColumn, ...]
    torques: int
    rows: SymbolicRows
    symbols: tuple[Symbol, ...]
    opened: tuple[SymbolicCut, ...] = ()
    beyond: tuple[Symbol, ...] = ()


def symbolic_chain(device: Device) -> SymbolicChain:
    """The mechanism of a device whose loops are linear, with symbolic lengths, from its file."""

    def linear(_: tuple[SymbolicJoint, ...], __: tuple[SymbolicCut, ...], symbols: Symbols) -> SymbolicMotion:
        return linear_motion(device, symbols)

    return assembled(device, device.tables, range(len(device.active)), known_rows(device), linear)


def assembled(
    device: Device,
    tables: AnyDevice,
    active: Sequence[int],
    rows: SymbolicRows,
    motion_of: Callable[[tuple[SymbolicJoint, ...], tuple[SymbolicCut, ...], Symbols], SymbolicMotion],
    opened: Set[str] = frozenset(),
) -> SymbolicChain:
    """A mechanism from its parts.

    Args:
        device: its joints, gravity and terms.
        tables: its geometry and cuts, as written.
        active: which of the device's active joints are active in its motion.
        rows: see SymbolicChain.
        motion_of: makes the motion of joints and cuts.
        opened: passive joints whose loops are opened.

    Raises:
        RegroupingError: more than MOST_ANGLES angles are no quarter turns.
    """
    symbols = Symbols()
    reader = GeometryReader(tables.lengths, device.lengths, symbols)
    placed, frames = placements(tables, [joint.parent for joint in device.joints[: len(tables.joints)]], reader)
    placed += [()] * (len(device.joints) - len(placed))  # rotors of elastic motors
    joints = tuple(
        SymbolicJoint(joint.parent, joint.prismatic, placement)
        for joint, placement in zip(device.joints, placed, strict=True)
    )
    is_open = [not opened.isdisjoint(loop.passive) for loop in tables.loops if loop.cut]
    every = list(zip(_cuts(tables, device.joint_names, frames, reader), is_open, strict=True))
    cuts, left = (tuple(cut for cut, open_ in every if open_ is wanted) for wanted in (False, True))
    gravity = _gravity(device.gravity, symbols)
    motion = motion_of(joints, cuts, symbols)
    columns = symbolic_columns(device, active, symbols)
    steps = [*placed, *_frames(cuts)]
    used = _used(steps, (*gravity, *motion.depends, *(column.rest for column in columns)))
    known = tuple(symbol for symbol in symbols.all if symbol.name in used)
    others = _used(_frames(left), ()) - used
    angles = {symbol.angle for symbol in known if symbol.angle}
    if len(angles) > _MOST_ANGLES:
        raise RegroupingError(
            f"the geometry has {len(angles)} angles that are no multiples of a quarter turn, limit {_MOST_ANGLES}: "
            "symbolic groupings would have too many terms.",
            found=len(angles),
            limit=_MOST_ANGLES,
            advice=(
                "Use the numeric groupings of `base_parameters`; write angles that are rounded quarter turns "
                'as such: "pi/2", not 1.5708.'
            ),
        )
    torques, beyond = len(active) if rows is None else len(rows), [s for s in symbols.all if s.name in others]
    return SymbolicChain(joints, cuts, motion, gravity, columns, torques, rows, known, left, tuple(beyond))


def _frames(cuts: Sequence[SymbolicCut]) -> list[Placement]:
    """Placements of the cuts' frames on their links."""
    return [frame.placement for cut in cuts for frame in (cut.frame_a, cut.frame_b)]


def _cuts(
    tables: AnyDevice, names: Sequence[str], frames: Sequence[Placement], reader: GeometryReader
) -> tuple[SymbolicCut, ...]:
    base = reader.base(tables.base)
    index = {"base": -1, **{name: k for k, name in enumerate(names)}}
    cuts = []
    for k, cut in enumerate((loop.cut for loop in tables.loops if loop.cut), 1):
        both = []
        for body, table, side in ((cut.body_a, cut.frame_a, "a"), (cut.body_b, cut.frame_b, "b")):
            link = index[body]
            local = reader.frame(table, f"cut{k}{side}")
            both.append(SymbolicFrame(link, (*(base if link < 0 else frames[link]), *local)))
        cuts.append(SymbolicCut(cut.type, *both))
    return tuple(cuts)


def _gravity(gravity: Array, symbols: Symbols) -> tuple[Laurent, ...]:
    """One symbol g for gravity along an axis, otherwise one for each component."""
    along_axis = np.count_nonzero(gravity) == 1
    components = []
    for axis, part in zip("xyz", gravity.tolist(), strict=True):
        size = symbols.named("g" if along_axis else f"g{axis}", abs(part), GRAVITY)
        components.append(size if part > 0 else -size)
    return tuple(components)


def linear_motion(device: Device, symbols: Symbols) -> _LinearMotion:
    """The motion of a device's joints: every number in it a ratio of integers, or a symbol."""
    closure, slides = device.closure, [joint.prismatic for joint in device.joints]
    assert isinstance(closure, Closure)
    rates, turns, offsets = [], [], []
    for j, joint in enumerate(device.joints):
        rates.append(
            tuple(
                _rate(g, slides[j], slides[k], joint.name, symbols) if g else ZERO
                for g, k in zip(closure.G[j].tolist(), device.active, strict=True)
            )
        )
        offset = float(closure.offset[j])
        turns.append(symbols.turn(0.0 if slides[j] else offset, f"q{joint.name}"))
        offsets.append(symbols.position(offset, slides[j], f"q{joint.name}"))
    multiples = _multiples(closure.G, slides, [slides[k] for k in device.active])
    return _LinearMotion(tuple(slides), tuple(rates), multiples, tuple(turns), tuple(offsets))


def _rate(g: float, slides: bool, active_slides: bool, name: str, symbols: Symbols) -> Laurent:
    """Rate of a joint that an active one moves: a number, a length, or the inverse of a length."""
    if slides == active_slides:
        return Laurent.number(ratio(g))
    if slides:
        return symbols.quantity(g, f"lead{name}")
    (((exponents, sign),),) = (symbols.quantity(1 / g, f"lead{name}").terms,)
    return Laurent.of([(powers((symbol, -exponent) for symbol, exponent in exponents), sign)])


def _multiples(G: Array, slides: Sequence[bool], active_slides: Sequence[bool]) -> tuple[tuple[int, ...], ...]:
    """Angles of turning joints as integer multiples of one small angle for each active joint."""
    multiples = np.zeros(G.shape, dtype=object)
    for k, slide in enumerate(active_slides):
        turning = [j for j in np.flatnonzero(G[:, k]).tolist() if not slides[j]]
        if not turning:
            continue
        unit = abs(G[turning[0], k]) if slide else 1.0
        shares = [ratio(float(G[j, k] / unit)) for j in turning]
        fine = math.lcm(*(share.denominator for share in shares))
        multiples[turning, k] = [int(share * fine) for share in shares]
    return tuple(tuple(int(x) for x in row) for row in multiples)


def known_rows(device: Device) -> SymbolicRows:
    """Rows of known torque by active joint; None where all are known, since mixing them changes no relation."""
    if all(device.known):
        return None
    chosen = np.linalg.inv(device.row_map).T[list(device.known)]
    return tuple(tuple(ratio(float(x)) for x in row) for row in chosen)


def _used(placed: Sequence[Placement], others: Sequence[Laurent]) -> set[str]:
    """Names of the symbols that the mechanism depends on, always both cosine and sine of an angle."""
    used = list(others)
    for placement in placed:
        for step in placement:
            used += [step.length] if isinstance(step, Translation) else [step.cos, step.sin]
    names = {name for polynomial in used for name in polynomial.symbols}
    return names | {f"{word}({name[4:-1]})" for name in names if name[3:4] == "(" for word in ("cos", "sin")}
