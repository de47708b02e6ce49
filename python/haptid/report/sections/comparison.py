"""Comparison of several results: errors, parameters, and significant differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.inference.comparison import Comparison, compare
from haptid.inference.diagnosis.finding import joined_names
from haptid.report.chart import COLOURS, Chart, figure, packed
from haptid.report.section import Shown
from haptid.results.result import Result

# Joint confidence level for all parameters of one pair of results.
CONFIDENCE = 0.95
# Largest change that is drawn, per cent of the first value.
WIDEST = 100.0


@dataclass(frozen=True)
class ComparisonSection(Shown):
    """Each later result compared with the first.

    Attributes:
        sentences: a sentence for each later result: how many parameters differ from the first's, and the errors.
        results: for each its name, study, device, method, logs, errors and whether its criterion is met.
        motors: labels of the errors.
        pairs: for each later result against the first what differs, in sentences, and a table by parameter.
    """

    key: ClassVar[str] = "comparison"
    title: ClassVar[str] = "Comparison"
    sentences: list[str]
    results: list[dict[str, Any]]
    motors: list[str]
    pairs: list[dict[str, Any]]

    @classmethod
    def between(cls, found: Sequence[Result], names: Sequence[str]) -> ComparisonSection:
        """Of two or more results.

        Raises:
            ModelMismatchError: a result has no parameter in common with the first.
        """
        comparisons = [compare(found[0], other, confidence=CONFIDENCE, independent=False) for other in found[1:]]
        pairs = [_pair(names[0], name, c) for name, c in zip(names[1:], comparisons, strict=True)]
        results = [_result(name, r) for name, r in zip(names, found, strict=True)]
        return cls(
            charts=(_chart(names, comparisons),),
            sentences=[_said(results[0], other, c) for other, c in zip(results[1:], comparisons, strict=True)],
            results=results,
            motors=list(found[0].model.device.row_labels),
            pairs=pairs,
        )


def _pair(first: str, second: str, comparison: Comparison) -> dict[str, Any]:
    rows = [
        {
            "name": name,
            "unit": comparison.units[k],
            "first": float(comparison.first[k]),
            "second": float(comparison.second[k]),
            "difference": float(comparison.difference[k]),
            "low": float(low),
            "high": float(high),
            "p": float(comparison.holm[k]),
            "differs": name in comparison.differs,
        }
        for k, (name, (low, high)) in enumerate(zip(comparison.names, comparison.conf_int(), strict=True))
    ]
    return {"first": first, "second": second, "sentences": list(comparison.sentences), "rows": rows}


def _said(first: Mapping[str, Any], other: Mapping[str, Any], comparison: Comparison) -> str:
    """Summary of a pair, in a sentence."""
    changed = f"{joined_names(comparison.differs)}; " if comparison.differs else ""
    kinds = ["unseen rows" if r["unseen"] else "the rows of the fit" for r in (first, other)]
    before, after = f"{first['relative']:.2f} % on {kinds[0]}", f"{other['relative']:.2f} % on {kinds[1]}"
    return (
        f"{other['name']} compared with {first['name']}: {len(comparison.differs)} of {len(comparison.names)} "
        f"parameters differ ({changed}{100 * comparison.confidence:g} % joint confidence). The error changes from "
        f"{before} to {after}."
    )


def _result(name: str, result: Result) -> dict[str, Any]:
    validations = result.unseen or result.fit_errors
    return {
        "name": name,
        "study": result.study,
        "device": result.model.device.name,
        "version": result.haptid,
        "method": result.estimate.method,
        "status": result.estimate.status,
        "met": result.criteria.met,
        "unseen": bool(result.unseen),
        "relative": max((v.comparable.relative for v in validations), default=float("nan")),
        "each": [max(v.comparable.motors[k].relative for v in validations) for k in range(len(validations[0].motors))],
        "logs": [{"path": log.path, "role": log.role, "sha256": log.sha256} for log in result.logs],
    }


def _chart(names: Sequence[str], comparisons: Sequence[Comparison]) -> Chart:
    """Changes in per cent of the first value, with the interval of each change."""
    rows = list(dict.fromkeys(name for c in comparisons for name in c.names))
    sets = [
        {"name": name, "colour": COLOURS[1 + k % (len(COLOURS) - 1)], **_changes(c, rows)}
        for k, (name, c) in enumerate(zip(names[1:], comparisons, strict=True))
    ]
    text = "; ".join(
        f"{name}: {len(c.differs)} of {len(c.names)} parameters differ"
        for name, c in zip(names[1:], comparisons, strict=True)
    )
    drawing = {"kind": "intervals", "rows": rows, "sets": sets, "unit": f"% of {names[0]}", "widest": WIDEST}
    caption = f"{text}. Bars: 95 % interval of each change, clipped at {figure(WIDEST)} %; filled marks: significant."
    alt = f"Change of every parameter from {names[0]}, with its interval."
    return Chart("changes", "Changes", alt, caption, drawing)


def _changes(comparison: Comparison, rows: Sequence[str]) -> dict[str, Any]:
    """Change and interval of each row, NaN where the result does not have it."""
    size = np.where(comparison.first == 0, np.nan, np.abs(comparison.first)) / 100
    places = [comparison.names.index(name) if name in comparison.names else -1 for name in rows]

    def spread(values: Array) -> Array:
        return np.array([values[k] if k >= 0 else np.nan for k in places])

    return {
        "value": packed(spread(comparison.difference / size)),
        "low": packed(spread(comparison.conf_int()[:, 0] / size)),
        "high": packed(spread(comparison.conf_int()[:, 1] / size)),
        "differs": [name in comparison.differs for name in rows],
    }
