"""Redesign as tables and pictures: fronts of counterweights, and of motors, gears and lengths."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from haptid._core import __version__
from haptid._internal.atomic_folder import write_file
from haptid.end_effector.redesign import Balance, Counterweight, DriveChange, MotorOption, Redesign, pareto
from haptid.inference.targets import target_map
from haptid.report.chart import Chart, axis, chart_series, packed, plot
from haptid.report.document import DocumentSection, TextTable
from haptid.report.page import page

# Rows of a front in a table.
_ROWS = 16
# What is assumed of changes of the drives.
DRIVES_TEXT = (
    "Transmission ratios, all lengths and the motors are changed together; links are slender bars of the same section, "
    "and a motor's own mass is not counted. Mass and force are medians over those poses at which the handle is not "
    "singular and the mass matrix without rotors is positive definite"
)


def weight_text(weight: Counterweight) -> str:
    """A counterweight as text, coordinates of the link frame that are zero left out."""
    at = [f"{name} = {1e3 * x:.1f} mm" for name, x in zip("xyz", weight.com, strict=True) if abs(x) > 5e-8]
    return f"{weight.mass:.3f} kg on {weight.link} at {', '.join(at) or 'its origin'}"


def weights_table(front: Sequence[Balance]) -> TextTable:
    """The front of counterweights, by price."""
    cells = [["price", "static torque, N m", "largest effective mass, kg", "weights"]]
    for one in front:
        weights = "; ".join(map(weight_text, one.weights)) or "none"
        cells.append([f"{one.price:g}", f"{one.static_after:.2g}", f"{one.mass_after:.4f}", weights])
    return TextTable("Static torque against effective mass", cells)


def weights_chart(front: Sequence[Balance]) -> Chart:
    """Static torque against effective mass."""
    x, y = packed([one.mass_after for one in front]), packed([one.static_after for one in front])
    curves = [chart_series("front", "line", "blue", x=x, y=y), chart_series("weights", "points", "blue", x=x, y=y)]
    none = {"x": packed([front[0].mass_before]), "y": packed([front[0].static_before])}
    curves.append(chart_series("no weights", "points", "vermillion", **none))
    drawing = plot(axis("largest effective mass", "kg"), axis("static torque", "N m", zero=True), curves, height=240)
    caption = f"From {front[0].static_before:.3g} N m and {front[0].mass_before:.4f} kg without weights."
    alt = "Static torque against effective mass for several prices of mass."
    return Chart("redesign", "Static torque against effective mass", alt, caption, drawing)


def drives_table(present: DriveChange, front: Sequence[DriveChange], chosen: DriveChange | None = None) -> TextTable:
    """The device as it is, the wanted change, and evenly spaced changes of the front.

    Args:
        present: without changes.
        front: by mass.
        chosen: that reaches what is wanted.
    """
    count = min(_ROWS, len(front))
    rows = [front[k] for k in dict.fromkeys(np.linspace(0, len(front) - 1, count).round().astype(int).tolist())]
    named = [("as it is", present), *([("reaches it", chosen)] if chosen else []), *(("front", one) for one in rows)]
    cells = [["", "ratios times", "lengths times", "motors", "largest effective mass, kg", "worst-case force, N"]]
    for name, one in named:
        cells.append(
            [name, _ratios(one.ratios), f"{one.length:g}", motor_text(one.motor), f"{one.mass:.4f}", f"{one.force:.3g}"]
        )
    return TextTable("Motors, gears and lengths", cells)


def drives_chart(
    present: DriveChange,
    changes: Sequence[DriveChange],
    chosen: DriveChange | None = None,
    most_mass: float = np.inf,
    least_force: float = 0.0,
) -> Chart:
    """Force against effective mass: the front of each option of motors, all changes, and what is wanted."""
    everything = _curve(changes)
    curves = [chart_series("changes", "points", "sky", x=everything[0], y=everything[1])]
    front = _curve(pareto(changes))
    curves.append(chart_series("front", "line", "blue", x=front[0], y=front[1]))
    gears = _curve(pareto([one for one in changes if one.motor == present.motor and one.length == 1.0] or [present]))
    curves.append(chart_series("gears alone", "line", "orange", x=gears[0], y=gears[1]))
    for name, colour, one in (("as it is", "vermillion", present), ("reaches it", "green", chosen)):
        if one is not None:
            curves.append(chart_series(name, "points", colour, x=packed([one.mass]), y=packed([one.force])))
    wanted = [f"at most {most_mass:g} kg"] if np.isfinite(most_mass) else []
    wanted += [f"at least {least_force:g} N"] if least_force else []
    caption = f"{len(changes)} changes{'; wanted: ' + ', '.join(wanted) if wanted else ''}."
    drawing = plot(axis("largest effective mass", "kg"), axis("worst-case force", "N", zero=True), curves, height=260)
    alt = "Worst-case force against effective mass of changes of motors, gears and lengths."
    return Chart("drives", "Force against effective mass", alt, caption, drawing)


def motor_text(motor: MotorOption) -> str:
    """The motors of a change as text."""
    return (
        motor.name
        if motor.torque == motor.inertia
        else f"{motor.name} (torque x {motor.torque:g}, rotor x {motor.inertia:g})"
    )


def _ratios(ratios: Sequence[float]) -> str:
    same = len(set(ratios)) == 1
    return f"{ratios[0]:g}" if same else ", ".join(f"{r:g}" for r in ratios)


def _curve(changes: Sequence[DriveChange]) -> tuple[dict[str, Any], dict[str, Any]]:
    return packed([one.mass for one in changes]), packed([one.force for one in changes])


def redesign_sections(found: Redesign) -> list[DocumentSection]:
    """A chapter on counterweights and one on motors, gears and lengths, as far as they are known."""
    sections = []
    if (best := found.best) is not None:
        weights = " and ".join(map(weight_text, best.weights)) or "no weight"
        text = [
            f"{weights[0].upper()}{weights[1:]}: the root mean square of the static torque changes from "
            f"{best.static_before:.3g} to {best.static_after:.2g} N m, the largest effective mass, mean over the "
            f"poses, from {best.mass_before:.4f} to {best.mass_after:.4f} kg."
        ]
        tables = (weights_table(found.balances), _price_table(found, best))
        sections.append(
            DocumentSection("weights", "Counterweights", tuple(text), tables, (weights_chart(found.balances),))
        )
    if (present := found.present) is not None:
        wishes = found.wishes
        text = [f"{DRIVES_TEXT}: {present.poses}."]
        if found.chosen is not None:
            text.append(f"The least change that reaches what is wanted: {change_text(found.chosen)}.")
        chart = drives_chart(present, found.changes, found.chosen, wishes.most_mass, wishes.least_force)
        sections.append(
            DocumentSection(
                "drives",
                "Motors, gears and lengths",
                tuple(text),
                (drives_table(present, found.front, found.chosen),),
                (chart,),
            )
        )
    if found.missing:
        sections.append(DocumentSection("missing", "What is not known", found.missing))
    return sections


def change_text(change: DriveChange) -> str:
    """A change and its figures as text."""
    return (
        f"ratios times {_ratios(change.ratios)}, lengths times {change.length:g}, motors {motor_text(change.motor)}: "
        f"{change.mass:.4f} kg and {change.force:.3g} N"
    )


def write_redesign(found: Redesign, path: Path) -> None:
    """Write the page.

    Raises:
        OutputFolderError: the file cannot be written.
    """
    name = found.identified.model.device.name
    write_file(path, page(f"Redesign: {name}", f"haptid {__version__}", redesign_sections(found)))


def _price_table(found: Redesign, best: Balance) -> TextTable:
    """What the weights change: the targets of the device file, or the base parameters."""
    model = found.identified.model
    names = [target.name for target in model.device.targets] if model.device.targets else list(model.base.names)
    C = target_map(model) if model.device.targets else np.eye(len(model.base))
    before, after = C @ found.identified.beta, C @ best.identified.beta
    cells = [["parameter, SI", "without", "with the weights", "price"]]
    for name, old, new in zip(names, before, after, strict=True):
        if abs(new - old) > 1e-12:
            cells.append([name, f"{old:.4g}", f"{new:z.4g}", f"{new - old:.4g}"])
    return TextTable("What the weights change", cells)
