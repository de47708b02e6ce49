"""Rows of a data sheet, and the row of a quantity over the workspace."""

from __future__ import annotations

import numpy as np

from haptid._internal.late import dataclass
from haptid.uncertainty.quantities import Field


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


def over(group: str, name: str, field: Field, method: str) -> SheetRow:
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
