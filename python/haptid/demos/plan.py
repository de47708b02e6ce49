"""Data of a demonstration: a published identification, its experiments, its tables and its claims that do not hold."""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.toml_text import toml
from haptid.demos.recordings import Take
from haptid.report.document import DocumentSection
from haptid.uncertainty.quantities import aligned

DATA = Path(__file__).parent
# Called with the current step and the completed share of it.
Progress = Callable[[str, float], None]


class Part(BaseModel):
    """A table of a plan; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class Claim(Part):
    """A printed statement that does not hold, and the test that shows it."""

    name: str
    where: str
    printed: str
    found: str
    check: str


class ExperimentParts(Part):
    """An experiment for the virtual bench, put together from TOML files of the demonstration's folder.

    Keys of the file `changed`, if there is one, replace those of the parts, table by table.
    """

    name: str
    seed: int
    gravity: tuple[float, float, float] | None = None
    parts: tuple[str, ...]
    changed: str | None = None


class FlawedLogs(Part):
    """The device with the flaws of a real one: experiments that differ from others by these flaws alone."""

    fit: str = Field(description="experiment that identifies")
    unseen: str = Field(description="experiment that validates; the same one where another part of its log does")


def _changed(whole: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    """An experiment with other keys in its tables."""
    return {**whole, **{k: {**whole.get(k, {}), **v} if isinstance(v, dict) else v for k, v in change.items()}}


class Demo(Part):
    """A demonstration; its files are in the folder of its name."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    name: str
    kind: str
    title: str
    source: str
    device: str
    claims: tuple[Claim, ...]
    experiments: dict[str, ExperimentParts]
    flawed: FlawedLogs | None = None

    @property
    def folder(self) -> Path:
        """Folder of its files."""
        return DATA / self.name

    def write_experiment(self, key: str, folder: Path) -> Path:
        """Write an experiment file, KEY.toml, into a folder; returns its path."""
        made, path = self.experiments[key], folder / f"{key}.toml"
        head = [f'schema = 1\nname = "{made.name}"\nseed = {made.seed}\n']
        head += [] if made.gravity is None else [f"gravity = {list(made.gravity)}\n"]
        parts = [(self.folder / f"{part}.toml").read_text(encoding="utf-8") for part in made.parts]
        text = "\n".join(["".join(head), *parts])
        if made.changed is not None:
            change = (self.folder / f"{made.changed}.toml").read_text(encoding="utf-8")
            text = toml(_changed(tomllib.loads(text), tomllib.loads(change)))
        path.write_text(text, encoding="utf-8")
        return path

    def take(self, key: str, logs: Path, ending: str = "", exact: bool = False, device: str | None = None) -> Take:
        """One of the experiments, written into the folder of the logs, as a log to be recorded."""
        return Take(device or self.device, self.write_experiment(key, logs), logs / f"{key}{ending}.parquet", exact)


@dataclass(frozen=True)
class Kind:
    """How the demonstrations of one form of plan are run; each kind has its own type of results.

    Attributes:
        plan: the form of the plan.
        takes: the logs to be recorded into a folder.
        find: all results from the logs in that folder.
        write_files: writes the tables, and what else belongs to the results, into a folder.
        values: all numbers, as JSON.
        sections: of the page.
        summary: published and found figures side by side, as text.
    """

    plan: type[Demo]
    takes: Callable[[Any, Path], list[Take]]
    find: Callable[[Any, Path, Progress], Any]
    write_files: Callable[[Any, Path], None]
    values: Callable[[Any], dict[str, Any]]
    sections: Callable[[Any], list[DocumentSection]]
    summary: Callable[[Any], str]


@dataclass(frozen=True)
class Table:
    """A published table: numbers by row and column; a missing one is absent from `figures`."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    figures: Mapping[tuple[str, str], float]

    def column(self, name: str) -> Array:
        """One column, NaN where a number is missing, (rows,)."""
        return np.array([self.figures.get((row, name), np.nan) for row in self.rows])


def read_table(path: Path) -> Table:
    """A table from CSV: row names in the first column; `meaning` and `unit` are no numbers."""
    with path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    first, *others = [head for head in lines[0] if head not in ("meaning", "unit")]
    figures = {(line[first], head): float(line[head]) for line in lines for head in others if line[head]}
    return Table(tuple(line[first] for line in lines), tuple(others), figures)


def write_csv(path: Path, rows: Iterable[Sequence[Any]]) -> None:
    """Rows as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def write_text(path: Path, blocks: Iterable[tuple[str, Sequence[Sequence[str]]]]) -> None:
    """Tables of text one below the other, each with its title."""
    lines: list[str] = []
    for title, cells in blocks:
        lines += [*([title, ""] if title else []), *aligned(cells), ""]
    path.write_text("\n".join(lines), encoding="utf-8")


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Values as JSON."""
    path.write_text(json.dumps(values, indent=1, allow_nan=False) + "\n", encoding="utf-8")
