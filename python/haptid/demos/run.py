"""Running a demonstration: record its logs, identify, and write tables, numbers and a page."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path
from typing import Any

from haptid.demos.cea_branches import CEA_BRANCHES
from haptid.demos.phantom_configurations import PHANTOM_CONFIGURATIONS
from haptid.demos.plan import DATA, Demo, Kind, Progress, write_json
from haptid.demos.recordings import record_all
from haptid.errors import index_of
from haptid.experiment.bench.simulation import load_mujoco
from haptid.report.document import DocumentSection, TextTable
from haptid.report.page import page

_KINDS: dict[str, Kind] = {"phantom_configurations": PHANTOM_CONFIGURATIONS, "cea_branches": CEA_BRANCHES}
PLAN, CLAIMS, PAGE = "demo.toml", "claims.csv", "paper.html"


def kind_of(demo: Demo) -> Kind:
    """How a demonstration is run."""
    return _KINDS[demo.kind]


def demo_names() -> tuple[str, ...]:
    """Names of all demonstrations."""
    return tuple(sorted(path.parent.name for path in DATA.glob(f"*/{PLAN}")))


def read_demo(name: str) -> Demo:
    """A demonstration by its name.

    Raises:
        UnknownNameError: there is none of that name.
    """
    index_of(name, demo_names(), "demo")
    plan = tomllib.loads((DATA / name / PLAN).read_text(encoding="utf-8"))
    with (DATA / name / CLAIMS).open(newline="", encoding="utf-8") as file:
        claims = list(csv.DictReader(file))
    return _KINDS[plan["kind"]].plan.model_validate({**plan, "claims": claims, "name": name})


def run_demo(demo: Demo, folder: Path, progress: Progress, processes: int | None = None) -> Any:
    """Record into `folder`/logs, identify, and write tables, demo.json and the page into `folder`.

    Args:
        demo: the demonstration.
        folder: an empty folder.
        progress: called with the current step and the completed share of it.
        processes: simulations in parallel; None for one per processor.

    Returns:
        The results, of the type of the demonstration's kind.

    Raises:
        MissingDependencyError: MuJoCo is not installed.
        OutputFolderError: the folder cannot be written.
    """
    load_mujoco()
    kind, logs = kind_of(demo), folder / "logs"
    logs.mkdir()
    takes = kind.takes(demo, logs)
    progress("simulating", 0.0)
    for done, _ in enumerate(record_all(takes, processes), 1):
        progress("simulating", done / len(takes))
    found = kind.find(demo, logs, progress)
    progress("writing", 0.0)
    write_results(demo, found, folder)
    progress("writing", 1.0)
    return found


def write_results(demo: Demo, found: Any, folder: Path) -> None:
    """Tables, demo.json and the page.

    Raises:
        OutputFolderError: the folder cannot be written.
    """
    kind = kind_of(demo)
    kind.write_files(found, folder)
    claims = [claim.model_dump() for claim in demo.claims]
    head = {"schema": 1, "demo": demo.name, "title": demo.title, "source": demo.source, "claims": claims}
    write_json(folder / "demo.json", {**head, **kind.values(found)})
    sections = [*kind.sections(found), claims_section(demo)]
    (folder / PAGE).write_text(page(demo.title, f"Source: {demo.source}.", sections), encoding="utf-8")


def claims_section(demo: Demo) -> DocumentSection:
    """Printed statements that do not hold."""
    cells = [["", "where", "printed", "found", "check"]]
    cells += [[c.name, c.where, c.printed, c.found, c.check] for c in demo.claims]
    about = "Each check is a test of that name in haptid's own test suite."
    return DocumentSection("claims", "Printed claims that do not hold", (about,), (TextTable("", cells),))
