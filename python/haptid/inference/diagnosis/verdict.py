"""What an estimate is good for, and what to do next: a few plain sentences from all findings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from haptid.estimation import Estimate
from haptid.inference.diagnosis.finding import Finding, Status, listed, worst
from haptid.inference.diagnosis.messages import PLAIN
from haptid.validation.validation import Validation

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
# Reasons named for each use, and things to do.
MOST = 3


@dataclass(frozen=True)
class Verdict:
    """What an estimate is good for.

    Attributes:
        torque: predicting torque of motion like the log's.
        compensation: cancelling friction and gravity.
        parameters: quoting single parameters.
        sentences: the same in words, one for each use, then what to do next.
        looks: for each sentence the names of the findings that it rests on.
    """

    torque: Status
    compensation: Status
    parameters: Status
    sentences: tuple[str, ...]
    looks: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        return " ".join(self.sentences)


@dataclass(frozen=True)
class Reason:
    """What speaks for or against a use, in plain words; the finding that says so, where it is one."""

    status: Status
    words: str
    look: str = ""


WORDS: Mapping[Status, str] = {"ok": "good for", "doubt": "to be used with care for", "bad": "not fit for"}


def mild(reasons: Sequence[Reason]) -> list[Reason]:
    """Doubts where there are any: a prediction close to what was measured cannot be called bad."""
    return [reason if reason.status == "ok" else replace(reason, status="doubt") for reason in reasons]


def verdict(made: Estimate, errors: Validation, findings: Sequence[Finding]) -> Verdict:
    """Of an estimate, its errors and all findings."""
    by_name = {finding.name: finding for finding in findings}

    def of(names: Sequence[str]) -> list[Reason]:
        return [Reason(by_name[name].status, PLAIN[name], name) for name in names if name in by_name]

    size, told, friction = _size(errors), _told(made), of(COMPENSATION)
    torque = [size, *mild(of(PREDICTION))]
    compensation = [*torque, *(mild(friction) if size.status == "ok" else friction)]
    single = [told, *of(PREDICTION), *friction, *of(SINGLE)]
    said = (
        (_use("The model is", "predicting torque", torque, size), _looks(torque)),
        (_use("It is", "compensation of friction and gravity", compensation), _looks(compensation)),
        (_use("It is", "quoting single parameters", single, told), _looks(single)),
        *_next(findings, errors),
    )
    sentences, looks = zip(*said, strict=True)
    return Verdict(_worst(torque), _worst(compensation), _worst(single), sentences, looks)


def _worst(reasons: Sequence[Reason]) -> Status:
    return worst([reason.status for reason in reasons])


def _looks(reasons: Sequence[Reason]) -> tuple[str, ...]:
    """Findings behind the gravest reasons."""
    grade = _worst(reasons)
    return tuple(reason.look for reason in reasons if reason.look and reason.status == grade != "ok")


def _use(subject: str, use: str, reasons: Sequence[Reason], measured: Reason | None = None) -> str:
    """What the model is for a use, because of the gravest reasons, beside what was measured for that use."""
    grade = _worst(reasons)
    text = f"{subject} {WORDS[grade]} {use}"
    if grade == "ok":
        return f"{text}: {measured.words}." if measured else f"{text}."
    grave = [reason for reason in reasons if reason.status == grade]
    words, more = [reason.words for reason in grave[:MOST]], len(grave) - MOST
    if more > 0:
        words.append(f"{more} more {'reason' if more == 1 else 'reasons'}")
    text = f"{text}, because {listed(words)}"
    if measured is None or measured in grave:
        return f"{text}."
    return f"{text}{', though' if measured.status == 'ok' else ';'} {measured.words}."


def _size(errors: Validation) -> Reason:
    """How much of the torque the model misses."""
    largest = max(errors.motors, key=lambda motor: motor.relative)
    size: Status = "ok" if largest.relative <= CLOSE else "doubt" if largest.relative <= ROUGH else "bad"
    kind = "on the rows of the fit, which proves little" if errors.seen else "on unseen rows"
    limits = f"limits {CLOSE:g} and {ROUGH:g} %"
    return Reason(size, f"{largest.relative:.2g} % of the torque of {largest.label} is missed ({kind}; {limits})")


def _told(made: Estimate) -> Reason:
    """How many parameters are told well."""
    good, many = [p.name for p in made.parameters if p.relative_se < QUOTABLE], len(made.kept)
    if len(good) == many:
        return Reason("ok", f"all {many} have deviations below {QUOTABLE:g} %")
    if not good:
        return Reason("doubt", f"none of {many} has a deviation below {QUOTABLE:g} %")
    return Reason("doubt", f"only {len(good)} of {many} have deviations below {QUOTABLE:g} % ({listed(good)})")


def _next(findings: Sequence[Finding], errors: Validation) -> Iterator[tuple[str, tuple[str, ...]]]:
    """The most urgent things to do, where there are any; a validation where there was none."""
    ranked = sorted((finding for finding in findings if finding.status != "ok"), key=_rank)
    for k, finding in enumerate(ranked[:MOST]):
        yield f"{'Then, if it is still there' if k else 'First'}: {finding.sentence}", (finding.name,)
    if errors.seen:
        yield "Validate it on another log.", ()


def _rank(finding: Finding) -> tuple[bool, bool, int, float]:
    """Causes before what only shows them, bad before doubtful, of misfits the surest."""
    name = "misfit" if finding.name in COMPENSATION else finding.name
    place = FIRST.index(name) if name in FIRST else len(FIRST)
    return (name not in FIRST, finding.status != "bad", place, float(finding.figures.get("p", 1.0)))
