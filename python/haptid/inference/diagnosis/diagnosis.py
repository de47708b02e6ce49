"""`diagnose(estimate)`: regression diagnostics of an estimate on its own rows, with recommendations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from haptid._internal.blas_threads import on_one_blas_thread
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.errors import index_of
from haptid.estimation import Estimate, MotorSide
from haptid.inference.diagnosis import delay_test, exogeneity, lack_of_fit, plausibility
from haptid.inference.diagnosis.added_variable import AugmentedRows, augment, device_rows
from haptid.inference.diagnosis.excitation import collinearity, excitation
from haptid.inference.diagnosis.exogeneity import Instruments
from haptid.inference.diagnosis.finding import ORDER, Finding, Status, worst
from haptid.inference.diagnosis.influence import influence, parameter_drift
from haptid.inference.diagnosis.limit_cycle import limit_cycle
from haptid.inference.diagnosis.play import transmission_play
from haptid.inference.diagnosis.residuals import Residuals, heteroscedasticity, normality, residuals, whiteness
from haptid.inference.diagnosis.rigid_range import FrequencyRange, frequency_ranges, rigid_range
from haptid.inference.diagnosis.subsample import sentence, subsample
from haptid.inference.diagnosis.torque_faults import torque_faults
from haptid.inference.diagnosis.torsion import torsion_findings
from haptid.inference.diagnosis.verdict import Verdict, verdict
from haptid.observation.augmented import CandidateColumns, torque_rates
from haptid.observation.observation import Observation
from haptid.simulation import PID
from haptid.validation.validation import Validation, fit_errors

# Relative residual of every motor, per cent, below which it is rounding error.
_EXACT = 1e-8


@displayed
@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Findings on an estimate.

    Attributes:
        estimate: diagnosed.
        validation: its errors on unseen rows; on those of the fit where none was given.
        findings: one for each diagnostic.
        left_out: sentences on diagnostics that these rows do not permit, and on the subsample of a long log.
        ranges: measured over predicted torque by frequency, of every motor; none where the rows are too few.
    """

    estimate: Estimate
    validation: Validation
    findings: tuple[Finding, ...]
    left_out: tuple[str, ...]
    ranges: tuple[FrequencyRange, ...] = ()

    def __getitem__(self, name: str) -> Finding:
        """The finding of that name; an `UnknownNameError` where there is none."""
        return self.findings[index_of(name, [finding.name for finding in self.findings], "finding")]

    @property
    def status(self) -> Status:
        """The worst of all findings."""
        return worst([finding.status for finding in self.findings])

    @cached_property
    def verdict(self) -> Verdict:
        """Fitness for each use, and what to do next."""
        return verdict(self.estimate, self.validation, self.findings)

    @property
    def _ranked(self) -> list[Finding]:
        """The findings, the worst first."""
        return sorted(self.findings, key=lambda finding: -ORDER.index(finding.status))

    def summary(self) -> str:
        """The verdict, then a line for each finding, the worst first."""
        width = max(len(finding.name) for finding in self.findings)
        lines = [f"  {f.status:5s}  {f.name:{width}s}  {f.sentence}" for f in self._ranked]
        return "\n".join([*self.verdict.sentences, "", *lines, *(f"  -      {text}" for text in self.left_out)])

    def _shown(self) -> Overview:
        rows = [[finding.name, finding.status, finding.sentence] for finding in self._ranked]
        return Overview(f"Diagnosis: {self.status}", ("check", "status", "finding"), rows, self.verdict.sentences)


@on_one_blas_thread
def diagnose(estimate: Estimate, validation: Validation | None = None, controller: PID | None = None) -> Diagnosis:
    """Diagnose an estimate: excitation, residuals, missing terms, delay, errors in variables, influence, drift.

    Every test has significance level 0.01 (`finding.SIGNIFICANCE`), with serial correlation of the residuals taken
    into account. Of a long log, tests that must compute rows again use a subsample of its blocks, and say so.

    Args:
        estimate: of any method; its observation holds the rows and the motions.
        validation: its errors on unseen rows; the rows of the fit where None.
        controller: that moved the device, from which instruments are made; that of the method where None.

    Raises:
        HaptidError: as `observe` does where a motion no longer fits the device.
    """
    whole, errors, estimate = estimate, validation or fit_errors(estimate), _of_motors_with_rows(estimate)
    motion = (excitation(estimate), collinearity(estimate))
    if max(motor.relative for motor in fit_errors(estimate).motors) < _EXACT:
        return Diagnosis(whole, errors, motion, ("The model fits to rounding error: there are no residuals to test.",))
    part = subsample(estimate)
    # A long log is not simulated as a whole.
    instruments = exogeneity.instruments(part, controller) if part is estimate else exogeneity.filtered_columns(part)
    left = residuals(part)
    ranges = frequency_ranges(part, left)
    on_rows = (*_on_rows(part, instruments, left), rigid_range(ranges))
    loose = transmission_play(estimate)
    swinging = limit_cycle(estimate)
    on_rows = (*on_rows, *((loose,) if loose else torsion_findings(estimate)), *((swinging,) if swinging else ()))
    findings = (*motion, torque_faults(estimate), *on_rows, influence(estimate), parameter_drift(estimate))
    sentences = () if part is estimate else (sentence(estimate, part),)
    return Diagnosis(whole, errors, findings, (*sentences, *_left_out(part, instruments)), ranges)


def _of_motors_with_rows(estimate: Estimate) -> Estimate:
    """The estimate without motors of which no row is used, about which residuals say nothing."""
    kept = [k for k, motor in enumerate(estimate.observation.motors) if motor.rows.any()]
    if len(kept) == len(estimate.observation.motors):
        return estimate
    fit = estimate.fit
    noise = None if fit.noise is None else [fit.noise[k] for k in kept]
    fit = replace(fit, observation=_some(fit.observation, kept), weights=fit.weights[kept], noise=noise)
    return replace(estimate, observation=_some(estimate.observation, kept), weights=estimate.weights[kept], fit=fit)


def _some(observation: Observation, kept: Sequence[int]) -> Observation:
    """The observation of some motors."""
    return replace(observation, motors=tuple(observation.motors[k] for k in kept))


def _on_rows(estimate: Estimate, instruments: Instruments, left: Residuals) -> Iterator[Finding]:
    """Findings on single rows."""
    rows = device_rows(estimate)
    yield whiteness(estimate, left)
    yield normality(left, left.velocity[rows])
    yield heteroscedasticity(left, left.velocity[rows])
    yield from _added_variables(estimate, left, instruments)
    yield lack_of_fit.ripple(lack_of_fit.friction_coordinates(estimate.model, rows), left, rows)


def _added_variables(estimate: Estimate, left: Residuals, instruments: Instruments) -> Iterator[Finding]:
    """Findings of fits with candidate columns, which are all computed in one pass over the samples."""
    model, chi = estimate.model, raw_parameters(estimate.model, estimate.beta)
    rows, labels, terms = device_rows(estimate), left.labels, lack_of_fit.CANDIDATES
    places = lack_of_fit.friction_coordinates(model, rows)
    groups: dict[str, tuple[CandidateColumns, ...]] = {}
    for term in terms:
        for k, place in enumerate(places):
            groups[f"{term.name} {k}"] = lack_of_fit.columns_at(term, place, left)
    bodies = plausibility.prior_bodies(model)
    driven = [k for k, row in enumerate(rows) if model.device.measured[row]]
    simulated = isinstance(estimate.method, MotorSide)
    if _has_accelerations(estimate) and not simulated:
        groups["delay"] = torque_rates(model, [rows[k] for k in driven])
    if _has_accelerations(estimate):
        groups["bodies"] = plausibility.prior_torque(model, rows, bodies) if bodies else ()
    if (pairs := instruments.pairs(estimate.observation.motions)) is not None:
        groups["errors"] = exogeneity.unexplained_columns(model, rows, chi, pairs)
    augmented, candidates_of = _augmented(estimate, groups)
    every = {(term.name, k): candidates_of[f"{term.name} {k}"] for k in range(len(places)) for term in terms}
    alternatives, tests = lack_of_fit.term_tests(augmented, every), []
    for k in range(len(places)):
        own = {term.name: alternatives[term.name, k] for term in terms}
        tests.append(lack_of_fit.mark_redundant(augmented, own))
    for term in terms:
        yield lack_of_fit.missing_term(term, places, [by_term[term.name] for by_term in tests])
    if "delay" in groups:
        yield delay_test.time_delay(augmented, candidates_of["delay"], [labels[k] for k in driven])
    elif simulated:
        text = "The torque's delay is not tested: the simulated links hold the delay that they were simulated with."
        yield Finding("time delay", "ok", {}, text)
    if "errors" in groups:
        yield exogeneity.exogeneity(augmented, candidates_of["errors"], labels, instruments)
    known = bodies and groups.get("bodies")
    outside = (
        plausibility.moved_from_outside(augmented, candidates_of["bodies"], bodies, labels)
        if bodies and known
        else None
    )
    if outside:
        yield outside
    compared = bodies if known and not outside else None
    scales = plausibility.torque_scales(augmented, candidates_of["bodies"], compared, labels) if compared else ()
    yield plausibility.units_and_signs(estimate, scales)


def _augmented(
    estimate: Estimate, groups: Mapping[str, tuple[CandidateColumns, ...]]
) -> tuple[AugmentedRows, dict[str, list[int]]]:
    """The rows with all candidates, and which of these belong to which group."""
    every: list[CandidateColumns] = []
    candidates_of: dict[str, list[int]] = {}
    for name, candidates in groups.items():
        candidates_of[name] = list(range(len(every), len(every) + len(candidates)))
        every += candidates
    return augment(estimate, every), candidates_of


def _has_accelerations(estimate: Estimate) -> bool:
    """Whether every row is made with accelerations."""
    return not any(motion.treatment.momentum for motion in estimate.observation.motions)


def _left_out(estimate: Estimate, instruments: Instruments) -> Iterator[str]:
    """Diagnostics that these rows do not permit."""
    if not _has_accelerations(estimate):
        yield "Not tested, since there are no accelerations: the torque's delay, its size relative to the prior bodies."
    if None in instruments.motions:
        yield "Not tested: errors in W, since there is no log, or its position filter is as narrow as its motion."
