"""A device file's geometry once more, with its lengths as symbols: the same frames as the numbers, unrounded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from haptid.device.expressions import number, sum_of_names
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import (
    AnyDevice,
    AnyJoint,
    BaseTable,
    FrameTable,
    ModifiedDHJoint,
    PlacementJoint,
    StandardDHJoint,
)
from haptid.dynamics.symbolic.laurent import Laurent
from haptid.dynamics.symbolic.placements import Placement, Shift, Turn, inverse, least_turn
from haptid.dynamics.symbolic.symbols import LENGTH, Symbols, ratio

X, Y, Z = 0, 1, 2
# Where a checked file's numbers are read again, nothing is left to complain about.
CHECKED = Place("")


class GeometryReader:
    """Placements of one file, every length in them a sum of symbols.

    A length that is written as a sum of named lengths stays one. Any other number becomes a symbol, named after the key
    and joint where it stands; numbers of the same size share one.
    """

    def __init__(self, lengths: Mapping[str, float | str], values: Mapping[str, float], symbols: Symbols) -> None:
        self._values = values
        self._symbols = symbols
        self._lengths: dict[str, Laurent] = {}
        for name, written in lengths.items():
            if isinstance(written, str) and (found := sum_of_names(written, self._lengths)) and found.factors:
                self._lengths[name] = self.length(written, name)
            else:
                self._lengths[name] = symbols.named(name, values[name], LENGTH)

    def length(self, written: float | str, name: str) -> Laurent:
        """A length, its own symbol called `name` where it needs one."""
        known = sum_of_names(written, self._lengths) if isinstance(written, str) else None
        if known is None or not known.factors:
            size = number(written, self._values, CHECKED)
            return self._symbols.quantity(size, name) if size else Laurent()
        made = self._symbols.quantity(known.constant, f"{name}_0") if known.constant else Laurent()
        for of, factor in known.factors.items():
            made = made + self._lengths[of].times(ratio(factor))
        return made

    def turn(self, axis: int, written: float | str, name: str) -> Placement:
        """A turn by an angle, none where it is zero."""
        angle = number(written, self._values, CHECKED)
        return (Turn(axis, *self._symbols.turn(angle, name)),) if angle else ()

    def shift(self, axis: int, written: float | str, name: str) -> Placement:
        """A shift by a length, none where it is zero."""
        made = self.length(written, name)
        return (Shift(axis, made),) if made.terms else ()

    def modified(self, given: Mapping[str, Any], of: str) -> Placement:
        """Rz(gamma) Tz(b) Rx(alpha) Tx(d) Rz(theta) Tz(r), absent ones zero."""
        steps = (
            (self.turn, Z, "gamma"),
            (self.shift, Z, "b"),
            (self.turn, X, "alpha"),
            (self.shift, X, "d"),
            (self.turn, Z, "theta"),
            (self.shift, Z, "r"),
        )
        return tuple(step for make, axis, key in steps for step in make(axis, given.get(key) or 0.0, f"{key}{of}"))

    def placed(self, xyz: Sequence[float | str], rpy: Sequence[float | str], of: str) -> Placement:
        """A shift, then yaw, pitch and roll about the axes that they turn."""
        shifts = [self.shift(axis, value, f"{'xyz'[axis]}{of}") for axis, value in enumerate(xyz)]
        names = ("roll", "pitch", "yaw")
        turns = [self.turn(axis, rpy[axis], f"{names[axis]}{of}") for axis in (Z, Y, X)]
        return tuple(step for part in (*shifts, *turns) for step in part)

    def base(self, table: BaseTable) -> Placement:
        """The placement of the first frame."""
        return self.placed(table.xyz, table.rpy, "0")

    def frame(self, table: FrameTable, of: str) -> Placement:
        """A frame on a link, given either way."""
        if table.xyz is None and table.rpy is None:
            return self.modified(table.model_dump(), of)
        zero = (0.0, 0.0, 0.0)
        return self.placed(table.xyz or zero, table.rpy or zero, of)

    def joint(self, table: AnyJoint) -> tuple[Placement, Placement]:
        """Placement of a joint's frame in its parent's convention frame, and that convention in it."""
        of = table.name
        if isinstance(table, ModifiedDHJoint):
            return self.modified(table.model_dump(), of), ()
        if isinstance(table, StandardDHJoint):
            before = (*self.turn(Z, table.theta, f"theta{of}"), *self.shift(Z, table.d, f"d{of}"))
            return before, (*self.shift(X, table.a, f"a{of}"), *self.turn(X, table.alpha, f"alpha{of}"))
        onto = self._onto(table)
        return (*self.placed(table.xyz, table.rpy, of), *onto), inverse(onto)

    def _onto(self, table: PlacementJoint) -> Placement:
        axis = np.array([number(value, self._values, CHECKED) for value in table.axis])
        x, y, z = (float(part) for part in axis / np.linalg.norm(axis))
        names = ("", f"tilt{table.name}", f"heading{table.name}")
        return tuple(step for at, angle in least_turn((x, y, z)) for step in self.turn(at, angle, names[at]))


def placements(
    tables: AnyDevice, parents: Sequence[int], reader: GeometryReader
) -> tuple[list[Placement], list[Placement]]:
    """Placement of every joint in its parent's normal form, and the convention frame of every link in its own."""
    base = reader.base(tables.base)
    joints: Sequence[AnyJoint] = tables.joints
    made: list[Placement] = []
    frames: list[Placement] = []
    for table, parent in zip(joints, parents, strict=True):
        placement, frame = reader.joint(table)
        made.append((*(base if parent < 0 else frames[parent]), *placement))
        frames.append(frame)
    return made, frames
