"""A study's payloads and drive gains, and its held poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.estimation import WLS, ClusterRobust
from haptid.estimation.nonlinear.load_friction import fit_nonlinear_constants
from haptid.inference.payloads import AttachedBody, PayloadIdentification, Recorded, identify_payloads
from haptid.inference.static_poses import StaticIdentification, identify_poses
from haptid.log import read_log
from haptid.motion.holds import Poses, find_poses, join_poses, read_poses
from haptid.motion.motion import treat
from haptid.study.schema import fault
from haptid.study.study import LogEntry, Study, silent
from haptid.treatment_choice.propose import propose

_Progress = Callable[[str, float], None]


def study_payloads(
    study: Study,
    data: str | Path | None = None,
    *,
    gains: bool = False,
    shared_friction: bool = False,
    progress: _Progress | None = None,
) -> PayloadIdentification:
    """Identify the payloads of a study's logs, and on request the drive gains.

    Logs with the role "identify" are used; those without `payload` are of the bare device, and the treatment is
    proposed from them.

    Args:
        study: of motions, or of poses.
        data: where relative log paths start; the study's own folder where None.
        gains, shared_friction: as for `haptid.identify_payloads`.
        progress: called with the name of a step and the share of it done.

    Raises:
        StudyFileError: there is no log without payload, or none with one; two logs of a payload differ.
        HaptidError: any error of the steps.
    """
    progress = progress or silent
    entries = study.of_fit(study.logs)
    bodies = _bodies(study, entries)
    model, recorded = _recorded(study, entries, data, progress)
    progress("identifying payloads", 0.0)
    bare = [recording for recording, entry in zip(recorded, entries, strict=True) if entry.body is None]
    loaded = [
        (
            body,
            [
                recording
                for recording, entry in zip(recorded, entries, strict=True)
                if entry.body and entry.body.name == name
            ],
        )
        for name, body in bodies.items()
    ]
    payloads = identify_payloads(model, bare, loaded, gains=gains, shared_friction=shared_friction)
    progress("identifying payloads", 1.0)
    return payloads


def _bodies(study: Study, entries: Sequence[LogEntry]) -> dict[str, AttachedBody]:
    """The payloads by name, in the order of the logs."""
    bodies: dict[str, AttachedBody] = {}
    for k, entry in enumerate(entries):
        if entry.body is None:
            continue
        first = bodies.setdefault(entry.body.name, entry.body)
        if not _agree(first, entry.body):
            problem = f"payload {first.name!r} is another one than in an earlier log"
            raise fault(study.path, f"logs.{k}.payload", problem, advice="Give it the same values, or another name.")
    if not bodies or all(entry.body for entry in entries):
        problem = "no log has a payload" if not bodies else "every log has a payload"
        advice = "Payloads are identified from logs with and without: give the former `payload = { link = ... }`."
        raise fault(study.path, "logs", problem, advice=advice)
    return bodies


def _agree(first: AttachedBody, second: AttachedBody) -> bool:
    scalars_agree = (first.link, first.mass) == (second.link, second.mass)
    pairs = ((first.com, second.com), (first.inertia, second.inertia))
    return scalars_agree and all(a is b or (a is not None and b is not None and np.array_equal(a, b)) for a, b in pairs)


def _recorded(
    study: Study, entries: Sequence[LogEntry], data: str | Path | None, progress: _Progress
) -> tuple[DynamicModel, list[Recorded]]:
    """The model at its nonlinear constants, and poses or treated motions of the entries."""
    if study.calibration is not None:
        raise fault(study.path, "calibration", "only `haptid identify` calibrates logs", advice="Leave the table out.")
    model = DynamicModel(read_device(study.device))
    if study.poses is not None:
        return model, [recorded_poses(study, model, entry, data, progress) for entry in entries]
    folder = Path(data or study.path.parent)
    logs = []
    for entry in entries:
        progress(f"reading {Path(entry.path).name}", 0.0)
        logs.append(read_log(folder / entry.path, entry.channels, entry.time_range, entry.episodes))
        progress(f"reading {Path(entry.path).name}", 1.0)
    progress("choosing a treatment", 0.0)
    bare = [log for log, entry in zip(logs, entries, strict=True) if entry.body is None]
    proposal = propose(model, *bare, **study.treatment)
    progress("choosing a treatment", 1.0)
    motions = [treat(log, proposal.carried_by(log)) for log in logs]
    without = [motion for motion, entry in zip(motions, entries, strict=True) if entry.body is None]
    model, _ = fit_nonlinear_constants(model, without, WLS(), ClusterRobust(), progress)
    return model, list(motions)


def recorded_poses(
    study: Study, model: DynamicModel, entry: LogEntry, data: str | Path | None, progress: _Progress
) -> Poses:
    """The poses of a log, or of a table."""
    assert study.poses is not None
    path = Path(data or study.path.parent) / entry.path
    progress(f"reading {path.name}", 0.0)
    if study.poses.table:
        assert entry.channels is not None  # the reader of studies has seen to it
        poses = read_poses(path, model.device, entry.channels, study.poses.approach)
    else:
        log = read_log(path, entry.channels, entry.time_range, entry.episodes)
        poses = find_poses(model.device, log, study.poses.detection)
    progress(f"reading {path.name}", 1.0)
    return poses


def study_poses(
    study: Study, data: str | Path | None = None, progress: _Progress | None = None
) -> StaticIdentification:
    """Identify gravity, springs and friction from the held poses of a study's logs.

    Logs with the role "identify" and without payload are used, with the study's method where it works on R factors.

    Args:
        study: with a table `[poses]`.
        data: where relative log paths start; the study's own folder where None.
        progress: called with the name of a step and the share of it done.

    Raises:
        StudyFileError: the study has no `[poses]`, or no log without payload.
        HaptidError: any error of the steps.
    """
    progress = progress or silent
    if study.poses is None:
        advice = "Add the table [poses]; it may be empty. `haptid schema study` prints its keys."
        raise fault(study.path, "poses", "missing: its logs are motions", advice=advice)
    entries = [entry for entry in study.logs if entry.role == "identify" and entry.body is None]
    if not entries:
        raise fault(study.path, "logs", "every log has a payload", advice="`haptid payload` identifies payloads.")
    model, poses = _recorded(study, entries, data, progress)
    progress("identifying gravity", 0.0)
    identified = identify_poses(model, join_poses(*(recording for recording in poses if isinstance(recording, Poses))))
    progress("identifying gravity", 1.0)
    return identified
