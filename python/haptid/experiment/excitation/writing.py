"""An exciting motion as an experiment file of the bench."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from haptid.errors import OutputError
from haptid.experiment.bench.experiment import Experiment
from haptid.experiment.bench.trajectories import Fourier, Kind, TrianglesAndSines
from haptid.experiment.excitation.search import Excitation


def write_experiment(path: str | Path, excitation: Excitation, like: Experiment) -> Path:
    """Write an experiment with this motion, and all the rest as in another one: controller, instruments, what is true.

    Args:
        path: of the file, TOML.
        excitation: its motion and the seed that draws its phases.
        like: the experiment that it is otherwise like.

    Raises:
        OutputError: the file cannot be written.
    """
    rest = like.table.model_dump(by_alias=True, exclude_unset=True)
    made = {**rest, "seed": excitation.seed, "trajectory": trajectory_table(excitation.kind)}
    target = Path(path)
    try:
        target.write_text(toml(made), encoding="utf-8")
    except OSError as error:
        raise OutputError(target, str(error.strerror)) from error
    return target


def trajectory_table(kind: Kind) -> dict[str, Any]:
    """The table [trajectory] that the bench reads back as this motion."""
    if isinstance(kind, TrianglesAndSines):
        sines = _settings(kind.sines)
        own = {name: sines[name] for name in ("amplitude", "frequencies_hz", "count", "speed") if sines[name]}
        return {"kind": "triangles", **_settings(kind.triangles), "sines": own}
    return {"kind": "fourier" if isinstance(kind, Fourier) else type(kind).__name__.lower(), **_settings(kind)}


def _settings(kind: object) -> dict[str, Any]:
    assert is_dataclass(kind)  # as every kind of motion is
    return {field.name: getattr(kind, field.name) for field in fields(kind)}


def toml(table: Mapping[str, Any]) -> str:
    """A table as TOML, one setting to a line; tables within tables of the top level in one line."""
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
