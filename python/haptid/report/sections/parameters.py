"""Parameters with confidence intervals, priors and regroupings, and the correlation of their errors."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from haptid._internal.late import dataclass
from haptid.dynamics.symbolic import Regroupings
from haptid.errors import HaptidError, RegroupingError
from haptid.estimation import Estimate, Parameter
from haptid.estimation.nonlinear import VariableProjection
from haptid.inference.elimination import eliminate as search
from haptid.inference.targets import targets
from haptid.report.chart import Chart, packed
from haptid.report.mathml import groupings, parameter
from haptid.report.section import Section
from haptid.report.source import ReportSource
from haptid.report.tables import UNEXCITED, between_cells, calibration_cells

# With more parameters backward elimination takes too long for a report.
MOST_SEARCHED = 60
# Correlations above this are listed.
_STRONG = 0.9


@dataclass(frozen=True)
class ParametersSection(Section):
    """Parameters.

    Attributes:
        rows: of the table, one for each base parameter: shown texts, sort keys and downloaded values.
        targets: the same for the targets of the device file.
        calibration: table of home offsets and of the direction of gravity; none where they are exact.
        between: table of scatter between logs, by base parameter; none with fewer than three logs.
        searched: constants that the torque is not linear in: name, value, ends of the interval, unit, all as text, and
            whether the log bounds them.
        symbols: values of the symbols in the formulas, "L1 = 0.215".
        about: sentences on intervals, regroupings and elimination.
    """

    key: ClassVar[str] = "parameters"
    title: ClassVar[str] = "Parameters"
    rows: list[dict[str, Any]]
    targets: list[dict[str, Any]]
    calibration: list[list[str]]
    between: list[list[str]]
    searched: list[dict[str, Any]]
    symbols: list[str]
    about: list[str]

    @classmethod
    def of(cls, source: ReportSource) -> ParametersSection:
        estimate, calibration = source.estimate, source.identification.calibration
        exact = _exact(estimate)
        regroupings = exact if isinstance(exact, Regroupings) else None
        formulas = groupings(estimate.base, regroupings)
        left, why = _left_out(estimate)
        rows = [
            _row(p, formula, None if left is None else k not in left)
            for k, (p, formula) in enumerate(zip(estimate.parameters, formulas, strict=True))
        ]
        for row, latex in zip(rows, regroupings.latex if regroupings else [""] * len(rows), strict=True):
            row["latex"] = latex
        return cls(
            charts=(correlation(estimate),),
            rows=rows,
            targets=[_row(p, "", None) for p in targets(estimate).parameters] if estimate.model.device.targets else [],
            calibration=calibration_cells(calibration) if calibration else [],
            between=_between(estimate),
            searched=_searched(source.identification.projection),
            symbols=[f"{s.name} = {s.value:.6g}" for s in regroupings.symbols] if regroupings else [],
            about=[
                *(() if all(row["excited"] for row in rows) else (UNEXCITED,)),
                *(calibration.sentences(estimate.model) if calibration else ()),
                *(gimbal.sentences if (gimbal := source.identification.gimbal) else ()),
                *(estimate.between_logs.sentences if estimate.between_logs else ()),
                why,
                *([exact] if isinstance(exact, str) else []),
                *_without_effect(estimate),
            ],
        )


def _exact(estimate: Estimate) -> Regroupings | str:
    """Symbolic regroupings, or the reason why there are none."""
    try:
        return estimate.model.regroupings
    except RegroupingError as error:
        return f"Regroupings are numeric: {error}"


def _left_out(estimate: Estimate) -> tuple[tuple[int, ...] | None, str]:
    """Indices of the parameters that can be eliminated, and the rule; None where it was not computed."""
    if estimate.zero and set(estimate.zero) <= set(estimate.single_block):
        return estimate.zero, "The log does not tell these parameters: they were left out of this fit, at zero."
    if estimate.zero:
        return estimate.zero, "Parameters that are not essential were eliminated from this fit: they are zero."
    if estimate.constrained_fit or len(estimate.beta) > MOST_SEARCHED:
        return None, "Essential parameters were not computed; use `haptid.eliminate`."
    try:
        left_out = search(estimate)
    except HaptidError as error:
        return None, f"Essential parameters are unknown: {error}"
    return left_out.reduced.zero, f"Parameters that are not essential can be eliminated. {left_out.reason}"


def _between(estimate: Estimate) -> list[list[str]]:
    """One row for each parameter; none with fewer than three logs."""
    between_logs = estimate.between_logs
    return [between_cells(between_logs, k) for k in range(len(estimate.beta))] if between_logs else []


def _searched(projection: VariableProjection | None) -> list[dict[str, Any]]:
    """One row for each nonlinear constant."""
    return [
        {
            "name": c.name,
            "value": f"{c.value:.4g}",
            "low": f"{c.conf_int()[0]:.3g}",
            "high": f"{c.conf_int()[1]:.3g}",
            "unit": c.unit,
            "uncertain": not c.bounded,
        }
        for c in (projection.constants if projection else ())
    ]


def _without_effect(estimate: Estimate) -> list[str]:
    hidden = estimate.base.no_effect
    return [f"Without effect on any motion: {', '.join(hidden)}."] if hidden else []


def _row(p: Parameter, formula: str, essential: bool | None) -> dict[str, Any]:
    """Numbers for sorting and downloads, and shown texts."""
    relative = p.relative_se
    return {
        "name": p.name,
        "symbol": parameter(p.name),
        "value": p.value,
        "low": _finite(p.conf_int()[0]),
        "high": _finite(p.conf_int()[1]),
        "se": _finite(p.se),
        "unconstrained": p.free,
        "relative": _finite(relative),
        "classical_se": _finite(p.classical_se),
        "unit": p.unit,
        "prior": None if p.prior is None else p.prior[0],
        "grouping": p.grouping,
        "formula": formula,
        "latex": "",
        "essential": essential,
        "excited": p.excited,
        "uncertain": bool(relative > 50) or not p.excited,
        "shown": {
            "value": p.cells.value,
            "interval": p.cells.interval.replace("..", "…"),
            "relative": p.cells.relative,
            "prior": p.cells.prior,
        },
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def correlation(estimate: Estimate) -> Chart:
    """Correlation of the errors of the parameters."""
    names, R = estimate.base.names, estimate.correlation
    pairs = [(float(R[i, k]), names[i], names[k]) for i in range(len(R)) for k in range(i)]
    strong = sorted((pair for pair in pairs if abs(pair[0]) > _STRONG), key=lambda pair: -abs(pair[0]))
    largest = max(pairs, key=lambda pair: abs(pair[0]), default=None)
    caption = (
        "A single parameter."
        if largest is None
        else (
            f"Largest correlation: {largest[0]:+.2f}, of {largest[1]} and {largest[2]}. "
            f"{len(strong)} of {len(pairs)} pairs are above {_STRONG:g} in absolute value"
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
    alt = f"Map of the correlations of the errors of {len(names)} parameters, from -1 to 1."
    return Chart("correlation", "Correlation of the parameters", alt, caption, drawing)
