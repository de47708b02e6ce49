"""A device opened at its cuts, and its loops closed again by planar dyads, with symbols for its lengths."""

from __future__ import annotations

from fractions import Fraction

from haptid.device import Device
from haptid.device.toml.reader import device_of
from haptid.device.toml.schema import AnyDevice
from haptid.dynamics.symbolic.chain import ExactChain, Rows, assembled
from haptid.dynamics.symbolic.dyad import DyadMotion, dyads
from haptid.dynamics.symbolic.motion import Motion
from haptid.dynamics.symbolic.symbols import Symbols
from haptid.dynamics.symbolic.tree import ExactCut, ExactJoint
from haptid.errors import NoDyadError


def opened(tables: AnyDevice, file: str) -> Device:
    """The tree of a device, its loops left open.

    Raises:
        DeviceError: in one of its kinds, what is wrong with the file.
        NoDyadError: a loop has relations, or terms may act on its cut.
    """
    if any(loop.relations for loop in tables.loops):
        raise NoDyadError(file, "a loop has relations")
    if named := [loop.cut.name for loop in tables.loops if loop.cut and loop.cut.name]:
        raise NoDyadError(file, f"cut joint {named[0]} has a name, so that terms may act on it")
    return device_of(_opened(tables, _passive(tables)), file)


def dyad_chain(tree: Device, tables: AnyDevice, file: str, seed: int) -> ExactChain:
    """The tree's mechanism with its loops closed.

    Args:
        tree: see `opened`.
        tables: of the device.
        file: its name for errors.
        seed: of what is drawn at random; the result does not depend on it.

    Raises:
        NoDyadError: a loop is no planar dyad.
    """
    return _closed(tree, tables, _passive(tables), file, seed)


def _passive(tables: AnyDevice) -> set[str]:
    return {name for loop in tables.loops for name in loop.passive}


def _opened(tables: AnyDevice, passive: set[str]) -> AnyDevice:
    """The tables of the tree: no loops, and terms on active joints by their names."""
    active = [joint.name for joint in tables.joints if joint.name not in passive]
    driven = {name for motor in tables.motors for name in motor.drives or {motor.name: 1.0}}
    words = {"active": active, "motorised": [name for name in active if name in driven or not tables.motors]}
    terms = [
        term.model_copy(update={"joints": words[term.joints]}) if term.joints in ("active", "motorised") else term
        for term in tables.terms
    ]
    joints = [joint.model_copy(update={"active": None}) for joint in tables.joints]
    return tables.model_copy(update={"loops": [], "terms": terms, "joints": joints})


def _closed(tree: Device, tables: AnyDevice, passive: set[str], file: str, seed: int) -> ExactChain:
    """The mechanism: the tree's joints, with the loops' cuts."""
    active = tuple(j for j, name in enumerate(tree.joint_names) if name not in passive)

    def motion(joints: tuple[ExactJoint, ...], cuts: tuple[ExactCut, ...], symbols: Symbols) -> Motion:
        found = dyads(joints, cuts, [j for j in range(len(joints)) if j not in active])
        if isinstance(found, str):
            raise NoDyadError(file, found)
        made = DyadMotion(joints, active, found)
        if not made.is_planar(symbols.all, seed):
            raise NoDyadError(file, "the axes of a loop's two passive joints are not parallel")
        return made

    return assembled(tree, tables, active, _rows(tree, active, bool(tables.motors)), motion)


def _rows(tree: Device, active: tuple[int, ...], motors: bool) -> Rows:
    """The torques of active joints that motors drive alone or together; all where the file names no motors."""
    if not motors:
        return None
    driven = [any(drive.motorised and drive.row[j] for drive in tree.drives) for j in active]
    if all(driven):
        return None
    chosen = [k for k, known in enumerate(driven) if known]
    return tuple(tuple(Fraction(int(i == k)) for i in range(len(active))) for k in chosen)
