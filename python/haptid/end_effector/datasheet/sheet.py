"""`data_sheet`: the figures of a device over its workspace, each with range, interval and method.

Terms are those of Hayward and Astley (1996), Performance measures for haptic interfaces, Robotics Research: The 7th
International Symposium, 195-207, and Samur (2012), Performance Metrics for Haptic Interfaces, Springer: degrees of
freedom, motion range, peak and continuous force, back-drive friction, inertia, resolution, dynamic range, Z-width.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid._internal.late import dataclass
from haptid.device.elastic import without_torsion
from haptid.dynamics.counterparts import with_stiff_springs, without_sensors
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.workspace import Workspace
from haptid.end_effector.characterisation.apparent_mass import apparent_mass
from haptid.end_effector.characterisation.model import IdentifiedModel, on_counterpart
from haptid.end_effector.datasheet.dynamics import Dynamics
from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.datasheet.rows import SheetRow, over
from haptid.end_effector.datasheet.structure import structural_frequency
from haptid.end_effector.datasheet.z_rows import handle_steps
from haptid.errors import index_of
from haptid.uncertainty.quantities import Field

# Cells of the grid over the workspace.
_POSES = 1000
# Cells of the grid of the handle's positions, in multiples of that.
_POSITIONS = 8
# f T at which sin(pi f T) / (pi f T) is the square root of a half.
_HALF_POWER = 0.442946
_STRUCTURE = SheetRow(
    "Structure", "structural frequency", None, "Hz", "the model is rigid: elasticity is not identified"
)


@dataclass(frozen=True, eq=False)
class DataSheet:
    """The figures of one device.

    Attributes:
        model: the device.
        rows: in order of their groups.
        published: names, values and sources that the device file states, as texts.
        poses: of the active joints, over the workspace, (active, poses).
        positions: of the handle over a finer grid, (positions, 3), m.
        middle: index of the pose in the middle.
    """

    model: DynamicModel
    rows: tuple[SheetRow, ...]
    published: tuple[tuple[str, str, str], ...]
    poses: Array
    positions: Array
    middle: int

    def __getitem__(self, name: str) -> SheetRow:
        """The row of this name; an `UnknownNameError` where there is none."""
        return self.rows[index_of(name, [row.name for row in self.rows], "figure of the data sheet")]


def data_sheet(
    known: IdentifiedModel | DynamicModel,
    where: Workspace,
    instruments: DeviceInstruments | None = None,
    poses: int = _POSES,
) -> DataSheet:
    """The data sheet of a device.

    Args:
        known: an estimate or given parameters; the model alone where none are known, and figures that need them say so.
            With elastic motors, figures are those below the resonances, and those above where they are said to be.
        where: the workspace; limits of rotors do not matter.
        instruments: rate, delay, limits and resolutions; those of the device file where None.
        poses: most cells of the grid over the workspace.

    Raises:
        IncompleteDeviceError: the device has no handle.
        ModelMismatchError: the workspace is of another device.
        WorkspaceError: no pose is inside the workspace.
        UnknownNameError: a figure of a motor that the device does not have.
    """
    where.model.require_same(known if isinstance(known, DynamicModel) else known.model)
    bent, known, where = known, *_stiff(known, where)
    model = where.model
    qa, every = where.grid(poses), handle_motion(model, where.grid(_POSITIONS * poses)).position
    at = handle_motion(model, qa)
    centre = (at.position.max(axis=0) + at.position.min(axis=0)) / 2
    middle = int(np.argmin(np.linalg.norm(at.position - centre, axis=1)))
    tools = instruments or DeviceInstruments()
    rows = [*_geometry(model, every), *_resolution(model, tools, qa)]
    if isinstance(known, DynamicModel):
        rows.append(SheetRow("Dynamics", "effective mass", None, "kg", "no parameters are known"))
    else:
        rows += Dynamics(known, qa, tools).rows()
    rows += [_bandwidth(tools), *_structure(bent, qa)]
    published = tuple(
        (one.name, f"{one.value:g} {one.unit or ''}".strip() if isinstance(one.value, float) else one.value, one.source)
        for one in model.device.tables.published
    )
    return DataSheet(model, tuple(rows), published, qa, read_only(every), middle)


def _stiff(known: IdentifiedModel | DynamicModel, where: Workspace) -> tuple[IdentifiedModel | DynamicModel, Workspace]:
    """The same with rigid motors: what a hand feels below the resonances."""
    model = with_stiff_springs(where.model)
    if model is where.model:
        return known, where
    stiff = replace(where, model=model, limits=where.limits[: len(model.device.active)])
    return model if isinstance(known, DynamicModel) else on_counterpart(known, model), stiff


def _geometry(model: DynamicModel, positions: Array) -> Iterator[SheetRow]:
    device, group = model.device, "Mechanism and workspace"
    yield SheetRow(group, "degrees of freedom", float(len(device.active)), "", "active joints of the device file")
    yield SheetRow(group, "motors", float(len(device.motors)), "", "of the device file")
    extent = np.ptp(positions, axis=0)
    for axis, size in zip("xyz", extent, strict=True):
        yield SheetRow(group, f"workspace along {axis}", float(size), "m", f"of {len(positions)} poses in the limits")
    flat = extent < 1e-6 * extent.max()
    if not flat.any():
        from scipy import spatial  # slow to import, and few programs make a data sheet

        volume = float(spatial.ConvexHull(positions).volume)
        yield SheetRow(group, "workspace volume", volume, "m^3", "convex hull of the handle's positions")


def _resolution(model: DynamicModel, tools: DeviceInstruments, qa: Array) -> Iterator[SheetRow]:
    """Largest displacement, and turn, of the handle by one encoder step of every motor."""
    group, steps = "Resolution", handle_steps(model, tools, qa)
    if steps is None:
        yield SheetRow(group, "position resolution", None, "m", "encoder_counts of the motors are not known")
        return
    how = "J B^+ times step, joints by least squares of all encoders" if model.device.redundant else "J times step"
    method = f"largest displacement by one encoder step, {how}"
    yield over(
        group, "position resolution", Field(np.linalg.norm(steps[:, :3], axis=1).max(axis=1), None, np.inf, "m"), method
    )
    if len(model.measured_rows) > 3:
        turns = Field(np.linalg.norm(steps[:, 3:], axis=1).max(axis=1), None, np.inf, "rad")
        yield over(group, "angular resolution", turns, method.replace("displacement", "turn"))


def _bandwidth(tools: DeviceInstruments) -> SheetRow:
    """Frequency at which a zero-order hold passes half of the power, 0.443 of the rate."""
    method = "zero-order hold, to -3 dB; fast amplifiers, rigid device"
    return SheetRow(_STRUCTURE.group, "bandwidth of the force", _HALF_POWER * tools.rate_hz, "Hz", method)


def _structure(known: IdentifiedModel | DynamicModel, qa: Array) -> Iterator[SheetRow]:
    """Lowest natural frequencies of springs behind motors and the mass above them, where they are identified.

    Args:
        known: of the device as its file has it.
        qa: positions of the active joints without rotors, (active, poses).
    """
    if isinstance(known, DynamicModel) or not known.model.device.elastic:
        yield _STRUCTURE
        return
    known = on_counterpart(known, without_sensors(known.model))
    qa = without_torsion(known.model.device, qa.T, position=True).T
    masses = apparent_mass(known, qa).mass
    for name, k in (("largest", 0), ("smallest", masses.values.shape[1] - 1)):
        part = Field(masses.values[:, k], None if masses.se is None else masses.se[:, k], masses.dof, "kg")
        method = "principal value with free rotors: above the structural frequency, which links follow alone"
        yield over(_STRUCTURE.group, f"{name} effective mass of the links alone", part, method)
    for held in (True, False):
        name = f"{_STRUCTURE.name}, motors {'held' if held else 'free'}"
        method = "lowest natural frequency on the motors' springs, without damping and gravity"
        yield over(_STRUCTURE.group, name, structural_frequency(known, qa, held), method)
