"""Is the model good enough, for what, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from haptid.inference.diagnosis import Finding
from haptid.report.section import Section
from haptid.report.source import Source

USES = (
    ("Predicting torque", "torque"),
    ("Compensating friction and gravity", "compensation"),
    ("Quoting single parameters", "parameters"),
)
WORDS = {"ok": "good", "doubt": "with care", "bad": "not fit"}


@dataclass(frozen=True)
class VerdictSection(Section):
    """The verdict.

    Attributes:
        criterion: whether the study's own criterion is met, as a sentence; empty where it has none.
        met: the same as a value.
        uses: for each use its name, status and word.
        sentences: of the verdict, one for each use.
        next: what to do next, in sentences; none where nothing is in doubt.
        looks: for each of `sentences`, then of `next`, the names of the findings behind it.
        findings: for each look its name, status and sentence, the worst first.
        left_out: sentences for looks that these rows do not allow.
        notes: sentences that go with the estimate.
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
    def of(cls, source: Source) -> VerdictSection:
        made, found = source.diagnosis, source.identification
        statuses = [(name, getattr(made.verdict, of)) for name, of in USES]
        return cls(
            charts=(),
            criterion=_criterion(source),
            met=found.meets_criteria,
            uses=[{"name": name, "status": status, "word": WORDS[status]} for name, status in statuses],
            sentences=list(made.verdict.sentences[: len(USES)]),
            next=list(made.verdict.sentences[len(USES) :]),
            looks=[list(names) for names in made.verdict.looks],
            findings=[_plain(finding) for finding in sorted(made.findings, key=_rank)],
            left_out=list(made.left_out),
            notes=list(source.estimate.notes),
        )


def _criterion(source: Source) -> str:
    """What the study asked for, and whether it got it."""
    found, worst = source.identification, source.validation
    if worst is None:
        return "No unseen rows: this fit is not validated. Give the study a log with role 'validate', or a [holdout]."
    text = f"On rows that its fit had not seen the model misses {worst.relative:.2f} % of the torque at worst."
    if found.meets_criteria is None:
        return text
    return f"{text} The study allows {found.study.largest_error:g} %: {'met' if found.meets_criteria else 'not met'}."


def _rank(finding: Finding) -> int:
    return ("bad", "doubt", "ok").index(finding.status)


def _plain(finding: Finding) -> dict[str, str]:
    return {"name": finding.name, "status": finding.status, "sentence": finding.sentence}
