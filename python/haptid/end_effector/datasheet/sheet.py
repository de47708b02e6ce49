"""`data_sheet`: the figures of a device over its workspace, each with range, interval and method.

Terms are those of Hayward and Astley (1996), Performance measures for haptic interfaces, Robotics Research: The 7th
International Symposium, 195-207, and Samur (2012), Performance Metrics for Haptic Interfaces, Springer: degrees of
freedom, motion range, peak and continuous force, back-drive friction, inertia, resolution, dynamic range, Z-width.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.device.elastic import without_torsion
from haptid.dynamics.counterparts import with_stiff_springs, without_sensors
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.workspace import Workspace
from haptid.end_effector.characterisation.apparent_mass import apparent_mass
from haptid.end_effector.characterisation.characterise import characterise
from haptid.end_effector.characterisation.model import IdentifiedModel, on_counterpart
from haptid.end_effector.compensation import TYPICAL_HAND, Compensation
from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.datasheet.structure import structural_frequency
from haptid.end_effector.datasheet.z_width import StepDevice, passive_stiffness, stable_stiffness, stepped_stiffness
from haptid.errors import index_of
from haptid.uncertainty.quantities import Field

# Cells of the grid over the workspace.
_POSES = 1000
# Cells of the grid of the handle's positions, in multiples of that.
_POSITIONS = 8
# A direction in which the handle moves: this share of it is in the range of the Jacobian.
_WITHIN = 0.99


@dataclass(frozen=True)
class SheetRow:
    """One figure.

    Attributes:
        group: heading under which it stands.
        name: of the figure.
        value: at the median of the workspace, or of the whole; None where it is not known.
        unit: of the value.
        low, high: range over the workspace; None where there is none.
        conf_int: 95 % interval of the value; None where no covariance is known.
        method: how it was found, or why it is not known.
    """

    group: str
    name: str
    value: float | None
    unit: str
    method: str
    low: float | None = None
    high: float | None = None
    conf_int: tuple[float, float] | None = None


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
    rows = [*_geometry(model, every), *_resolution(model, tools, at.jacobian[:, :3])]
    if isinstance(known, DynamicModel):
        rows.append(SheetRow("Dynamics", "effective mass", None, "kg", "no parameters are known"))
    else:
        rows += _Dynamics(known, qa, tools).rows()
    rows += _structure(bent, qa)
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


def _resolution(model: DynamicModel, tools: DeviceInstruments, jacobian: Array) -> Iterator[SheetRow]:
    """Largest displacement of the handle by one encoder step of every motor."""
    group, steps = "Resolution", tools.position_steps(model)
    if steps is None or model.device.redundant:
        yield SheetRow(group, "position resolution", None, "m", "encoder_counts of the motors are not known")
        return
    to_joints = model.device.active_from_drives[:, model.device.driven]
    step = np.linalg.norm((jacobian @ to_joints) * steps, axis=1).max(axis=1)
    method = "largest displacement by one encoder step, J times step"
    yield _over(group, "position resolution", Field(step, None, np.inf, "m"), method)


def _over(group: str, name: str, field: Field, method: str) -> SheetRow:
    """A row from a quantity over the poses: its median, range, and the interval at the median."""
    values = np.asarray(field.values)
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return SheetRow(group, name, None, field.unit, f"{method}: at no pose")
    order = known[np.argsort(values[known])]
    at = order[len(order) // 2]
    interval = field.conf_int()
    ends = None if interval is None else (float(interval[at, 0]), float(interval[at, 1]))
    return SheetRow(
        group, name, float(values[at]), field.unit, method, float(values[order[0]]), float(values[order[-1]]), ends
    )


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
        yield _over(_STRUCTURE.group, f"{name} effective mass of the links alone", part, method)
    for held in (True, False):
        name = f"{_STRUCTURE.name}, motors {'held' if held else 'free'}"
        method = "lowest natural frequency on the motors' springs, without damping and gravity"
        yield _over(_STRUCTURE.group, name, structural_frequency(known, qa, held), method)


class _Dynamics:
    """Figures that need parameters, along the base axes in which the handle can move."""

    def __init__(self, known: IdentifiedModel, qa: Array, tools: DeviceInstruments) -> None:
        self.known, self.model, self.tools, self.qa = known, known.model, tools, qa
        self.rotating = len(self.model.measured_rows) > 3
        self.found = characterise(known, qa, tuple(range(6)) if self.rotating else (0, 1, 2))
        J = self.found.handle.jacobian
        inside = np.einsum("pij,pji->pi", J, np.linalg.pinv(J)).mean(axis=0)
        self.axes = [k for k in range(len(inside)) if inside[k] > _WITHIN]

    def rows(self) -> Iterator[SheetRow]:
        """All rows."""
        yield from self._inertia()
        yield from self._friction()
        yield from self._forces()
        if not self.rotating and len(self.axes) == 3:
            yield from self._z_width()

    def _unit(self, k: int) -> Array:
        made: Array = np.eye(len(self.found.handle.rows))[k]
        return made

    @staticmethod
    def _named(what: str, k: int) -> str:
        return f"{what} {'along' if k < 3 else 'about'} {'xyz'[k % 3]}"

    def _inertia(self) -> Iterator[SheetRow]:
        group = "Inertia"
        if not self.rotating:
            mass = self.found.apparent_mass
            for name, k in (("largest effective mass", 0), ("smallest effective mass", mass.values.shape[1] - 1)):
                part = Field(mass.values[:, k], None if mass.se is None else mass.se[:, k], mass.dof, "kg")
                yield _over(group, name, part, "principal value of J^-T A J^-1")
            isotropy = replace(self.found.isotropy, unit="")
            yield _over(group, "isotropy of the mass", isotropy, "smallest over largest effective mass")
        for k in self.axes:
            made = replace(self.found.mass_along(self._unit(k)), unit="kg" if k < 3 else "kg m^2")
            what = "effective mass" if k < 3 else "rotational inertia"
            yield _over(group, self._named(what, k), made, "none across: other components held")

    def _friction(self) -> Iterator[SheetRow]:
        group = "Friction and weight"
        rubs = any(self.found.coulomb_friction(self._unit(k)).values.any() for k in self.axes)
        if not rubs:
            yield SheetRow(group, "back-drive friction", None, "N", "no dry friction among the parameters")
        for k in self.axes if rubs else ():
            force = self.found.coulomb_friction(self._unit(k))
            se = None if force.se is None else force.se[:, k]
            part = Field(force.values[:, k], se, force.dof, "N" if k < 3 else "N m")
            yield _over(group, self._named("back-drive friction", k), part, "dry friction of slow motion, J^-T Fc sign")
        weight = np.linalg.norm(self.found.weight.values[:, :3], axis=1)
        yield _over(group, "weight at the handle", Field(weight, None, np.inf, "N"), "gravity, springs and offsets")

    def _forces(self) -> Iterator[SheetRow]:
        group = "Force"
        made: dict[str, Array] = {}
        for what in ("peak", "continuous"):
            limits = self.tools.of(self.model, what)
            if limits is None:
                yield SheetRow(group, f"{what} force", None, "N", f"{what}_torque of the motors is not known")
                continue
            if not self.rotating:
                force, _ = self.found.greatest_force(limits)
                made[what] = force.values
                yield _over(group, f"{what} force", force, "worst direction, motors carry the weight")
            for k in self.axes:
                along = replace(self.found.force_along(self._unit(k), limits), unit="N" if k < 3 else "N m")
                yield _over(
                    group,
                    self._named(f"{what} {'force' if k < 3 else 'moment'}", k),
                    along,
                    "until the first motor is at its limit",
                )
        yield from self._dynamic_range(made.get("peak"))
        steps = self.tools.of(self.model, "torque_step")
        if steps is None:
            yield SheetRow(group, "force resolution", None, "N", "torque_step of the motors is not known")
        elif not self.rotating and not self.model.device.redundant:
            torque = np.array([steps[motor.name] for motor in self.model.device.motors])
            B = self.model.device.drive_jacobian(self.model.device.row_map @ self.qa)
            rows = np.swapaxes(B, -1, -2)[..., self.model.device.driven] * torque
            size = np.linalg.norm(np.swapaxes(self.found.inverse, 1, 2) @ rows, axis=1).max(axis=1)
            yield _over(group, "force resolution", Field(size, None, np.inf, "N"), "J^-T times one step of a motor")

    def _dynamic_range(self, peak: Array | None) -> Iterator[SheetRow]:
        group = "Force"
        if peak is None:
            return
        worst = np.max([self.found.coulomb_friction(self._unit(k)).values[:, k] for k in self.axes], axis=0)
        if worst.any():
            method = "peak force over largest back-drive friction"
            ratio = peak / np.where(worst > 0, worst, np.nan)
            yield _over(group, "dynamic range", Field(ratio, None, np.inf, ""), method)
        acceleration = peak / self.found.apparent_mass.values[:, 0]
        yield _over(
            group, "peak acceleration", Field(acceleration, None, np.inf, "m/s^2"), "peak force over largest mass"
        )

    def _z_width(self) -> Iterator[SheetRow]:
        """Bounds of a virtual spring at the pose of median damping, and its passive bound over the workspace."""
        group, dt, delay = "Z-width", 1 / self.tools.rate_hz, self.tools.delay
        viscous = self.found.viscous_friction
        if not viscous.values.any():
            yield SheetRow(group, "passive stiffness", None, "N/m", "no viscous friction among the parameters")
            return
        yield SheetRow(group, "control period", dt, "s", f"and a delay of {delay:g} s; the rest at the median pose")
        factor = 1 / (dt / 2 + delay)
        least = np.maximum(viscous.values[:, -1], 0) * factor
        bound = Field(least, None if viscous.se is None else viscous.se[:, -1] * factor, viscous.dof, "N/m")
        yield _over(group, "passive stiffness", bound, "b / (T / 2 + delay), Colgate and Schenkel (1997)")
        order = np.argsort(np.where(np.isfinite(least), least, np.inf))
        at = int(order[int(np.isfinite(least).sum()) // 2])
        loop = Compensation(self.known, 0.0, weight=0.0).loop(self.qa[:, at], dt, delay)
        free = replace(loop, stiffness=np.zeros_like(loop.stiffness))
        # A wall shaped like the damping reaches the passive bound in all directions at once.
        inverse = np.linalg.pinv(loop.jacobian)
        shape = inverse.T @ loop.viscous @ inverse
        if (least_damping := float(np.linalg.eigvalsh(shape)[0])) > 0:
            value = stable_stiffness(free, None, shape / least_damping)
            method = "sampled device without dry friction, wall shaped like B"
            yield SheetRow(group, "passive stiffness, simulated", value, "N/m", method)
        value = stable_stiffness(free, TYPICAL_HAND)
        method = "no dry friction, a typical hand, Fu and Cavusoglu (2012)"
        yield SheetRow(group, "stable stiffness, linear, in a hand", value, "N/m", method)
        yield from self._stepped(at, dt, delay)

    def _stepped(self, at: int, dt: float, delay: float) -> Iterator[SheetRow]:
        group, found = "Z-width", self.found
        direction = found.masses.directions[at, 0]
        friction = float(found.coulomb_friction(direction).values[at] @ direction)
        viscous = max(float(found.viscous_along(direction).values[at]), 0.0)
        steps, step = self.tools.position_steps(self.model), 0.0
        if steps is not None and not self.model.device.redundant:
            to_joints = self.model.device.active_from_drives[:, self.model.device.driven]
            J = handle_motion(self.model, self.qa[:, [at]]).jacobian[0, :3]
            step = float(np.abs(direction @ J @ to_joints * steps).max())
            if friction > 0:
                b = float(found.viscous_friction.values[at, -1])
                value = min(passive_stiffness(np.diag([b]), dt, delay), 2 * friction / step)
                method = "and at most 2 Fc / step, Abbott and Okamura (2005)"
                yield SheetRow(group, "passive stiffness, quantised", value, "N/m", method)
        device = StepDevice(float(found.apparent_mass.values[at, 0]), viscous, friction, step, dt, delay)
        what = f"stepped with dry friction{' and encoder steps' if step else ''}, largest mass"
        for name, hand in (("free", None), ("in a hand", TYPICAL_HAND)):
            value = stepped_stiffness(device, hand)
            row = SheetRow(group, f"stable stiffness, {name}", value, "N/m", what)
            yield row if np.isfinite(value) else replace(row, value=None, method=f"above 1e6 N/m: {what}")
