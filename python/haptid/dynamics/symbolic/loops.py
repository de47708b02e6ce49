"""Regroupings of devices whose loops are not linear: planar dyads, such as four-bar and five-bar linkages."""

from __future__ import annotations

from pathlib import Path

from haptid.device.toml.reader import read_tables
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.symbolic.opening import dyad_chain, opened
from haptid.dynamics.symbolic.regrouping import Regroupings, chain_regroupings


def loop_regroupings(path: str | Path, seed: int = 0) -> Regroupings:
    """Base parameters, with the lengths as symbols, of a device whose loops are planar dyads.

    Two passive joints and a pin close each loop; the other joints are active, and have motors, unless the file names
    motors for some of them only. Neither guess nor start pose is needed, and nothing is compared with numbers, which
    `regroupings` does. A loop that closes in two ways is taken in both: the relations hold in either.

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
    tree = opened(tables, file)
    return chain_regroupings(DynamicModel(tree), dyad_chain(tree, tables, file, seed), seed)
