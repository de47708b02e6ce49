"""`identify`: carry out a study, from its logs to an estimate and its validation on unseen rows."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

from haptid._internal.blas_threads import on_one_blas_thread
from haptid._internal.bounded_files import BASE_PARAMETERS
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.errors import EstimationError, NoRowsError, SharedRowsError
from haptid.estimation import Estimate, MotorSide
from haptid.estimation.methods.motor_noise import with_noise_uncertainty
from haptid.estimation.nonlinear import VariableProjection
from haptid.estimation.nonlinear.load_friction import fit_nonlinear_constants
from haptid.executors import Executor
from haptid.inference.frequency_response import FrequencyResponse, Spring, response_of_motors
from haptid.inference.gimbal import GimbalEffect, gimbal_effect
from haptid.log import Log, is_long, log_size, open_log, read_log, same_samples
from haptid.motion.motion import Motion, treat
from haptid.motion.treatment import Treatment
from haptid.observation.batch import observe_all
from haptid.observation.cache import RFactorCache
from haptid.observation.known_payload import log_without_payload
from haptid.observation.observation import Observation, concatenated
from haptid.study import LogEntry, Study
from haptid.study.held_out import held_out
from haptid.study.partial_estimate import told_estimate
from haptid.study.schema import fault
from haptid.study.still_joints import naming_still_joints, refuse_held_joints
from haptid.study.study import silent
from haptid.treatment_choice.calibration import Calibration, find_calibration
from haptid.treatment_choice.elasticity import expect_elasticity, expect_fast_sampling, with_bounds
from haptid.treatment_choice.hidden_joints import complete_logs, lacks_links
from haptid.treatment_choice.motor_delays import with_motor_delays
from haptid.treatment_choice.propose import Proposal, propose
from haptid.treatment_choice.uncertainty import with_treatment_uncertainty
from haptid.validation.model_for_use import ModelForUse, model_for_use
from haptid.validation.motor_torques import MotorShare, motor_shares
from haptid.validation.validation import Validation, fit_errors, validate

_Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Run:
    """One log of a study, its observation and validations.

    Attributes:
        entry: the study's entry.
        observation: its rows.
        reference: all its rows behind the reference filter; None where errors are not compared on them.
        fit_errors: errors of the model for use on the rows of its fit; None of a validation log.
        unseen: out-of-sample errors of the model for use: of the final one for a validation log, of each fold's own in
            cross-validation.
        motors: torques of redundant motors by the model for use; empty where they are not redundant.
    """

    entry: LogEntry
    observation: Observation
    reference: Observation | None = None
    fit_errors: Validation | None = None
    unseen: tuple[Validation, ...] = ()
    motors: tuple[MotorShare, ...] = ()

    @property
    def motion(self) -> Motion:
        return self.observation.motions[0]


@displayed
@dataclass(frozen=True)
class Identification:
    """A study carried out.

    Attributes:
        model: the dynamic model, at the nonlinear constants that were found.
        proposal: treatment of the logs, with reasons.
        estimate: from all logs with role "identify", from which parameters and intervals are quoted.
        use: the model for use, chosen on the same rows: it predicts, and is validated and exported.
        runs: one for each log.
        gimbal: largest effect of an unmeasured gimbal; None where the device has none.
        projection: the nonlinear constants as found by variable projection, None where the device has none.
        calibration: home offsets and the direction of gravity, to which the logs are corrected; None where the study
            takes them as exact.
        response: frequency response of elastic motors whose links were not measured, from logs of a motion that
            repeats; None where there are none.
    """

    study: Study
    model: DynamicModel
    proposal: Proposal
    estimate: Estimate
    use: ModelForUse
    runs: tuple[Run, ...]
    projection: VariableProjection | None = None
    calibration: Calibration | None = None
    gimbal: GimbalEffect | None = None
    response: FrequencyResponse | None = None

    @property
    def unseen(self) -> tuple[Validation, ...]:
        """Every out-of-sample validation."""
        return tuple(v for run in self.runs for v in run.unseen)

    @property
    def meets_criteria(self) -> bool | None:
        """Whether every out-of-sample error is within the study's criterion; None where it has none."""
        limit = self.study.largest_error
        if limit is None:
            return None
        return bool(self.unseen) and all(v.comparable.relative <= limit for v in self.unseen)

    def _shown(self) -> Overview:
        shown = self.estimate._shown()
        errors = [
            f"{run.entry.path}, unseen: {v.comparable.relative:.2f} %{' of all rows in motion' if v.reference else ''}"
            for run in self.runs
            for v in run.unseen
        ]
        title = f"Identification {self.study.name}: {self.model.device.name}, {self.estimate.method.name}"
        return Overview(title, shown.headings, shown.rows, (*errors, self.use.reason))


@on_one_blas_thread
def identify(
    study: Study,
    data: str | Path | None = None,
    progress: _Progress | None = None,
    workers: Executor | None = None,
    cache: RFactorCache | None = None,
) -> Identification:
    """Read and treat the logs of a study, observe, estimate and validate.

    Args:
        study: to carry out.
        data: where the study's relative log paths start; the study's own folder where None.
        progress: called with the name of a step and the share of it done; details follow a colon in the name.
        workers: executor that reduces the logs to R factors; this process where None.
        cache: of the R factors of long logs, from which an interrupted run resumes; none where None.

    Raises:
        HaptidError: any error of the steps.
    """
    progress = progress or silent
    check_kind(study)
    as_filed = DynamicModel(read_device(study.device))
    _check_size(as_filed)
    study = study.on(as_filed.device)
    folder = Path(data or study.path.parent)
    together = sum(log_size(path) for entry in study.logs if os.path.exists(path := folder / entry.path))
    logs = [read_entry(entry, folder, progress, together) for entry in study.logs]
    refuse_copies(study, logs)
    expect_fast_sampling(as_filed, logs)
    study, logs, response = _completed(study, as_filed, logs, progress)
    refuse_held_joints(as_filed, logs, study)
    progress("choosing a treatment", 0.0)
    with naming_still_joints(as_filed, logs, study):
        proposal = propose(as_filed, *logs_to_propose_from(study, logs), **study.treatment)
    proposal = replace(proposal, reasons=(*proposal.reasons, *proposal.slower(logs)))
    progress("choosing a treatment", 1.0)
    logs = [
        _unloaded(as_filed, log, proposal.carried_by(log), entry) for log, entry in zip(logs, study.logs, strict=True)
    ]
    calibration, logs = _calibrated(study, as_filed, logs, proposal, progress)
    motions = [_treat(log, proposal.carried_by(log), progress) for log in logs]
    model, projection = fit_nonlinear_constants(
        as_filed, study.of_fit(motions), study.method, study.intervals, progress
    )
    intervals = projection.intervals if projection else study.intervals
    observations = observe_all(model, motions, workers, cache, _pace(progress))
    progress("estimating", 0.0)
    with naming_still_joints(as_filed, logs, study):
        study, conditional = told_estimate(study, model, logs, concatenated(study.of_fit(observations)), intervals)
    final = with_all_uncertainty(conditional, proposal, calibration)
    all_rows = _reference_rows(model, logs, proposal, workers, cache)
    use = model_for_use(final, study.of_fit(all_rows), study.use)
    runs = tuple(map(Run, study.logs, observations, all_rows))
    runs = tuple(replace(run, motors=motor_shares(use.estimate, run.motion)) for run in runs)
    runs = validated(runs, study, as_filed, use.estimate)
    progress("estimating", 1.0)
    gimbal = gimbal_effect(final)
    return Identification(study, model, proposal, final, use, runs, projection, calibration, gimbal, response)


def with_all_uncertainty(conditional: Estimate, proposal: Proposal, calibration: Calibration | None) -> Estimate:
    """An estimate that takes the treatment as exact, with the uncertainty of what was found before it."""
    if isinstance(conditional.method, MotorSide):
        final = with_noise_uncertainty(with_motor_delays(conditional))
    else:
        expect_elasticity(conditional, proposal.bandwidth_hz)
        final = with_treatment_uncertainty(conditional, proposal.delays, proposal.effects, proposal.rounding)
    final = calibration.with_uncertainty(final) if calibration else final
    return with_bounds(final, proposal.bandwidth_hz)


def validated(runs: Sequence[Run], study: Study, as_filed: DynamicModel, final: Estimate) -> tuple[Run, ...]:
    """Runs with the errors of the model for use on their rows: of the fit and out of sample."""
    fitted = study.of_fit(runs)
    unseen = iter(held_out(study, as_filed, [run.observation for run in fitted], [run.reference for run in fitted]))
    return tuple(
        replace(run, unseen=(validate(final, run.observation, run.reference),))
        if run.entry.role == "validate"
        else replace(run, fit_errors=fit_errors(final, run.observation), unseen=next(unseen))
        for run in runs
    )


def _check_size(model: DynamicModel) -> None:
    """Raise EstimationError, before any log is read, for more parameters than are estimated in a bearable time."""
    count, most = len(model.base.names), BASE_PARAMETERS.value
    if count > most:
        raise EstimationError(
            f"{model.device.name} has {count} base parameters, more than the {most} that are identified together: the "
            "time grows with their cube, and would be many minutes.",
            where=model.device.name,
            found=count,
            limit=most,
            advice="Leave joints that stand still out of the device file (haptid import --only JOINT,JOINT), or "
            "identify a part at a time; "
            f"{BASE_PARAMETERS.variable} sets another limit.",
        )


def _reference_rows(
    model: DynamicModel, logs: Sequence[Log], proposal: Proposal, workers: Executor | None, cache: RFactorCache | None
) -> tuple[Observation, ...]:
    """All rows of each log but those at rest; with these where a log is slower throughout than rest of the others."""
    references = [proposal.reference_of(log) for log in logs]
    try:
        motions = [treat(log, reference) for log, reference in zip(logs, references, strict=True)]
        return observe_all(model, motions, workers, cache)
    except NoRowsError:
        if len(logs) == 1:
            return observe_all(model, [treat(logs[0], replace(references[0], rest_speed=0.0))], workers, cache)
    return tuple(rows for log in logs for rows in _reference_rows(model, [log], proposal, workers, cache))


def check_kind(study: Study) -> None:
    """Refuse a study of poses, and one with a payload whose torque cannot be subtracted."""
    if study.poses is not None:
        raise fault(
            study.path,
            "poses",
            "its logs hold poses",
            advice="`haptid poses` identifies gravity and friction from them.",
        )
    for k, entry in enumerate(study.logs):
        if entry.body is not None and entry.payload is None:
            raise fault(
                study.path,
                f"logs.{k}.payload",
                f"mass and com of payload {entry.body.name!r} are required to subtract its torque",
                advice="Give both, or estimate them: `haptid payload`.",
            )


def refuse_copies(study: Study, logs: Sequence[Log]) -> None:
    """Refuse two logs with samples of one recording.

    Raises:
        SharedRowsError: a file was saved again, converted or cut out of another.
    """
    for (one, log), (other, later) in combinations(zip(study.logs, logs, strict=True), 2):
        if found := same_samples(log, later):
            raise SharedRowsError(
                f"{other.path} has samples of {one.path}, such as those from {found[0]:.3f} to {found[1]:.3f} s: rows "
                "of one recording would count twice, or be called unseen.",
                where=other.path,
                found=found,
                advice="Leave one of the logs out, and validate with another recording.",
            )


def read_entry(entry: LogEntry, data: Path, progress: _Progress, together: int = 0) -> Log:
    """Read a log of a study, or open it where it is long, or where all logs `together` have very many bytes."""
    name = Path(entry.path).name
    progress(f"reading {name}", 0.0)
    path = data / entry.path
    if is_long(path, together) and not entry.exclude:
        log = open_log(path, entry.channels, time_range=entry.time_range)
    else:
        log = read_log(path, entry.channels, entry.time_range, entry.episodes, entry.exclude)
    progress(f"reading {name}", 1.0)
    return log


def _completed(
    study: Study, model: DynamicModel, logs: list[Log], progress: _Progress
) -> tuple[Study, list[Log], FrequencyResponse | None]:
    """Logs of elastic motors without their links, with simulated links, the study with the method for them, and the
    motors' frequency response where logs repeat."""
    if not any(lacks_links(model, log) for log in logs):
        return study, logs, None
    progress("finding stiffness", 0.0)
    fitting = [entry.role == "identify" for entry in study.logs]
    response = response_of_motors(model, study.of_fit(logs), study.treatment.get("torque_delay_s"))
    measured = _link_frequencies(model, response)
    completed, stiffness_fit = complete_logs(model, logs, fitting, measured, **study.treatment)
    # Simulated links hold no noise but the motors', and determine no delay but that they were simulated with. All rows
    # are those of that fit.
    treatment_used = stiffness_fit.observation.motions[0].treatment
    names = ("cutoff_hz", "parallel_cutoff_hz", "decimation", "torque_delay_s", "reversal_guard_s")
    treatment = {**{name: getattr(treatment_used, name) for name in names}, **study.treatment}
    method = MotorSide(
        weighting=study.method,
        initial=dict(zip(stiffness_fit.names, stiffness_fit.beta.tolist(), strict=True)),
        delays="torque_delay_s" not in study.treatment,
        whitening=stiffness_fit.method.whitening if isinstance(stiffness_fit.method, MotorSide) else None,
    )
    progress("finding stiffness", 1.0)
    return replace(study, method=method, use="free", treatment=treatment), completed, response


def _link_frequencies(model: DynamicModel, response: FrequencyResponse | None) -> dict[str, float] | None:
    """Of each elastic motor the frequency of its link on its spring, Hz; None where the response does not show all."""
    if response is None:
        return None
    names = [motor.name for motor in model.device.motors]
    springs = {drive.name: response.springs[names.index(drive.name)] for drive in model.device.elastic}
    shown = {name: spring.antiresonance for name, spring in springs.items() if isinstance(spring, Spring)}
    return shown if len(shown) == len(springs) else None


def logs_to_propose_from(study: Study, logs: Sequence[Log]) -> list[Log]:
    """Logs of the fit without payload if there are any: subtracting a payload requires a treatment first."""
    fitting = study.of_fit(logs)
    bare = [log for log, entry in zip(fitting, study.of_fit(study.logs), strict=True) if entry.body is None]
    return bare or fitting


def _unloaded(model: DynamicModel, log: Log, treatment: Treatment, entry: LogEntry) -> Log:
    return log if entry.payload is None else log_without_payload(model, log, treatment, entry.payload)


def _calibrated(
    study: Study, model: DynamicModel, logs: Sequence[Log], proposal: Proposal, progress: _Progress
) -> tuple[Calibration | None, list[Log]]:
    """Home offsets and the direction of gravity from the logs of the fit, and all logs corrected to them."""
    if study.calibration is None:
        return None, list(logs)
    progress("calibrating", 0.0)
    fitted = study.of_fit(range(len(study.logs)))
    calibration = find_calibration(model, [logs[k] for k in fitted], proposal.treatment, study.calibration)
    places = {k: j for j, k in enumerate(fitted)}
    corrected = [
        calibration.corrected(model, log, proposal.carried_by(log), places.get(k)) for k, log in enumerate(logs)
    ]
    progress("calibrating", 1.0)
    return calibration, corrected


def _treat(log: Log, treatment: Treatment, progress: _Progress) -> Motion:
    progress(f"treating {log.path.name}", 0.0)
    motion = treat(log, treatment)
    progress(f"treating {log.path.name}", 1.0)
    return motion


def _pace(progress: _Progress) -> Callable[[Motion, float], None]:
    """Progress of observing, with samples per second."""
    begin, done = time.perf_counter(), dict[Motion, float]()

    def observing(motion: Motion, share: float) -> None:
        done[motion] = share * len(motion)
        rate = sum(done.values()) / max(time.perf_counter() - begin, 1e-9)
        assert motion.log is not None  # a study's motions all come from logs
        progress(f"observing {motion.log.path.name}: {rate:.2g} samples/s", share)

    return observing
