"""Verdict: fitness of the model for each use, findings of the diagnosis, and next steps."""

from __future__ import annotations

from typing import ClassVar

from haptid._internal.late import dataclass
from haptid.inference.diagnosis import Finding
from haptid.report.section import Section
from haptid.report.source import ReportSource, criterion

USES = (
    ("Predicting torque", "torque"),
    ("Compensating friction and gravity", "compensation"),
    ("Quoting single parameters", "parameters"),
)
_WORDS = {"ok": "good", "doubt": "with care", "bad": "not fit"}


@dataclass(frozen=True)
class VerdictSection(Section):
    """Verdict of the diagnosis.

    Attributes:
        criterion: whether the study's criterion is met, as a sentence.
        met: the same as a value; None without a criterion.
        uses: for each use its name, status and wording.
        sentences: of the verdict, one for each use.
        next: changes that were tried on the data, with their proofs, by gain; what cannot be determined.
        looks: for each of `sentences` the names of the findings it is based on.
        findings: for each check its name, status and sentence, the worst first.
        left_out: sentences on checks that are not possible with these rows.
        notes: notes of the estimate.
    """

    key: ClassVar[str] = "verdict"
    title: ClassVar[str] = "Verdict"
    criterion: str
    met: bool | None
    uses: list[dict[str, str]]
    sentences: list[str]
    next: list[str]
    looks: list[list[str]]
    findings: list[dict[str, str]]
    left_out: list[str]
    notes: list[str]

    @classmethod
    def of(cls, source: ReportSource) -> VerdictSection:
        diagnosis, identification = source.diagnosis, source.identification
        statuses = [(name, getattr(source.verdict, attribute)) for name, attribute in USES]
        return cls(
            charts=(),
            criterion=criterion(source.identification),
            met=identification.meets_criteria,
            uses=[{"name": name, "status": status, "word": _WORDS[status]} for name, status in statuses],
            sentences=list(source.verdict.sentences[: len(USES)]),
            next=[*source.verdict.sentences[len(USES) :], *source.advice.sentences],
            looks=[list(names) for names in source.verdict.looks[: len(USES)]],
            findings=[_plain(finding) for finding in sorted(diagnosis.findings, key=_rank)],
            left_out=list(diagnosis.left_out),
            notes=[identification.use.reason, *source.estimate.notes],
        )


def _rank(finding: Finding) -> int:
    return ("bad", "doubt", "ok").index(finding.status)


def _plain(finding: Finding) -> dict[str, str]:
    return {"name": finding.name, "status": finding.status, "sentence": finding.sentence}
