"""Custom terms: a column given as an expression, and the constants of terms, given or estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from haptid.device.expressions import RESERVED, CustomColumn, column
from haptid.device.terms.term import Searched, TermColumn
from haptid.device.toml.terms import CustomTerm, SearchedTable

if TYPE_CHECKING:
    from haptid.device.geometry import Reader
    from haptid.device.terms.build import Target, TermTargets
    from haptid.device.toml.errors_at import Place

# Unit of a constant, for a turning and for a sliding coordinate; others have none.
_UNITS = {
    "velocity": ("rad/s", "m/s"),
    "width": ("rad/s", "m/s"),
    "distance": ("rad", "m"),
    "play": ("rad", "m"),
    "rest": ("rad", "m"),
    "time": ("s", "s"),
}
# Bounds of a searched constant where the file gives none: its start divided and multiplied by this.
RANGE = 100.0


def custom_column(table: CustomTerm, target: Target, targets: TermTargets, reader: Reader, place: Place) -> TermColumn:
    """The term of a user's own expression.

    Raises:
        DeviceFileError: several targets, a constant whose name is taken, or an expression that is wrong.
    """
    targets.expect_one(table, place)
    joints = [joint.name for joint in targets.joints]
    shape = column(table.expression, joints, constant_names(table.constants, reader, place), place.at("expression"))
    term_column = target.external(table.name, table.unit, shape)
    return with_constants(term_column, table.constants, reader, place.at("constants"))


def constant_names(constants: Mapping[str, Any], reader: Reader, place: Place) -> dict[str, float]:
    """Lengths by name, and the constants of a term, whose values follow.

    Raises:
        DeviceFileError: the name of a constant is taken.
    """
    for name in constants:
        if name in reader.lengths or name in RESERVED:
            known = "a named length" if name in reader.lengths else "arithmetic"
            raise place.at("constants", name).taken("constant", name, known)
    return {**reader.lengths, **dict.fromkeys(constants, 0.0)}


def with_constants(
    term: TermColumn, written: Mapping[str, Any], reader: Reader, place: Place, nested: bool = True
) -> TermColumn:
    """The term with its constants; those given as a range are nonlinear parameters to estimate.

    Args:
        term: the column.
        written: constants as they are written.
        reader: of numbers.
        place: of the term.
        nested: whether constants stand in it by name; else the place is that of the only one.
    """
    searched = []
    for name, value in written.items():
        constant_place = place.at(name) if nested else place
        if isinstance(value, SearchedTable):
            start, made = _searched(term, name, value, reader, constant_place)
            searched.append(made)
        else:
            start = reader.number(value, constant_place)
        if not _any_value(term, name):
            start = (
                reader.positive(start, constant_place)
                if name != "width"
                else reader.not_negative(start, constant_place)
            )
        term = term.with_constant(name, start)
    return replace(term, searched=tuple(searched))


def _any_value(term: TermColumn, name: str) -> bool:
    """Whether a constant may have any sign: those of expressions in the file, and the rest of a spring."""
    return name == "rest" or (isinstance(term.shape, CustomColumn) and not term.shape.nature)


def _searched(
    term: TermColumn, name: str, table: SearchedTable, reader: Reader, place: Place
) -> tuple[float, Searched]:
    """Start value and bounds of a constant that is estimated."""
    start = reader.number(table.start, place.at("start"))
    ends = []
    for key, factor in (("low", 1 / RANGE), ("high", RANGE)):
        setting = getattr(table, key)
        if setting is None and start <= 0:
            found = f"start is {start:g}, from which no range follows"
            raise place.at(key).error(found, f"Write {key} = ... next to start.")
        ends.append(start * factor if setting is None else reader.number(setting, place.at(key)))
    low, high = ends
    if not low <= start <= high or low == high:
        found = f"start is {start:g}, low {low:g}, high {high:g}"
        raise place.error(found, "Let low be below high, and start between them.")
    if not _any_value(term, name) and low <= 0:
        raise place.at("low").error(f"found {low:g}", "Write a number above zero.")
    written = isinstance(term.shape, CustomColumn) and not term.shape.nature
    unit = "" if written else _UNITS.get(name, ("", ""))[term.unit in ("N", "N/m")]
    return start, Searched(name, unit, low, high)
