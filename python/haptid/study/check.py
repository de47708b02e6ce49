"""`check_study`: read everything that a study names, fit nothing, and say what is wrong and what would be done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

from haptid._internal.late import dataclass
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError, OptionError
from haptid.estimation.nonlinear.load_friction import has_nonlinear_constants
from haptid.experiment.excitation import compare_with_plan, read_motion
from haptid.log import Log
from haptid.motion.channels import check_log
from haptid.motion.holds import Poses
from haptid.motion.motion import Motion, treat
from haptid.observation.plan import Plan
from haptid.study.identify import check_kind, logs_to_propose_from, read_entry, refuse_copies
from haptid.study.payloads import recorded_poses
from haptid.study.read import read_study
from haptid.study.still_joints import refuse_held_joints
from haptid.study.study import LogEntry, Study, silent
from haptid.treatment_choice.propose import propose

_Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class LogCheck:
    """One log of a study, as it was read.

    Attributes:
        path, role: of the study's entry.
        summary: samples, rate and duration, or poses; empty where it could not be read.
        notes: findings and repairs while reading.
        problem: why it cannot be used; empty where it can.
        played: how it differs from the motion that was planned; empty without a plan.
    """

    path: str
    role: str
    summary: str
    notes: tuple[str, ...] = ()
    problem: str = ""
    played: tuple[str, ...] = ()


@dataclass(frozen=True)
class StudyCheck:
    """What `haptid identify` would meet and do.

    Attributes:
        name: of the study.
        device: summary of the device; empty where it could not be read.
        logs: one for each log of the study.
        treatment: reasons of the treatment, a sentence each; empty where none could be chosen.
        steps: what would be done, a sentence each; empty where there are problems.
        problems: what has to be changed first, a sentence each.
    """

    name: str
    device: str
    logs: tuple[LogCheck, ...]
    treatment: tuple[str, ...]
    steps: tuple[str, ...]
    problems: tuple[str, ...]

    def summary(self) -> str:
        """Device, logs, treatment and steps, then the problems."""
        lines = [self.name, *([f"  {self.device}"] if self.device else [])]
        for log in self.logs:
            lines += ["", f"{log.path} ({log.role})", *([f"  {log.summary}"] if log.summary else [])]
            lines += [f"  {note}" for note in (*log.notes, *log.played)]
        for title, sentences in (("Treatment", self.treatment), ("Would be done", self.steps)):
            lines += ["", title, *(f"- {sentence}" for sentence in sentences)] if sentences else []
        if self.problems:
            return "\n".join([*lines, "", "To be changed first", *(f"- {problem}" for problem in self.problems)])
        return "\n".join([*lines, "", "No problems were found. Nothing was estimated."])

    def to_json(self) -> dict[str, Any]:
        """The same as JSON values."""
        logs = [
            {
                "path": log.path,
                "role": log.role,
                "summary": log.summary,
                "notes": log.notes,
                "problem": log.problem,
                "played": log.played,
            }
            for log in self.logs
        ]
        return {
            "study": self.name,
            "device": self.device,
            "logs": logs,
            "treatment": self.treatment,
            "steps": self.steps,
            "problems": self.problems,
        }


def check_study(
    path: str | Path,
    data: str | Path | None = None,
    progress: _Progress | None = None,
    plans: Sequence[str | Path] = (),
) -> StudyCheck:
    """Read study, device and logs, and choose the treatment; nothing is estimated.

    A problem of one log does not keep the others from being read.

    Args:
        path: of the study file.
        data: where relative log paths start; the study's own folder where None.
        progress: called with the name of a step and the share of it done.
        plans: motions that the logs were to be, in their order, as `haptid excite` wrote them (CSV); of the first logs
            where there are fewer.

    Raises:
        StudyFileError: the study file itself is wrong.
        OptionError: more plans than logs.
    """
    progress = progress or silent
    study = read_study(path)
    try:
        model = DynamicModel(read_device(study.device))
    except HaptidError as error:
        unread = tuple(LogCheck(entry.path, entry.role, "") for entry in study.logs)
        return StudyCheck(study.name, "", unread, (), (), (str(error),))
    device = model.device
    study = study.on(device)
    about = (
        f"{device.name}: {len(device.joints)} joints, {len(device.active)} active, {len(device.motors)} motors, "
        f"{len(model.base)} base parameters of {len(device.parameters.names)}"
    )
    if len(plans) > len(study.logs):
        raise OptionError(
            f"{len(plans)} plans for {len(study.logs)} logs.", where="plans", found=len(plans), limit=len(study.logs)
        )
    recordings = [
        _read(study, model, entry, Path(data or study.path.parent), progress, plan)
        for entry, plan in zip_longest(study.logs, plans)
    ]
    logs = tuple(check for check, _ in recordings)
    problems = [log.problem for log in logs if log.problem]
    reasons: tuple[str, ...] = ()
    steps: tuple[str, ...] = ()
    try:
        if study.poses is None and all(entry.body is None for entry in study.logs):
            check_kind(study)
        if not problems and study.poses is None:
            read = [recording for _, recording in recordings if isinstance(recording, Log)]
            reasons, steps = _treatment(study, model, read, progress)
        elif not problems:
            steps = (f"haptid poses {study.path.name}: gravity, springs and friction from the held poses.",)
    except HaptidError as error:
        problems.append(str(error))
    return StudyCheck(study.name, about, logs, reasons, steps, tuple(problems))


def _treatment(
    study: Study, model: DynamicModel, logs: Sequence[Log], progress: _Progress
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Reasons of the proposed treatment, and the commands that come next."""
    refuse_copies(study, logs)
    refuse_held_joints(model, logs, study)
    progress("choosing a treatment", 0.0)
    proposal = propose(model, *logs_to_propose_from(study, logs), **study.treatment)
    progress("choosing a treatment", 1.0)
    return (*proposal.reasons, *proposal.slower(logs)), _steps(
        study, model, [treat(log, proposal.carried_by(log)) for log in logs]
    )


def _read(
    study: Study, model: DynamicModel, entry: LogEntry, data: Path, progress: _Progress, plan: str | Path | None
) -> tuple[LogCheck, Log | Poses | None]:
    """What was found in a log, and the log or its poses."""
    try:
        if study.poses is not None:
            poses = recorded_poses(study, model, entry, data, progress)
            return LogCheck(entry.path, entry.role, f"{len(poses)} held poses"), poses
        log = read_entry(entry, data, progress)
        about = f"{log.t.size} samples, {log.rate_hz:.5g} Hz, {float(log.t[-1] - log.t[0]):.4g} s"
        parts = f", {len(log.segments)} segments" if len(log.segments) > 1 else ""
        check = LogCheck(entry.path, entry.role, f"{about}{parts}", log.notes)
        check_log(model.device, log)
        if plan is not None:
            played = compare_with_plan(log, read_motion(plan, model.device), model.device)
            check = replace(check, played=played.sentences)
    except HaptidError as error:
        return LogCheck(entry.path, entry.role, "", (), str(error)), None
    return check, log


def _steps(study: Study, model: DynamicModel, motions: list[Motion]) -> tuple[str, ...]:
    """What `haptid identify` or `haptid payload` would do with these logs."""
    roles = [entry.role for entry in study.logs]
    plans = [Plan.of(model, motion) for motion in motions]
    fitted = sum(plan.rows for plan, role in zip(plans, roles, strict=True) if role == "identify")
    logs = roles.count("identify")
    steps = [
        f"{len(model.base)} base parameters are estimated from {fitted} rows a motor of {logs} "
        f"log{'s' if logs > 1 else ''} by {study.method.name}; intervals: {study.intervals.name}."
    ]
    if has_nonlinear_constants(model):
        steps.append("Nonlinear constants of the device are searched first, by variable projection.")
    if model.device.targets:
        steps.append(f"{len(model.device.targets)} targets of the device file are computed from them.")
    bodies = dict.fromkeys(entry.body.name for entry in study.logs if entry.body is not None)
    if bodies:
        steps.append(f"Payloads: {', '.join(bodies)}. `haptid payload` estimates what is not given of them.")
    if "validate" in roles:
        unseen = [entry.path for entry in study.logs if entry.role == "validate"]
        steps.append(f"The model predicts {', '.join(unseen)}, which the fit does not use.")
    if study.cross_validation is not None:
        kind = {"blocks": "every other time block from the rest", "leave-one-log-out": "each log from the others"}
        steps.append(f"Cross-validation: {kind[study.cross_validation]}.")
    elif "validate" not in roles:
        steps.append("Nothing is validated: there is no log with role 'validate', and cross-validation is off.")
    if study.largest_error is not None:
        steps.append(f"Exit status 1 if an error on unseen rows is above {study.largest_error:g} %.")
    steps += dict.fromkeys(note for plan in plans for note in plan.notes())
    return tuple(steps)
