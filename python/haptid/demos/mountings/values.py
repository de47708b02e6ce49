"""Every figure of a demonstration, as JSON holds it."""

from __future__ import annotations

from typing import Any

from haptid.demos.mountings.columns import table2
from haptid.demos.mountings.finding import Results
from haptid.demos.mountings.fits import Fits, accuracy
from haptid.demos.mountings.judged import Judged
from haptid.demos.report import head


def values(found: Results) -> dict[str, Any]:
    """Every figure, as JSON holds it."""
    demo = found.demo
    return {
        **head(demo),
        "mountings": {key: _mounting(found, fits) for key, fits in found.fits.items()},
        "table2": table2(found),
        "published": {name: _judged(found, judged) for name, judged in found.published.items()},
        "comparisons": [
            {
                "first": pair.first,
                "second": pair.second,
                "differ": made.differs,
                "flipped": made.flipped,
                "p": dict(zip(made.names, made.holm.tolist(), strict=True)),
            }
            for pair, made in found.comparisons
        ],
        "hand": {"rms_errors": found.felt.errors, "inside_interval95": found.felt.inside},
        "tool": {
            name: {"value": value, "interval95": interval, "true": found.tool_truth.get(name)}
            for name, value, interval in zip(
                found.tool.names, found.tool.value.tolist(), found.tool.conf_int().tolist(), strict=True
            )
        },
    }


def _mounting(found: Results, fits: Fits) -> dict[str, Any]:
    """Of one mounting: treatment, fits, definiteness."""
    made: dict[str, Any] = {"reasons": fits.proposal.reasons, "fits": {}}
    for key, fit in fits.by.items():
        made["fits"][key] = {
            "title": fit.title,
            "status": fit.estimate.status,
            "condition": fit.estimate.observation.condition,
            "relative_error_percent": fit.relative,
            "relative_error_percent_all_rows": fit.relative_everywhere,
            "parameters": [
                {"name": p.name, "unit": p.unit, "value": p.value, "sd": p.se, "interval95": p.interval}
                for p in fit.targets.parameters
            ],
        }
        if key != "frictionless":
            near = accuracy(fit.targets, fits.encoders, found.demo.stretch.unseen)
            made["fits"][key]["against_truth"] = {
                "errors_percent": dict(zip(near.names, near.errors.tolist(), strict=True)),
                "inside_interval95": dict(zip(near.names, near.inside.tolist(), strict=True)),
                "torque_percent": near.torque.tolist(),
            }
    made["judged"] = {
        fit: _judged(found, judged) for (name, fit), judged in found.judged.items() if name == fits.mounting.key
    }
    return made


def _judged(found: Results, judged: Judged) -> dict[str, Any]:
    places = zip(found.demo.workspaces, judged.definite, strict=True)
    return {
        "definite": {p.name: {"least": d.smallest, "share_failing": d.share, "at": d.at.tolist()} for p, d in places},
        "possible": judged.possible.ok,
        "margin": judged.possible.margin,
        "failing": judged.possible.failing,
    }
