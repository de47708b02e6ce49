"""Summary of a device as text: tree, loops, motors, terms and symmetries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.device.parts import Joint, Motor
from haptid.device.terms.spring import Counterbalance
from haptid.device.terms.term import TermColumn


@dataclass(frozen=True)
class SummaryTable:
    """A table of texts about a device.

    Attributes:
        title: what it is about.
        head: of its columns.
        rows: with a cell for each column.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def summary_tables(device: Device) -> tuple[SummaryTable, ...]:
    """Joints, motors and terms of a device."""
    joints: tuple[str, ...] = ("joint", "on", "type", "moves", "link", "limits", "velocity", "torque")
    motors = ("motor", "coordinate", "gear ratio", "torque constant", "command")
    rows = tuple(_joint_row(device, k, joint) for k, joint in enumerate(device.joints))
    if any(joint.alias for joint in device.joints):
        joints = (*joints, "in the source")
        rows = tuple((*row, joint.alias or joint.name) for row, joint in zip(rows, device.joints, strict=True))
    found = (
        SummaryTable("Tree", joints, rows),
        SummaryTable("Motors", motors, tuple(_motor_row(device, drive) for drive in device.drives)),
        SummaryTable("Terms", ("term", "unit", "on", "parameters"), tuple(_terms(device.terms))),
    )
    return tuple(table for table in found if table.rows)


def summary_lines(device: Device) -> tuple[str, ...]:
    """The device as lines of text, without markup."""
    lines = [device.name]
    lines += [text for text in (device.description, f"source: {device.source}" if device.source else "") if text]
    gravity = ", ".join(f"{g:g}" for g in device.gravity)
    lines += [f"gravity [{gravity}] m/s^2, described by {device.convention}"]
    for table in summary_tables(device):
        if table.title == "Motors" and device.closure.relations:
            lines += ["", "Loops", *(f"  {text}" for text in device.closure.relations)]
            if device.closure.cuts:
                lines.append(f"  closed within {device.closure.error:.1e} m")
        lines += ["", table.title]
        if table.title == "Terms":
            lines += [f"  {term} [{unit}] on {on}s: {names}" for term, unit, on, names in table.rows]
        else:
            lines += _table(table.head, table.rows)
    parameters = device.parameters
    lines += ["", f"{len(parameters)} standard parameters of {len(parameters.raw)} columns"]
    lines += [f"  {note}" for note in device.notes]
    return tuple(lines)


def _joint_row(device: Device, k: int, joint: Joint) -> tuple[str, ...]:
    parent = device.joints[joint.parent].name if joint.parent >= 0 else "base"
    unit = "m" if joint.prismatic else "rad"
    low_high = joint.position_limits
    return (
        joint.name,
        parent,
        "prismatic" if joint.prismatic else "revolute",
        "active" if k in device.active else "passive",
        "body" if joint.body else "massless",
        f"{low_high[0]:.4g} .. {low_high[1]:.4g} {unit}" if low_high else "-",
        f"{joint.velocity_limit:.4g} {unit}/s" if joint.velocity_limit else "-",
        f"{joint.torque_limit:.4g} {'N' if joint.prismatic else 'N m'}" if joint.torque_limit else "-",
    )


def _motor_row(device: Device, drive: Motor) -> tuple[str, ...]:
    coordinate = ""
    for name, factor in zip(device.joint_names, drive.row, strict=True):
        if factor:
            size = "" if abs(factor) == 1 else f"{abs(factor):g}*"
            sign = "-" if factor < 0 else "+" if coordinate else ""
            coordinate += f" {sign} {size}q{name}" if coordinate else f"{sign}{size}q{name}"
    if not drive.motorised:
        why = "springs" if drive.unloaded else "none, torque zero" if drive.free else "no motor"
        return (drive.name, coordinate, "-", "-", why)
    return (drive.name, coordinate, f"{drive.gear_ratio:.8g}", f"{drive.torque_constant:.8g}", drive.command_unit)


def _terms(terms: Iterable[TermColumn]) -> list[tuple[str, str, str, str]]:
    """One row for each run of terms of the same kind and settings."""
    rows: list[tuple[str, str, str, str]] = []
    for term in terms:
        key = (_words(term), term.unit, term.on.partition(" ")[0].replace("elastic", "motor"))
        if rows and rows[-1][:3] == key:
            rows[-1] = (*key, f"{rows[-1][3]} {term.name}")
        else:
            rows.append((*key, term.name))
    return rows


def _words(term: TermColumn) -> str:
    """A term's kind and settings."""
    if isinstance(term.shape, Counterbalance):
        return f"counterbalance, {term.shape.force} force"
    if term.shape is not None:
        return f"column {term.shape.text}"
    settings = {"stribeck": "velocity {}, exponent {}, width {}", "spring": "rest {}"}.get(term.kind, "width {}")
    shown = f" ({settings.format(*(f'{s:g}' for s in term.settings))})" if any(term.settings) else ""
    side = "elastic, " if term.on.startswith("elastic ") else ""
    return f"{side}{'rotor-inertia' if term.kind == 'rotor' else term.kind}{shown}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    cells = [head, *rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in cells)
    return ["  " + line.rstrip() for line in lines]
