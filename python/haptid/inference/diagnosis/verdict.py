"""Verdict: fitness of an estimate for each use, from all findings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from haptid._internal.late import dataclass
from haptid.estimation import Estimate
from haptid.inference.diagnosis.finding import BODIES, NEGATIVE, Finding, Status, joined_names, worst
from haptid.uncertainty.figures import per_cent
from haptid.validation.validation import Validation, percent

# Relative torque error of a motor, per cent: up to the first the model is good for prediction, up to the second usable.
_CLOSE, ROUGH = 5.0, 20.0
# A parameter with a smaller relative standard error, per cent, can be quoted by itself.
QUOTABLE = 10.0
# What a finding that is not "ok" means for the user.
MEANING: Mapping[str, str] = MappingProxyType(
    {
        "units and signs": "the torque disagrees in size or sign with the device file's bodies",
        "moved from outside": "the torque holds the weight but does not move the bodies: a hand, or another, moves "
        "them, or the device file's inertia is far too large",
        "time delay": "torque and motion are not synchronous",
        "influence": "a single block of the log determines a parameter",
        "drift": "parameters change along the log",
        "friction near standstill": "the model lacks the change of dry friction near standstill",
        "friction by direction": "the model lacks a constant torque or direction-dependent dry friction",
        "viscosity by direction": "viscous friction depends on direction",
        "bent viscosity": "friction is not linear in velocity",
        "friction by load": "dry friction grows with the load torque",
        "torque by position": "the model lacks a position-dependent torque",
        "ripple": "a torque is periodic in position (cogging or teeth)",
        "excitation": "some parameters are poorly excited",
        "collinearity": "some parameters are nearly collinear",
        "errors in W": "noise or filtering of the positions biases parameters",
        "whiteness": "the residuals are not white (a term may be missing)",
    }
)
# Findings that matter for each use.
PREDICTION = ("units and signs", "moved from outside", "time delay", "influence", "drift")
COMPENSATION = (
    "friction near standstill",
    "friction by direction",
    "viscosity by direction",
    "bent viscosity",
    "friction by load",
    "torque by position",
    "ripple",
)
SINGLE_PARAMETERS = ("excitation", "collinearity", "errors in W", "whiteness")
# Those that are tests of the residuals, which a wrong channel makes as well.
_BY_RESIDUALS = ("time delay", "influence", "drift", *COMPENSATION, "errors in W", "whiteness")
# Reasons named for each use.
MOST = 3


@dataclass(frozen=True)
class Verdict:
    """Fitness of an estimate for each use.

    What to change is not in it: `haptid.advice` carries every change out before it is proposed.

    Attributes:
        torque: predicting the torque of motion like the log's.
        compensation: compensating friction and gravity.
        parameters: quoting single parameters.
        sentences: the same in words, one for each use; then whether unseen rows are missing.
        looks: for each sentence the names of the findings behind it.
    """

    torque: Status
    compensation: Status
    parameters: Status
    sentences: tuple[str, ...]
    looks: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        return " ".join(self.sentences)


@dataclass(frozen=True)
class ProvenChange:
    """A change of the study that is proven to be needed; until it is made, tests of the residuals name wrong causes.

    Attributes:
        words: what to do, an instruction.
        agreeing: names of findings that say the same as it, or as others proven with it.
    """

    words: str
    agreeing: frozenset[str]


@dataclass(frozen=True)
class Reason:
    """A reason for or against a use.

    Attributes:
        status: how grave.
        words: a clause.
        finding: behind it, if there is one.
        confirmed: whether it is a fact, and not only what residuals look like.
    """

    status: Status
    words: str
    finding: str = ""
    confirmed: bool = True


_WORDS: Mapping[Status, str] = {"ok": "good for", "doubt": "to be used with care for", "bad": "not fit for"}


def mild(reasons: Sequence[Reason]) -> list[Reason]:
    """No worse than "doubt": a prediction close to the measurement cannot be called bad."""
    return [reason if reason.status == "ok" else replace(reason, status="doubt") for reason in reasons]


def verdict(
    fitted: Estimate,
    errors: Validation,
    findings: Sequence[Finding],
    proven: ProvenChange | None = None,
    unproven: Collection[str] = (),
) -> Verdict:
    """The verdict on an estimate with these errors and findings.

    Args:
        fitted: the estimate.
        errors: its errors, of unseen rows if there are any.
        findings: of its diagnosis.
        proven: a change that takes the place of what residuals seem to be caused by without it.
        unproven: names of findings whose changes were tried, and predict unseen rows no better.
    """
    by_name = {finding.name: finding for finding in findings}

    def of(names: Sequence[str]) -> list[Reason]:
        return [_reason(by_name[name], name not in unproven) for name in names if name in by_name]

    size, precise, friction = _size(errors), _precision(fitted), of(COMPENSATION)
    silent = [*_unused(fitted), *_silent(errors), *_held(fitted, errors)]
    torque = [size, *silent, *_small(errors), *mild(of(PREDICTION))]
    compensation = [*torque, *(mild(friction) if size.status == "ok" else friction)]
    single = [precise, *silent, *of(PREDICTION), *friction, *of(SINGLE_PARAMETERS)]
    if proven is not None:
        torque, compensation, single = (_in_its_place(each, proven) for each in (torque, compensation, single))
    parts = (
        (_use("The model is", "predicting torque", torque, size), _looks(torque)),
        (_use("It is", "compensation of friction and gravity", compensation), _looks(compensation)),
        (_use("It is", "quoting single parameters", single, precise), _looks(single)),
        *((("Validate it on another log.", ()),) if errors.seen else ()),
    )
    sentences, looks = zip(*parts, strict=True)
    return Verdict(_worst(torque), _worst(compensation), _worst(single), sentences, looks)


def _in_its_place(reasons: Sequence[Reason], proven: ProvenChange) -> list[Reason]:
    """Reasons with a proven change, as grave as what is not a reason any more, in place of causes without it."""
    gone = [one for one in reasons if one.finding in _BY_RESIDUALS and one.finding not in proven.agreeing]
    words = f'the proven change "{proven.words}" is not made'
    measure, *others = (one for one in reasons if one not in gone)
    return [measure, Reason(worst(["doubt", *(one.status for one in gone)]), words), *others]


def _reason(finding: Finding, confirmed: bool) -> Reason:
    """A finding as a reason; no more than "doubt" where it is not confirmed."""
    status = finding.status if confirmed or finding.status == "ok" else "doubt"
    return Reason(status, _meaning(finding), finding.name, confirmed)


def _meaning(finding: Finding) -> str:
    """What a finding means; negative friction does not bear on the size of the torque."""
    negative = [name.removeprefix(NEGATIVE) for name in finding.figures if name.startswith(NEGATIVE)]
    if finding.name == "units and signs" and BODIES not in finding.sentence and negative:
        return f"{joined_names(negative)} of friction or rotors {'is' if len(negative) == 1 else 'are'} negative"
    return MEANING[finding.name]


def _worst(reasons: Sequence[Reason]) -> Status:
    return worst([reason.status for reason in reasons])


def _looks(reasons: Sequence[Reason]) -> tuple[str, ...]:
    """Findings behind the decisive reasons."""
    grade = _worst(reasons)
    return tuple(reason.finding for reason in reasons if reason.finding and reason.status == grade != "ok")


def _use(subject: str, use: str, reasons: Sequence[Reason], measured: Reason | None = None) -> str:
    """Fitness for a use, with the decisive reasons, and the measure for that use."""
    grade = _worst(reasons)
    text = f"{subject} {_WORDS[grade]} {use}"
    if grade == "ok":
        return f"{text}: {measured.words}." if measured else f"{text}."
    grave = [reason for reason in reasons if reason.status == grade]
    words = [reason.words for reason in grave if reason.confirmed]
    if looks := [reason.words for reason in grave if not reason.confirmed]:
        words.append(f"residuals look as where {joined_names(looks, most=2)}, which no change that was tried confirms")
    words, others = words[:MOST], len(words) - MOST
    if others > 0:
        words.append(f"{others} more {'reason' if others == 1 else 'reasons'}")
    text = f"{text}, because {joined_names(words)}"
    if measured is None or measured in grave:
        return f"{text}."
    return f"{text}{', though' if measured.status == 'ok' else ';'} {measured.words}."


def _size(errors: Validation) -> Reason:
    """The largest relative torque error of a motor that carries torque."""
    largest = errors.comparable.largest
    size: Status = "ok" if largest.relative <= _CLOSE else "doubt" if largest.relative <= ROUGH else "bad"
    kind = (
        "on the rows of the fit, which proves little"
        if errors.seen
        else "on unseen rows, all in motion"
        if errors.reference
        else "on unseen rows"
    )
    limits = f"limits {_CLOSE:g} and {ROUGH:g} %"
    return Reason(size, f"the torque error of {largest.label} is {per_cent(largest.relative)} ({kind}; {limits})")


def _unused(fitted: Estimate) -> list[Reason]:
    """Motors of which nothing is known because none of their rows is used."""
    names = [motor.label for motor in fitted.observation.motors if not motor.rows.any()]
    return [Reason("doubt", f"no row of {joined_names(names)} is used")] if names else []


def _silent(errors: Validation) -> list[Reason]:
    """Motors of which nothing is known because their channels hardly move."""
    names = [motor.label for motor in errors.comparable.silent]
    if not names:
        return []
    one = len(names) == 1
    words = f"{joined_names(names)} {'has' if one else 'have'} hardly any torque, of a channel that may be dead"
    return [Reason("doubt", words if one else words.replace("of a channel", "of channels"))]


def _held(fitted: Estimate, errors: Validation) -> list[Reason]:
    """Joints whose torque is not zero, against the word of the device file, or whose rows contradict the motors'."""
    contradicting = _contradicting(fitted)
    found = []
    for m in errors.comparable.motors:
        if not m.free or not m.rows or m.relative <= ROUGH:
            continue
        left = f"{per_cent(m.relative)} of its terms is left (limit {ROUGH:g} %)"
        words = (
            f"the rows of {m.label} contradict those of the motors: {left}, and {per_cent(contradicting[m.label])} by "
            "parameters of its own, as where the torque of a motor, a delay, a length or a term of the motors is wrong"
            if m.label in contradicting
            else f"the torque of {m.label} is not zero: {left}, as where a hand, a brake or a cable acts on it, or a "
            "term is missing"
        )
        found.append(Reason("doubt", words))
    return found


def _contradicting(fitted: Estimate) -> dict[str, float]:
    """What parameters of their own leave, per cent of the terms, of free joints whose rows fit by these alone."""
    found = {}
    for motor in fitted.observation.motors:
        if motor.free and motor.rows.any() and (size := motor.size(fitted.beta)):
            own = percent(motor.own_residual(fitted.beta), size)
            if percent(motor.residual(fitted.beta), size) > max(ROUGH, 2.0 * own) and own <= ROUGH:
                found[motor.label] = own
    return found


def _small(errors: Validation) -> list[Reason]:
    """Motors that carry hardly any torque, follow the model, and are predicted badly: named, as they do not decide."""
    found = errors.comparable
    named = [m for m, _ in found.small if m.relative > ROUGH and m not in found.silent]
    if not named:
        return []
    words = joined_names([f"{m.label} {per_cent(m.relative)}" for m in named])
    return [Reason("doubt", f"motors with hardly any torque have errors above {ROUGH:g} % ({words})")]


def _precision(fitted: Estimate) -> Reason:
    """How many parameters have a small standard error; none that the log does not tell."""
    count = len(fitted.free_parameters)
    good = [p.name for p in fitted.parameters if p.relative_se < QUOTABLE and p.excited]
    if len(good) == count:
        return Reason("ok", f"all {count} have standard errors below {QUOTABLE:g} %")
    if not good:
        return Reason("doubt", f"none of {count} has a standard error below {QUOTABLE:g} %")
    return Reason(
        "doubt", f"only {len(good)} of {count} have standard errors below {QUOTABLE:g} % ({joined_names(good)})"
    )
