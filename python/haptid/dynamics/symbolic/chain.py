"""A mechanism with its lengths as symbols: tree, cuts, motion, gravity, terms and measured rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Closure, Device
from haptid.device.toml.schema import AnyDevice
from haptid.dynamics.symbolic.laurent import Laurent, powers
from haptid.dynamics.symbolic.motion import LinearMotion, Motion
from haptid.dynamics.symbolic.placements import Placement, Shift
from haptid.dynamics.symbolic.reading import GeometryReader, placements
from haptid.dynamics.symbolic.symbols import GRAVITY, Symbol, Symbols, ratio
from haptid.dynamics.symbolic.terms import ExactColumn, exact_columns
from haptid.dynamics.symbolic.tree import ExactCut, ExactFrame, ExactJoint
from haptid.errors import ManyAnglesError

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
    chosen = np.linalg.inv(device.row_map).T[list(device.measured)]
    return tuple(tuple(ratio(float(x)) for x in row) for row in chosen)


def _used(placed: Sequence[Placement], others: Sequence[Laurent]) -> set[str]:
    """Names of the symbols that the mechanism depends on, an angle's cosine and sine together."""
    found = list(others)
    for placement in placed:
        for step in placement:
            found += [step.length] if isinstance(step, Shift) else [step.cos, step.sin]
    names = {name for polynomial in found for name in polynomial.symbols}
    return names | {f"{word}({name[4:-1]})" for name in names if name[3:4] == "(" for word in ("cos", "sin")}
