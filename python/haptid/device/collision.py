"""Collision shapes: convex bodies on links and about the device, read from [[collision]] of device and world files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.geometry import Reader, frame_on
from haptid.device.parts import Frame, Joint
from haptid.device.toml.errors_at import Place, first_error
from haptid.device.toml.schema import AnyShape, BoxTable, HullTable, RoundTable, SphereTable, WorldTable

ShapeKind = Literal["sphere", "capsule", "cylinder", "box", "hull"]


@dataclass(frozen=True, eq=False)
class CollisionShape:
    """A convex shape fixed to a link.

    Attributes:
        name: in reports.
        kind: of shape.
        frame: its own frame on the link; link -1 is the base.
        size: sphere: radius; capsule, cylinder: radius and half the length along z; box: half of each edge, m.
        points: vertices of a hull in its own frame, (k, 3), m; none of other kinds.
        ignore: links whose shapes it may touch.
        world: whether it is of a world file.
    """

    name: str
    kind: ShapeKind
    frame: Frame
    size: tuple[float, ...]
    points: Array
    ignore: tuple[int, ...] = ()
    world: bool = False

    def __post_init__(self) -> None:
        freeze_fields(self, points=(None, 3))

    @property
    def link(self) -> int:
        """Index of its link, -1 for the base."""
        return self.frame.link

    @property
    def radius(self) -> float:
        """Of the ball about the origin of its frame that holds it, m."""
        if self.kind == "hull":
            return float(np.linalg.norm(self.points, axis=1).max())
        if self.kind == "capsule":
            return self.size[0] + self.size[1]
        return float(np.linalg.norm(self.size))


def read_shapes(
    tables: Sequence[AnyShape], joints: Sequence[Joint], base: Array, reader: Reader, place: Place, world: bool = False
) -> tuple[CollisionShape, ...]:
    """The shapes of [[collision]].

    Raises:
        DeviceFileError: a link does not exist, a size is not above zero, or points are in one plane.
    """
    return tuple(_shape(table, k, joints, base, reader, place.at(k), world) for k, table in enumerate(tables))


def _shape(
    table: AnyShape, k: int, joints: Sequence[Joint], base: Array, reader: Reader, place: Place, world: bool
) -> CollisionShape:
    links = {"base": -1} | {joint.name: i for i, joint in enumerate(joints)}
    named = [(table.link, place.at("link")), *((x, place.at("ignore", i)) for i, x in enumerate(table.ignore))]
    for name, at in named:
        if name not in links:
            raise at.unknown("link", name, links)
    frame = frame_on(joints, links[table.link], reader.placement(table, place), base)
    label = table.name or f"{table.kind} {k + 1} of {'the world' if world else table.link}"
    points, size = np.zeros((0, 3)), _size(table, reader, place)
    if isinstance(table, HullTable):
        given = [reader.triple(point, place.at("points", i)) for i, point in enumerate(table.points)]
        points = _vertices(np.array(given), place.at("points"))
    ignore = tuple(links[name] for name in table.ignore)
    return CollisionShape(label, table.kind, frame, size, points, ignore, world)


def _size(table: AnyShape, reader: Reader, place: Place) -> tuple[float, ...]:
    if isinstance(table, SphereTable):
        return (reader.positive(table.radius, place.at("radius")),)
    if isinstance(table, RoundTable):
        length = reader.positive(table.length, place.at("length"))
        return reader.positive(table.radius, place.at("radius")), length / 2
    if isinstance(table, BoxTable):
        return tuple(reader.positive(x, place.at("size", i)) / 2 for i, x in enumerate(table.size))
    return ()


def _vertices(points: Array, place: Place) -> Array:
    """The points that are vertices of the hull of all."""
    from scipy.spatial import ConvexHull, QhullError  # a fifth of what `identify` loads, and few devices have meshes

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        raise place.error(
            f"the hull of these {len(points)} points has no volume", "Give at least four points that are in no plane."
        ) from None


def read_world(path: str | Path) -> tuple[CollisionShape, ...]:
    """The shapes of a world file (TOML): what stands about a device, in its base frame.

    Raises:
        DeviceFileError: file, key, what was found and what to write instead.
    """
    from haptid.device.toml.reader import file_values  # the reader of devices imports this module

    file, data = file_values(path)
    return world_of(data, file)


def world_of(data: dict[str, Any], file: str) -> tuple[CollisionShape, ...]:
    """The shapes of the data of a world file; `file` is its name in errors."""
    place = Place(file)
    try:
        table = WorldTable.model_validate(data)
    except ValidationError as error:
        raise first_error(error, file, data, WorldTable) from None
    lengths: dict[str, float] = {}
    for name, value in table.lengths.items():
        lengths[name] = Reader(lengths).number(value, place.at("lengths", name))
    for k, one in enumerate(table.collision):
        if one.link != "base":
            advice = 'Leave out the link, or write "base": shapes on links are in the device file.'
            raise place.at("collision", k, "link").error(f'found "{one.link}"', advice)
    return read_shapes(table.collision, (), np.eye(4), Reader(lengths), place.at("collision"), world=True)
