"""Regroupings of devices whose loops are not linear: planar dyads, such as four-bar and five-bar linkages."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

from haptid.device import Device
from haptid.device.reading import device_of
from haptid.device.schema import AnyDevice
from haptid.device.tables import read_tables
from haptid.errors import NoDyadError
from haptid.exact.chain import ExactChain, Rows, assembled
from haptid.exact.dyad import DyadMotion, dyads
from haptid.exact.motion import Motion
from haptid.exact.regrouping import Regroupings, chain_regroupings
from haptid.exact.symbols import Symbols
from haptid.exact.tree import ExactCut, ExactJoint


def loop_regroupings(path: str | Path, seed: int = 0) -> Regroupings:
    """Base parameters, with the lengths as symbols, of a device whose loops are planar dyads.

    Two passive joints and a pin close each loop; the other joints are active, and have motors, unless the file names
    motors for some of them only. `read_device` does not read such loops yet, so that there are no numbers to compare
    with. A loop that closes in two ways is taken in both: the relations hold in either.

    Args:
        path: of the device file.
        seed: of what is drawn at random; the result does not depend on it.

    Raises:
        DeviceError: in one of its kinds, what is wrong with the file.
        NoDyadError: a loop is no planar dyad.
        SymbolicClosureError: the links of a loop are not in one plane.
        RegroupingFormError: a coefficient is no ratio of polynomials of low degree.
    """
    tables, file = read_tables(path)
    if any(loop.relations for loop in tables.loops):
        raise NoDyadError(file, "a loop has relations")
    passive = {name for loop in tables.loops for name in loop.passive}
    tree = device_of(_opened(tables, passive), file)
    return chain_regroupings(tree, _closed(tree, tables, passive, file, seed), seed)


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
