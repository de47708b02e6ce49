"""Walking a demonstration: record its logs, find everything in them, and write it down."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from haptid.demos.kind import Tell
from haptid.demos.known import kind_of
from haptid.demos.plan import Demo
from haptid.demos.recordings import Take, record_all
from haptid.demos.report import write_report
from haptid.experiment.bench.simulation import load_mujoco


def run_demo(demo: Demo, folder: Path, tell: Tell, processes: int | None = None) -> Any:
    """Record into `folder`/logs, find everything, and write tables, figures and the report into `folder`.

    Args:
        demo: what to do.
        folder: an empty folder.
        tell: called with what is being done and the share of it done.
        processes: simulations at a time; None for as many as there are processors.

    Returns:
        What was found, in the form of the demonstration's kind.

    Raises:
        MujocoMissingError: there is no simulator.
        OutputError: nothing can be written there.
    """
    load_mujoco()
    kind, logs = kind_of(demo), folder / "logs"
    logs.mkdir()
    record_logs(kind.takes(demo, logs), logs, tell, processes)
    found = kind.find(demo, logs, tell)
    kind.draw(found, folder, tell)
    tell("writing", 0.0)
    kind.write_tables(found, folder)
    write_report(kind.values(found), kind.chapters(found), folder)
    tell("writing", 1.0)
    return found


def record_logs(takes: Sequence[Take], logs: Path, tell: Tell, processes: int | None = None) -> None:
    """Every log of a demonstration, with the experiments that made them."""
    tell("simulating", 0.0)
    for done, _ in enumerate(record_all(takes, processes), 1):
        tell("simulating", done / len(takes))
    for name in dict.fromkeys(take.experiment for take in takes):
        shutil.copy(name, logs)
