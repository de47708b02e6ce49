"""Parameters with intervals, priors and groupings, and how their deviations go together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from haptid.dynamics.symbolic import Regroupings
from haptid.errors import HaptidError, RegroupingError
from haptid.estimation import Estimate, Parameter
from haptid.estimation.nonlinear import VariableProjection
from haptid.inference.elimination import essential as search
from haptid.inference.targets import targets
from haptid.report.chart import Chart, packed
from haptid.report.mathml import groupings, parameter
from haptid.report.section import Section
from haptid.report.source import Source
from haptid.report.tables import short_percent, with_digits

# With more parameters the search for those that can be left out takes longer than a reader waits.
MOST_SEARCHED = 60
# Correlations above this are named.
STRONG = 0.9


@dataclass(frozen=True)
class ParametersSection(Section):
    """Parameters.

    Attributes:
        rows: of the table, one for each base parameter: what is shown, what is sorted by and what is downloaded.
        targets: the same for what the device file asks for.
        searched: constants that the torque is not linear in: name, value, ends of the interval, unit, all as text, and
            whether the log bounds them.
        symbols: what the formulas stand on, "L1 = 0.215".
        about: sentences on intervals, groupings and what can be left out.
    """

    key: ClassVar[str] = "parameters"
    title: ClassVar[str] = "Parameters"
    rows: list[dict[str, Any]]
    targets: list[dict[str, Any]]
    searched: list[dict[str, Any]]
    symbols: list[str]
    about: list[str]

    @classmethod
    def of(cls, source: Source) -> ParametersSection:
        made = source.estimate
        exact = _exact(made)
        found = exact if isinstance(exact, Regroupings) else None
        formulas = groupings(made.base, found)
        left, why = _left_out(made)
        rows = [
            _row(p, formula, None if left is None else k not in left)
            for k, (p, formula) in enumerate(zip(made.parameters, formulas, strict=True))
        ]
        for row, latex in zip(rows, found.latex if found else [""] * len(rows), strict=True):
            row["latex"] = latex
        return cls(
            charts=(correlation(made),),
            rows=rows,
            targets=[_row(p, "", None) for p in targets(made).parameters] if made.model.device.targets else [],
            searched=_searched(source.identification.projection),
            symbols=[f"{s.name} = {s.value:.6g}" for s in found.symbols] if found else [],
            about=[why, *([exact] if isinstance(exact, str) else []), *_untold(made)],
        )


def _exact(made: Estimate) -> Regroupings | str:
    """Groupings with lengths as symbols, or the sentence that says why there are none."""
    try:
        return made.model.regroupings
    except RegroupingError as error:
        return f"Groupings are in numbers: {error}"


def _left_out(made: Estimate) -> tuple[tuple[int, ...] | None, str]:
    """Indices of the parameters that the torque does not need, and the rule; None where it was not asked."""
    if made.zero:
        return made.zero, "Parameters that are not essential were left out of this fit: they are zero."
    if made.held or len(made.beta) > MOST_SEARCHED:
        return None, "Which parameters are essential was not asked: `haptid.essential` can tell."
    try:
        found = search(made)
    except HaptidError as error:
        return None, f"Which parameters are essential is not known: {error}"
    return found.reduced.zero, f"Not essential: what could be left out. {found.reason}"


def _searched(projection: VariableProjection | None) -> list[dict[str, Any]]:
    """One row for each searched constant."""
    return [
        {
            "name": c.name,
            "value": f"{c.value:.4g}",
            "low": f"{c.interval[0]:.3g}",
            "high": f"{c.interval[1]:.3g}",
            "unit": c.unit,
            "weak": not c.bounded,
        }
        for c in (projection.constants if projection else ())
    ]


def _untold(made: Estimate) -> list[str]:
    hidden = made.base.no_effect
    return [f"Without effect on any motion: {', '.join(hidden)}."] if hidden else []


def _row(p: Parameter, formula: str, essential: bool | None) -> dict[str, Any]:
    """Numbers for sorting and downloads, texts for reading."""
    relative = p.relative_se
    return {
        "name": p.name,
        "symbol": parameter(p.name),
        "value": p.value,
        "low": _finite(p.interval[0]),
        "high": _finite(p.interval[1]),
        "sd": _finite(p.se),
        "free": p.free,
        "relative": _finite(relative),
        "classical_se": _finite(p.classical_se),
        "unit": p.unit,
        "prior": None if p.prior is None else p.prior[0],
        "grouping": p.grouping,
        "formula": formula,
        "latex": "",
        "essential": essential,
        "weak": bool(relative > 50),
        "shown": {
            "value": f"{p.value:.4g}" if p.constrained_outside_ci else with_digits(p.value, p.se),
            "low": with_digits(p.interval[0], p.se),
            "high": with_digits(p.interval[1], p.se),
            "relative": "" if p.constrained_outside_ci else short_percent(p.se, p.value),
            "prior": "" if p.prior is None else with_digits(p.prior[0], p.se),
        },
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def correlation(made: Estimate) -> Chart:
    """How far deviations of two parameters go together."""
    names, R = made.base.names, made.correlation
    pairs = [(float(R[i, k]), names[i], names[k]) for i in range(len(R)) for k in range(i)]
    strong = sorted((pair for pair in pairs if abs(pair[0]) > STRONG), key=lambda pair: -abs(pair[0]))
    largest = max(pairs, key=lambda pair: abs(pair[0]), default=None)
    caption = (
        "One parameter alone."
        if largest is None
        else (
            f"The strongest correlation is {largest[0]:+.2f}, of {largest[1]} and {largest[2]}. "
            f"{len(strong)} of {len(pairs)} pairs are above {STRONG:g} in size"
            + (f": {', '.join(f'{a} and {b} ({r:+.2f})' for r, a, b in strong[:5])}." if strong else ".")
        )
    )
    drawing = {
        "kind": "heat",
        "rows": list(names),
        "columns": list(names),
        "ramp": "diverging",
        "low": -1,
        "high": 1,
        "unit": "",
        "square": True,
        "layers": [{"name": "correlation", "values": packed(R), "marks": []}],
    }
    alt = f"Map of the correlations of {len(names)} parameters' deviations, from -1 to 1."
    return Chart("correlation", "Correlation of the parameters", alt, caption, drawing)
