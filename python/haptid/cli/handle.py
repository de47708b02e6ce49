"""Poses, figures and output of `haptid characterise`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.cli.options import named, numbers, one_or_each, ranges, wrong_option
from haptid.device import Device
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.workspace import Workspace, workspace
from haptid.end_effector.characterisation import Characterisation, apparent_mass, line
from haptid.end_effector.characterisation.characterise import POSES
from haptid.end_effector.characterisation.plots import SweepCurve, plot_map, plot_sweeps
from haptid.end_effector.characterisation.summary import notes
from haptid.end_effector.characterisation.table import TableColumn, TableRequest
from haptid.report.model_tables import table

# Poses of a sweep, and of each side of a map.
SWEEP, SIDE = 201, 120
# Share of a column's largest figure below which another is zero but for rounding.
_ROUNDED = 1e-12


@dataclass(frozen=True, eq=False)
class Poses:
    """Selected poses.

    Attributes:
        qa: of the active joints, (active, poses), rad or m.
        path: from 0 to 1 along a sweep, (poses,), None of other poses.
        where: workspace of a grid, None of other poses.
    """

    qa: Array
    path: Array | None = None
    where: Workspace | None = None


def chosen(
    model: DynamicModel, at: Sequence[str], sweep: tuple[str, str] | None, grid: int | None, limit: Sequence[str]
) -> Poses:
    """The poses that the options select.

    Raises:
        OptionError: options that exclude each other, or numbers that do not fit the device.
        HaptidError: an impossible workspace.
    """
    if sum((bool(at), sweep is not None, grid is not None)) > 1:
        raise wrong_option("--at, --sweep, --grid", "given together", "one of them")
    names = ", ".join(model.device.joint_names[j] for j in model.device.active)
    wanted, count = f"positions of joints {names}", len(model.device.active)
    if at:
        return Poses(np.array([numbers("--at", text, wanted, count) for text in at]).T)
    if sweep is not None:
        start, end = (numbers("--sweep", text, wanted, count) for text in sweep)
        return Poses(line(start, end, SWEEP), path=np.linspace(0.0, 1.0, SWEEP))
    area = workspace(model, ranges("--limit", limit))
    return Poses(area.grid(grid or POSES), where=area)


def table_request(
    device: Device, along: str | None, speed: float | None, stiffness: str | None, torque: Sequence[str]
) -> TableRequest:
    """Inputs of the figures in addition to the model.

    Raises:
        OptionError: numbers that do not fit the device.
    """
    joints = f"stiffnesses of {', '.join(device.row_labels)}"
    limits = named("--torque", torque)
    motors = [drive.name for drive in device.motors]
    for name in limits:
        if name not in motors:
            raise wrong_option("--torque", name, f"NAME=VALUE of a motor: {', '.join(motors)}")
    return TableRequest(
        along=numbers("--along", along, "x, y, z", 3) if along is not None else None,
        speed=speed,
        stiffness=one_or_each("--stiffness", stiffness, joints, len(device.active)) if stiffness is not None else None,
        torque=limits or None,
    )


def draw(poses: Poses, characterisation: Characterisation, path: Path, progress: Callable[[str, float], None]) -> None:
    """Plot the masses along a sweep, or the largest one over two joints of a grid; nothing for single poses."""
    if poses.path is None and (poses.where is None or len(poses.where.limits) < 2):
        return
    progress("drawing", 0.0)
    if poses.path is not None:
        label = "from the first pose (0) to the second (1)"
        plot_sweeps(
            [SweepCurve(label, poses.path, {characterisation.model.device.name: characterisation.apparent_mass})],
            "apparent mass, kg",
            path,
        )
    elif poses.where is not None:
        _draw_map(poses.where, characterisation, path)
    progress("drawing", 1.0)


def _draw_map(area: Workspace, characterisation: Characterisation, path: Path) -> None:
    """Plot the largest mass over the last two active joints, the others at the middle of their ranges."""
    (low, high), (lowest, highest) = area.limits[-2:].tolist()
    first, second = np.linspace(low, high, SIDE), np.linspace(lowest, highest, SIDE)
    qa = np.repeat(area.limits.mean(axis=1)[:, None], SIDE * SIDE, axis=1)
    across, vertical = np.meshgrid(first, second)
    qa[-2:] = across.ravel(), vertical.ravel()
    mass = np.full(SIDE * SIDE, np.nan)
    inside = area.holds(qa)
    mass[inside] = apparent_mass(
        characterisation.identified, qa[:, inside], worst_condition=characterisation.handle.worst
    ).mass.values[:, 0]
    joints = [characterisation.model.device.joints[j] for j in characterisation.model.device.active[-2:]]
    across_label, up_label = (f"{joint.name}, {'m' if joint.prismatic else 'rad'}" for joint in joints)
    labels = (across_label, up_label, "largest apparent mass, kg")
    plot_map(first, second, mass.reshape(SIDE, SIDE), labels, path)


def show(console: Console, characterisation: Characterisation, columns: Sequence[TableColumn]) -> None:
    """Print the figures: of one pose with intervals, of several poses median and range; and the notes."""
    handle = characterisation.handle
    console.print(
        f"{characterisation.model.device.name} at the handle: {int(handle.usable.sum())} of {len(handle)} poses",
        style="bold",
    )
    single = len(handle) == 1
    heads = ("value", "95 % interval") if single else ("median", "lowest", "highest", "max 95 % half-width")
    rows = [
        ([c.name, *(_single(c) if single else _several(c)), "" if c.figure.unit == "1" else c.figure.unit], False)
        for c in columns
    ]
    console.print(table("", ("", *heads, "unit"), rows, left=("unit",)))
    for note in notes(characterisation):
        console.print(f"- {note}", soft_wrap=True)


def figures(characterisation: Characterisation, made: Sequence[TableColumn]) -> dict[str, Any]:
    """Poses and figures as JSON values, null where unknown."""
    columns = [
        {
            "name": column.name,
            "unit": column.figure.unit,
            "values": column.figure.values.tolist(),
            "conf_int": None if column.figure.se is None else np.asarray(column.figure.conf_int()).tolist(),
        }
        for column in made
    ]
    joints = [characterisation.model.device.joint_names[j] for j in characterisation.model.device.active]
    poses = dict(zip(joints, characterisation.handle.qa.tolist(), strict=True))
    return {
        "device": characterisation.model.device.name,
        "poses": poses,
        "figures": columns,
        "notes": list(notes(characterisation)),
    }


def _single(column: TableColumn) -> list[str]:
    value, interval = float(column.figure.values[0]), column.figure.conf_int()
    if not np.isfinite(value):
        return ["unknown", ""]
    return [f"{value:.4g}", "" if interval is None else f"{interval[0, 0]:.4g} .. {interval[0, 1]:.4g}"]


def _several(column: TableColumn) -> list[str]:
    value, interval = column.figure.values, column.figure.conf_int()
    known = np.isfinite(value)
    if not known.any():
        return ["unknown", "", "", ""]
    few = np.array([np.median(value[known]), value[known].min(), value[known].max()])
    # What cancels in exact arithmetic is left at the size of rounding, whose digits mean nothing.
    few[np.abs(few) < _ROUNDED * np.abs(value[known]).max()] = 0.0
    shown = [f"{x:.4g}" for x in few]
    return [*shown, "" if interval is None else f"{np.ptp(interval[known], axis=1).max() / 2:.2g}"]
