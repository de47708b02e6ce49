"""Universal and spherical joints of a device file as revolute joints of massless links.

About u, v and w, which are at right angles where all positions are zero, w the joint's `axis`: joints J_u and J_v, and
for a spherical joint J about w; a universal one ends with J about v. Where v has turned by a right angle, u and w are
one line: there the joints are not determined.
"""

from __future__ import annotations

from typing import Any

from haptid.device.geometry import Reader, least_turn
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import AnyDevice, LoopTable, PlacementJoint
from haptid.device.toml.terms import TermTable


def with_revolute_joints(tables: AnyDevice, reader: Reader, place: Place) -> AnyDevice:
    """The tables with universal and spherical joints as revolute ones, also where loops and terms name them.

    Raises:
        DeviceFileError: such a joint has limits, or an axis without a direction.
    """
    parts: dict[str, list[str]] = {}
    joints: list[Any] = []
    for k, table in enumerate(tables.joints):
        if not isinstance(table, PlacementJoint) or table.type not in ("universal", "spherical"):
            joints.append(table)
            continue
        revolute = _revolute(table, joints[-1].name if joints else "base", reader, place.at(k))
        parts[table.name] = [joint.name for joint in revolute]
        joints += revolute
    if not parts:
        return tables

    def named(names: list[str]) -> list[str]:
        return [part for name in names for part in parts.get(name, [name])]

    # The same pose has two sets of positions, the other one with J_v beyond a quarter turn: all are near zero.
    guessed = {name for loop in tables.loops for name in loop.guess}
    loops: list[LoopTable] = [
        loop.model_copy(
            update={
                "passive": named(loop.passive),
                "guess": loop.guess
                | {part: 0.0 for name in loop.passive for part in parts.get(name, []) if part not in guessed},
            }
        )
        for loop in tables.loops
    ]
    terms: list[TermTable] = [
        term.model_copy(update={"joints": named(term.joints)}) if isinstance(term.joints, list) else term
        for term in tables.terms
    ]
    return tables.model_copy(update={"joints": joints, "loops": loops, "terms": terms})


def _revolute(table: PlacementJoint, before: str, reader: Reader, place: Place) -> list[PlacementJoint]:
    if table.limits != type(table.limits)():
        found = f'the {table.type} joint "{table.name}" has limits, but no single position'
        raise place.at("limits").error(found, f"Leave them out; {table.name}_u and the others have none.")
    given = reader.axis(table, place)
    u, v = least_turn(given)[:3, :2].T
    axes = [u, v] if table.type == "universal" else [u, v, given]
    names = [*(f"{table.name}_{letter}" for letter in "uv"[: len(axes) - 1]), table.name]
    parents = [table.parent or before, *names]
    joints = []
    for k, (name, parent, axis) in enumerate(zip(names, parents, axes, strict=False)):
        update: dict[str, Any] = {"name": name, "parent": parent, "type": "revolute", "axis": axis.tolist()}
        if k:
            update |= {"xyz": [0.0, 0.0, 0.0], "rpy": [0.0, 0.0, 0.0]}
        if k < len(axes) - 1:
            update |= {"body": False, "alias": None}
        joints.append(table.model_copy(update=update))
    return joints
