"""What can keep regroupings from being found with the lengths as symbols."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.errors._both import RegroupingError


class SymbolicClosureError(RegroupingError):
    """A loop that closes at the device's own lengths, but not for all values of its symbols."""

    def __init__(self, on: str, other: str, lengths: Sequence[str]) -> None:
        super().__init__(
            f"with its lengths as symbols the loop cut between links {on} and {other} does not close: it closes at "
            f"{', '.join(lengths) or 'its own lengths'} only. Where bars must be equal, let them share a name in "
            f'[lengths], or write one by the other, such as d9 = "d3".'
        )


class ManyAnglesError(RegroupingError):
    """A geometry with too many angles that are no quarter turns."""

    def __init__(self, angles: int, limit: int) -> None:
        super().__init__(
            f"the geometry has {angles} angles that are no multiples of a quarter turn, limit {limit}: groupings have "
            f"too many terms to be written with symbols. Use the numeric groupings of `base_parameters`; angles that "
            f'are quarter turns rounded should be written as such: "pi/2", not 1.5708.'
        )


class NoDyadError(RegroupingError):
    """Loops that are not made of two turning passive joints and a pin each."""

    def __init__(self, file: str, found: str) -> None:
        super().__init__(
            f"{file}: these loops are not planar dyads: {found}. Each needs exactly two turning passive joints and a "
            f"turning cut, and no relations; loops with relations are read by `read_device`."
        )


class RegroupingFormError(RegroupingError):
    """A coefficient that is no ratio of polynomials of low degree."""

    def __init__(self, base: str, parameter: str, sets: int) -> None:
        super().__init__(
            f"how much of {parameter} is in base parameter {base} was not found as a formula: no ratio of polynomials "
            f"of low degree fits at {sets} sets of lengths. Write fewer lengths and angles that differ, or use the "
            f"numeric groupings of `base_parameters`."
        )


class RegroupingCheckError(RegroupingError):
    """A relation that does not hold where it is checked."""

    def __init__(self, found: str) -> None:
        super().__init__(
            f"the exact groupings do not pass their own check: {found}. Try another seed; if it stays, use the numeric "
            f"groupings of `base_parameters` and report the device file."
        )


class AccelerationRegroupingError(RegroupingError):
    """A column of accelerations that other parameters' columns make up."""

    def __init__(self, columns: Sequence[str]) -> None:
        super().__init__(
            f"a column of accelerations, {_list(columns)}, is not independent of the other parameters, and groupings "
            f"with symbols do not see that. Leave the column out, write it as a rotor inertia, or use the numeric "
            f"groupings of `base_parameters`."
        )


class RoadsDisagreeError(RegroupingError):
    """Base parameters that differ with lengths as symbols and at the device's own lengths."""

    def __init__(self, exact: int, numeric: int, only_exact: Sequence[str], only_numeric: Sequence[str]) -> None:
        halves = (("former", only_exact), ("latter", only_numeric))
        found = "; ".join(f"only the {which} have {_list(names)}" for which, names in halves if names)
        super().__init__(
            f"base parameters with lengths as symbols ({exact}) and at the device's own lengths ({numeric}) differ: "
            f"{found}. The device's "
            f"lengths or angles are special, or a column's law ties it to others: write equal lengths by one name and "
            f"lengths of zero as 0, or use the numeric groupings of `base_parameters`."
        )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
