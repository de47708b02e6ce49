"""An exciting motion written out: as an experiment file of the bench, and as samples for a real controller."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.atomic_folder import publishing_files
from haptid._internal.toml_text import toml
from haptid.device.parts import DistributionLaw
from haptid.device.priors import PriorBody
from haptid.dynamics.inverse import mass_matrix
from haptid.experiment.bench.experiment import KINDS, Experiment, ExperimentTable
from haptid.experiment.bench.trajectories import TrajectoryKind, Triangles, TrianglesAndSines
from haptid.experiment.excitation.planned import PlannedMotion
from haptid.experiment.excitation.samples import MotionSamples, write_motion


def write_experiment(
    path: str | Path,
    motion: PlannedMotion,
    like: Experiment,
    rate_hz: float | None = None,
    weight: tuple[str, PriorBody] | None = None,
) -> Path:
    """Write an experiment file with this motion and the controller, instruments and true parameters of another one.

    Args:
        path: of the file, TOML.
        motion: with the seed of its phases.
        like: the experiment that the rest is copied from.
        rate_hz: of samples of the motion in a CSV file of the same name; None for no such file.
        weight: a link and a point mass that is added to it; none where None.

    Raises:
        OutputFolderError: the file cannot be written.
    """
    rest = like.table.model_dump(by_alias=True, exclude_unset=True)
    made = {**rest, "seed": motion.seed, "trajectory": trajectory_table(motion.kind)}
    if weight is not None:
        link, body = weight
        made["weights"] = [*rest.get("weights", []), {"link": link, "mass": body.mass, "com": body.com.tolist()}]
    target = Path(path)
    samples = () if rate_hz is None else (target.with_suffix(".csv"),)
    with publishing_files(target, *samples) as folder:
        (folder / target.name).write_text(toml(made), encoding="utf-8")
        for path in samples:
            write_motion(folder / path.name, MotionSamples.of(motion, rate_hz or 1.0))
    return target


def trajectory_table(kind: TrajectoryKind) -> dict[str, Any]:
    """The table [trajectory] of this motion."""
    if isinstance(kind, TrianglesAndSines):
        sines = _settings(kind.sines)
        own = {name: sines[name] for name in ("amplitude", "frequencies_hz", "count", "speed") if sines[name]}
        return {"kind": "triangles", **_settings(kind.triangles), "sines": own}
    names = {made: name for name, made in KINDS.items()} | {Triangles: "triangles"}
    return {"kind": names[type(kind)], **_settings(kind)}


def _settings(kind: object) -> dict[str, Any]:
    assert is_dataclass(kind)  # as every kind of motion is
    return {field.name: getattr(kind, field.name) for field in fields(kind)}


# Bandwidth, rad/s, and damping ratio of the default controller. With the other joints free a motor moves far less than
# its greatest inertia, and the velocity loop would be unstable at 1 kHz: gains are for so many times the least one.
OMEGA, _DAMPING, _LIGHTER = 2 * np.pi * 6.0, 0.8, 3.0
# Step at which inertias are evaluated, s.
_LOOK = 0.05


def plain_experiment(found: PlannedMotion) -> Experiment:
    """Default experiment for a motion: true parameters from the device's prior, PD controller, planned torque forward.

    The bandwidth is 6 Hz or less. Gains are zero for coordinates whose inertia the prior does not give: the experiment
    then needs a controller.
    """
    inertia = controlled_inertia(found)
    gains = {"kp": (OMEGA**2 * inertia).tolist(), "kd": (2 * _DAMPING * OMEGA * inertia).tolist()}
    table: dict[str, Any] = {
        "schema": 1,
        "name": f"{found.model.device.name}, planned motion",
        "seed": found.seed,
        "trajectory": _lists(trajectory_table(found.kind)),
        "controller": {**gains, "dynamics": True},
    }
    made = ExperimentTable.model_validate(table)
    return Experiment(made.name, made.seed, found.kind, made)


def controlled_inertia(found: PlannedMotion) -> Array:
    """Inertia of every motor coordinate for which gains are stable along the motion, by the prior, (motors,)."""
    model = found.model
    qa = found.trajectory(_LOOK).q.T
    M = mass_matrix(model, found.bounds.beta, qa)
    law = model.device.distribution or DistributionLaw.even(len(model.device.drives))
    B = model.device.drive_jacobian(model.device.row_map @ qa)
    D = law.shares(B)
    largest = np.maximum(np.einsum("...ki,nij,...kj->nk", D, M, D).max(axis=0), 0.0)
    mobility = np.einsum("...ki,nij,...kj->nk", B, np.linalg.pinv(M, hermitian=True), B).max(axis=0)
    free = np.divide(1.0, mobility, out=np.zeros_like(mobility), where=mobility > 0)
    return np.asarray(np.minimum(largest, _LIGHTER * free)[model.device.driven])


def _lists(value: Any) -> Any:
    """The same with lists in place of tuples and without None, as in a parsed file."""
    if isinstance(value, dict):
        return {key: _lists(one) for key, one in value.items() if one is not None}
    return [_lists(one) for one in value] if isinstance(value, (list, tuple)) else value
