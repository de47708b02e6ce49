"""An exciting motion written out: as an experiment file of the bench, and as samples for a real controller."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.atomic_folder import publishing_files
from haptid._internal.escaping import write_csv
from haptid.dynamics.inverse import mass_matrix
from haptid.experiment.bench.experiment import Experiment, ExperimentTable
from haptid.experiment.bench.trajectories import Fourier, TrajectoryKind, TrianglesAndSines
from haptid.experiment.excitation.search import Excitation


def write_experiment(path: str | Path, excitation: Excitation, like: Experiment, rate_hz: float | None = None) -> Path:
    """Write an experiment file with this motion and the controller, instruments and true parameters of another one.

    Args:
        path: of the file, TOML.
        excitation: the motion and the seed of its phases.
        like: the experiment that the rest is copied from.
        rate_hz: of samples of the motion in a CSV file of the same name; None for no such file.

    Raises:
        OutputFolderError: the file cannot be written.
    """
    rest = like.table.model_dump(by_alias=True, exclude_unset=True)
    made = {**rest, "seed": excitation.seed, "trajectory": trajectory_table(excitation.kind)}
    target = Path(path)
    samples = () if rate_hz is None else (target.with_suffix(".csv"),)
    with publishing_files(target, *samples) as folder:
        (folder / target.name).write_text(toml(made), encoding="utf-8")
        for path in samples:
            write_samples(excitation, folder / path.name, rate_hz or 1.0)
    return target


def trajectory_table(kind: TrajectoryKind) -> dict[str, Any]:
    """The table [trajectory] of this motion."""
    if isinstance(kind, TrianglesAndSines):
        sines = _settings(kind.sines)
        own = {name: sines[name] for name in ("amplitude", "frequencies_hz", "count", "speed") if sines[name]}
        return {"kind": "triangles", **_settings(kind.triangles), "sines": own}
    return {"kind": "fourier" if isinstance(kind, Fourier) else type(kind).__name__.lower(), **_settings(kind)}


def _settings(kind: object) -> dict[str, Any]:
    assert is_dataclass(kind)  # as every kind of motion is
    return {field.name: getattr(kind, field.name) for field in fields(kind)}


def toml(table: Mapping[str, Any]) -> str:
    """A table as TOML, one key per line; nested tables below the second level inline."""
    return "\n".join(_lines(table)) + "\n"


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    simple = {k: v for k, v in table.items() if not isinstance(v, Mapping) and not _tables(v)}
    yield from (f"{key} = {value_text(value)}" for key, value in simple.items() if value is not None)
    for key, value in table.items():
        for one in [value] if isinstance(value, Mapping) else value if _tables(value) else []:
            yield f"\n[{key}]" if isinstance(value, Mapping) else f"\n[[{key}]]"
            yield from (f"{name} = {value_text(v)}" for name, v in one.items() if v is not None)


def _tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(one, Mapping) for one in value)


def value_text(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {value_text(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(value_text(one) for one in value) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)


# Bandwidth, rad/s, and damping ratio of the default controller, at the largest inertia of a motor along the motion.
OMEGA, _DAMPING = 2 * np.pi * 6.0, 0.8
# Step at which inertias are evaluated, s.
_LOOK = 0.05


def plain_experiment(found: Excitation) -> Experiment:
    """Default experiment for a motion: true parameters from the device's prior, PD controller of about 6 Hz bandwidth.

    Gains are zero for coordinates whose inertia the prior does not give: the experiment then needs a controller.
    """
    inertia = largest_inertia(found)
    gains = {"kp": (OMEGA**2 * inertia).tolist(), "kd": (2 * _DAMPING * OMEGA * inertia).tolist()}
    table: dict[str, Any] = {
        "schema": 1,
        "name": f"{found.model.device.name}, exciting motion",
        "seed": found.seed,
        "trajectory": _lists(trajectory_table(found.kind)),
        "controller": gains,
    }
    made = ExperimentTable.model_validate(table)
    return Experiment(made.name, made.seed, found.kind, made)


def largest_inertia(found: Excitation) -> Array:
    """Largest inertia of every motor coordinate along the motion, from the parameters of the search, (motors,)."""
    model = found.model
    M = mass_matrix(model, found.bounds.beta, found.trajectory(_LOOK).q.T)
    to_rows = model.device.row_map @ np.linalg.inv(model.device.coupling)
    on_drives = np.einsum("ik,nij,jk->nk", to_rows, M, to_rows)
    motors = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
    return np.asarray(np.maximum(on_drives.max(axis=0)[motors], 0.0))


def write_samples(found: Excitation, path: Path, rate_hz: float) -> None:
    """Write the motion as CSV samples: t in s, then position, velocity and acceleration of the active joints, SI."""
    made = found.trajectory(1.0 / rate_hz)
    names = [found.model.device.joint_names[j] for j in found.model.device.active]
    heads = ["t", *(f"{prefix}{name}" for prefix in ("q", "qd", "qdd") for name in names)]
    write_csv(path, [heads, *np.column_stack([made.t, made.q, made.qd, made.qdd]).tolist()])


def _lists(value: Any) -> Any:
    """The same with lists in place of tuples and without None, as in a parsed file."""
    if isinstance(value, dict):
        return {key: _lists(one) for key, one in value.items() if one is not None}
    return [_lists(one) for one in value] if isinstance(value, (list, tuple)) else value
