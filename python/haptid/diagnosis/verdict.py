"""What an estimate is good for, and what to do next: a few plain sentences from all findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from haptid.diagnosis.finding import Finding, Status, listed, worst
from haptid.estimators import Estimate
from haptid.validation import Validation

# Per cent of a motor's torque that may be left: good for prediction, and of some use.
CLOSE, ROUGH = 5.0, 20.0
# A parameter with a smaller relative deviation, per cent, can be quoted by itself.
QUOTABLE = 10.0
# Findings that stand in the way of each use.
PREDICTION = ("units and signs", "time delay", "influence", "drift")
COMPENSATION = (
    "friction near standstill",
    "friction by direction",
    "viscosity by direction",
    "bent viscosity",
    "friction by load",
    "torque by position",
    "ripple",
)
SINGLE = ("excitation", "collinearity", "errors in W", "whiteness")
# What to do first: causes before what they cause.
FIRST = ("units and signs", "time delay", "errors in W", "misfit", "influence", "drift", "excitation", "collinearity")


@dataclass(frozen=True)
class Verdict:
    """What an estimate is good for.

    Attributes:
        torque: predicting torque of motion like the log's.
        compensation: cancelling friction and gravity.
        parameters: quoting single parameters.
        sentences: the same in words, then what to do next.
    """

    torque: Status
    compensation: Status
    parameters: Status
    sentences: tuple[str, ...]

    def __str__(self) -> str:
        return " ".join(self.sentences)


def mild(status: Status) -> Status:
    """A doubt where there is any: a prediction close to what was measured cannot be called bad."""
    return "ok" if status == "ok" else "doubt"


WORDS: Mapping[Status, str] = {"ok": "good for", "doubt": "to be used with care for", "bad": "not fit for"}


def verdict(made: Estimate, errors: Validation, findings: Sequence[Finding]) -> Verdict:
    """Of an estimate, its errors and all findings."""
    by_name = {finding.name: finding for finding in findings}

    def of(names: Sequence[str]) -> Status:
        return worst([by_name[name].status for name in names if name in by_name])

    largest = max(errors.motors, key=lambda motor: motor.relative)
    size: Status = "ok" if largest.relative <= CLOSE else "doubt" if largest.relative <= ROUGH else "bad"
    torque = worst([size, mild(of(PREDICTION))])
    friction = of(COMPENSATION)
    compensation = worst([torque, mild(friction) if size == "ok" else friction])
    good = [p.name for p in made.parameters if p.relative_sd < QUOTABLE]
    told: Status = "ok" if len(good) == len(made.kept) else "doubt"
    single = worst([told, of(PREDICTION), of(COMPENSATION), of(SINGLE)])
    kind = "on the rows of the fit, which proves little" if errors.seen else "on unseen rows"

    def see(names: Sequence[str]) -> str:
        open_ones = [name for name in names if name in by_name and by_name[name].status != "ok"]
        return f"; see {listed(open_ones)}" if open_ones else ""

    sentences = (
        f"The model is {WORDS[torque]} predicting torque: {largest.relative:.2g} % is left of {largest.label}, where "
        f"it is most, {kind} (limits {CLOSE:g} and {ROUGH:g} %){see(PREDICTION)}.",
        f"It is {WORDS[compensation]} compensation of friction and gravity{see(COMPENSATION)}.",
        f"It is {WORDS[single]} quoting single parameters: {_quotable(good, len(made.kept))}{see(SINGLE)}.",
        *_next(by_name, errors),
    )
    return Verdict(torque, compensation, single, sentences)


def _quotable(good: Sequence[str], many: int) -> str:
    """How many parameters are told well."""
    if len(good) == many:
        return f"all {many} have deviations below {QUOTABLE:g} %"
    if not good:
        return f"none of {many} has a deviation below {QUOTABLE:g} %"
    return f"{len(good)} of {many} have deviations below {QUOTABLE:g} % ({listed(good)})"


def _next(by_name: Mapping[str, Finding], errors: Validation) -> tuple[str, ...]:
    """The most urgent thing to do, where there is one; a validation where there was none."""
    ranked = sorted((finding for finding in by_name.values() if finding.status != "ok"), key=_rank)
    made = (f"First: {ranked[0].sentence}",) if ranked else ()
    return (*made, "Validate it on another log.") if errors.seen else made


def _rank(finding: Finding) -> tuple[bool, bool, int, float]:
    """Causes before what only shows them, bad before doubtful, of misfits the surest."""
    name = "misfit" if finding.name in COMPENSATION else finding.name
    place = FIRST.index(name) if name in FIRST else len(FIRST)
    return (name not in FIRST, finding.status != "bad", place, float(finding.figures.get("p", 1.0)))
