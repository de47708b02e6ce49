"""Provenance: files with their hashes, versions, settings, the command, papers to cite."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any, ClassVar

from haptid._core import __version__
from haptid._internal.late import dataclass
from haptid.estimation import PhysicallyConsistent
from haptid.report.citations import bibtex
from haptid.report.section import Section
from haptid.report.source import ReportSource
from haptid.results.tables import interval, treatment, weighting


@dataclass(frozen=True)
class ProvenanceSection(Section):
    """Provenance.

    Attributes:
        logs: for each log its path, SHA-256, role, samples, sampling period and notes.
        versions: of software, by name.
        settings: of treatment and estimate, by name.
        reasons: for the treatment.
        study: the study file.
        command: the command line that made the result.
        bibtex: of the methods used.
    """

    key: ClassVar[str] = "provenance"
    title: ClassVar[str] = "Provenance"
    logs: list[dict[str, Any]]
    versions: dict[str, str]
    settings: dict[str, str]
    reasons: list[str]
    study: str
    command: str
    bibtex: str

    @classmethod
    def of(cls, source: ReportSource) -> ProvenanceSection:
        identification = source.identification
        settings = {name: _text(value) for name, value in treatment(identification.proposal.treatment).items()}
        return cls(
            charts=(),
            logs=[_log(run) for run in identification.runs],
            versions={
                "haptid": __version__,
                "Python": platform.python_version(),
                **{name: version(name) for name in ("numpy", "scipy")},
            },
            settings={**settings, **_estimate(source)},
            reasons=list(identification.proposal.reasons),
            study=identification.study.path.read_text(encoding="utf-8") if identification.study.path.is_file() else "",
            command=source.command,
            bibtex=bibtex(source),
        )


def _log(run: Any) -> dict[str, Any]:
    read = run.motion.log
    return {
        "path": run.entry.path,
        "sha256": read.sha256 if read else "",
        "role": run.entry.role,
        "samples": len(read.t) if read else len(run.motion),
        "dt": run.motion.dt,
        "notes": list(read.notes) if read else [],
    }


def _estimate(source: ReportSource) -> dict[str, str]:
    estimate = source.estimate
    raw, scaled = estimate.observation.condition_without(estimate.zero)
    return {
        "method": weighting(estimate.method).name,
        "constraints": "physical" if isinstance(estimate.method, PhysicallyConsistent) else "none",
        "rows": str(estimate.observation.rows),
        "condition": f"{raw:.4g} raw, {scaled:.4g} with unit columns",
        "intervals": interval(estimate),
    }


def _text(value: Any) -> str:
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
