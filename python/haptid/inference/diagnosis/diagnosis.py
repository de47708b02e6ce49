"""`diagnose(estimate)`: everything that can be asked of an estimate with its own rows, in sentences to act on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.inference.diagnosis import delay_test, distribution, exogeneity, lack_of_fit, plausibility
from haptid.inference.diagnosis.added_variable import Extra, Widened, device_rows, widen
from haptid.inference.diagnosis.excitation import collinearity, excitation
from haptid.inference.diagnosis.exogeneity import Instruments
from haptid.inference.diagnosis.finding import Finding, Status, worst
from haptid.inference.diagnosis.influence import drift, influence
from haptid.inference.diagnosis.places import places
from haptid.inference.diagnosis.residual import Residuals, residuals
from haptid.inference.diagnosis.ripple import ripple
from haptid.inference.diagnosis.serial import whiteness
from haptid.inference.diagnosis.subsample import portion, sentence
from haptid.inference.diagnosis.verdict import Verdict, verdict
from haptid.simulation import PID
from haptid.validation.validation import Validation, direct

# Per cent of every motor's torque below which a residual is rounding.
EXACT = 1e-8


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found of an estimate.

    Attributes:
        estimate: of which.
        validation: its errors on unseen rows; on those of the fit where none was given.
        findings: one for each look.
        left_out: a sentence for each look that these rows do not allow, and on how much of a long log was looked at.
    """

    estimate: Estimate
    validation: Validation
    findings: tuple[Finding, ...]
    left_out: tuple[str, ...]

    def __getitem__(self, name: str) -> Finding:
        """The finding of that name."""
        return next(finding for finding in self.findings if finding.name == name)

    @property
    def status(self) -> Status:
        """The worst of all findings."""
        return worst([finding.status for finding in self.findings])

    @cached_property
    def verdict(self) -> Verdict:
        """What the estimate is good for, and what to do next."""
        return verdict(self.estimate, self.validation, self.findings)

    def summary(self) -> str:
        """The verdict, then a line for each finding, the worst first."""
        width = max(len(finding.name) for finding in self.findings)
        order = {"bad": 0, "doubt": 1, "ok": 2}
        ranked = sorted(self.findings, key=lambda finding: order[finding.status])
        lines = [f"  {f.status:5s}  {f.name:{width}s}  {f.sentence}" for f in ranked]
        return "\n".join([*self.verdict.sentences, "", *lines, *(f"  -      {text}" for text in self.left_out)])


def diagnose(estimate: Estimate, validation: Validation | None = None, controller: PID | None = None) -> Diagnosis:
    """Look at an estimate from all sides; its observation holds the rows and the motions.

    Of a long log, what needs the rows again is asked of stretches spread over it (`portion`), which is said.

    Each look that is a test speaks up once in a hundred logs by chance (`finding.LEVEL`), serial correlation of the
    residual taken into account.

    Args:
        estimate: of any method.
        validation: its errors on unseen rows; the rows of the fit where None.
        controller: that moved the device, from which instruments are made; that of the method where None.

    Raises:
        HaptidError: as `observe` does where a motion no longer fits the device.
    """
    errors = validation or direct(estimate)
    motion = (excitation(estimate), collinearity(estimate))
    if max(motor.relative for motor in direct(estimate).motors) < EXACT:
        return Diagnosis(estimate, errors, motion, ("The model fits to rounding: no residual is left to look at.",))
    part = portion(estimate)
    # A long log is not simulated as a whole.
    calm = exogeneity.instruments(part, controller) if part is estimate else exogeneity.filtered(part)
    findings = (*motion, *_on_rows(part, calm), influence(estimate), drift(estimate))
    said = () if part is estimate else (sentence(estimate, part),)
    return Diagnosis(estimate, errors, findings, (*said, *_left_out(part, calm)))


def _on_rows(estimate: Estimate, calm: Instruments) -> Iterator[Finding]:
    """Findings that need the rows again."""
    left = residuals(estimate)
    rows = device_rows(estimate)
    yield whiteness(estimate, left)
    yield distribution.normality(left)
    yield distribution.spread(left, left.velocity[rows])
    yield from _tested(estimate, left, calm)
    yield ripple(places(estimate.model, rows), left, rows)


def _tested(estimate: Estimate, left: Residuals, calm: Instruments) -> Iterator[Finding]:
    """Findings of fits with more columns, all columns made in one walk over the samples."""
    model, chi = estimate.model, raw_parameters(estimate.model, estimate.beta)
    rows = device_rows(estimate)
    spots, labels = places(model, rows), left.labels
    groups: dict[str, list[Extra]] = {}
    for shape in lack_of_fit.SHAPES:
        for k, place in enumerate(spots):
            groups[f"{shape.name} {k}"] = list(lack_of_fit.extras(shape, place, left))
    bodies = plausibility.known(model)
    if _accelerated(estimate):
        groups["late"] = list(delay_test.rates(model, rows))
        groups["known"] = list(plausibility.expected(model, rows, bodies)) if bodies else []
    if (pairs := calm.pairs(estimate.observation.motions)) is not None:
        groups["errors"] = list(exogeneity.errors_in_columns(model, rows, chi, pairs))
    widened, places_of = _widen(estimate, groups)
    names = [shape.name for shape in lack_of_fit.SHAPES]
    looks = [
        lack_of_fit.shadowed(widened, {name: lack_of_fit.look(widened, places_of[f"{name} {k}"]) for name in names})
        for k in range(len(spots))
    ]
    for shape in lack_of_fit.SHAPES:
        yield lack_of_fit.misfit(shape, spots, [at[shape.name] for at in looks])
    if "late" in groups:
        yield delay_test.late(widened, places_of["late"], labels)
    if "errors" in groups:
        yield exogeneity.exogeneity(widened, places_of["errors"], labels, calm)
    factors = (
        plausibility.factors(widened, places_of["known"], bodies, labels) if groups.get("known") and bodies else ()
    )
    yield plausibility.suspicion(estimate, factors)


def _widen(estimate: Estimate, groups: dict[str, list[Extra]]) -> tuple[Widened, dict[str, list[int]]]:
    """All extras at once, and which of them belong to which group."""
    every: list[Extra] = []
    at: dict[str, list[int]] = {}
    for name, extras in groups.items():
        at[name] = list(range(len(every), len(every) + len(extras)))
        every += extras
    return widen(estimate, every), at


def _accelerated(estimate: Estimate) -> bool:
    """Whether every row is made with accelerations."""
    return not any(motion.treatment.momentum for motion in estimate.observation.motions)


def _left_out(estimate: Estimate, calm: Instruments) -> Iterator[str]:
    """What these rows do not allow to be asked."""
    if not _accelerated(estimate):
        yield "Not asked, for want of accelerations: the torque's delay, its size beside the device file's bodies."
    if None in calm.motions:
        yield "Not asked: errors in W. There is no log, or no room for a narrower filter of its positions."
