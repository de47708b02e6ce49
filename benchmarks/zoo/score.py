"""Score of a case: the error of the default path's model, beside what is possible."""

from __future__ import annotations

import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import haptid
from haptid.report import ReportSource
from haptid.study.identify import Identification, identify
from haptid.study.read import read_study
from zoo.case import Array, Case
from zoo.kept import kept
from zoo.oracle import Unseen, oracle
from zoo.plant import Plant
from zoo.recording import Recorded, record, write

ORACLE = ("plant.py", "recording.py", "oracle.py")
# An oracle's error counts as this at least, per cent: below it treatments differ by chance.
LEAST = 0.5


def score(case: Case, fresh: bool = False, diagnosed: bool = False) -> dict[str, Any]:
    """Everything about a case, as JSON takes it.

    Args:
        case: to score.
        fresh: whether to compute the oracle again, which is kept from run to run.
        diagnosed: whether the report's verdict is wanted too, which takes longer than the estimate.
    """
    plant = Plant(case)
    known = kept("oracle", case, ORACLE, lambda: oracle(plant), fresh)
    row: dict[str, Any] = {"case": str(case), "seed": case.seed, "edge_hz": plant.motion.edge_hz} | known
    made = record(plant)
    with tempfile.TemporaryDirectory() as folder:
        study = write(plant, made, Path(folder))
        begin = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = identify(read_study(study))
        except haptid.errors.HaptidError as error:
            row |= {"refused": type(error).__name__, "why": str(error).replace(str(folder), "")[:200]}
        except Exception as error:  # a defect: to be counted, and the others scored
            row |= {"refused": f"defect: {type(error).__name__}", "why": str(error)[:200]}
        else:
            row |= default_path(plant, made, found)
        row["seconds"] = time.process_time() - begin
        if diagnosed and "error" in row:
            row["verdict"] = ReportSource(found, "").diagnosis.verdict.torque
    if "error" in row:
        row["ratio"] = row["error"] / max(row["oracle"], LEAST) if row["oracle"] is not None else None
    return row


def default_path(plant: Plant, made: Recorded, found: Identification) -> dict[str, Any]:
    """Scores of an identification."""
    estimate, treatment = found.estimate, found.proposal.treatment
    beta, interval = estimate.beta, np.asarray(estimate.conf_int())
    inside = (interval[:, 0] <= plant.beta) & (plant.beta <= interval[:, 1])
    off = np.abs(beta - plant.beta) / np.maximum(estimate.se, 1e-300)
    delay, se = delays(found, len(made.delays))
    late = (delay - made.delays) * plant.case.rate
    row = {
        "error": Unseen.of(plant).error(beta),
        "told": found.unseen[0].relative if found.unseen else None,
        "status": estimate.status,
        "covered": float(inside.mean()),
        "parameters": len(beta),
        "error_over_se": float(np.median(off)),
        "worst_error_over_se": float(off.max()),
        "cutoff_hz": treatment.cutoff_hz,
        "parallel_hz": treatment.parallel_cutoff_hz,
        "decimation": treatment.decimation,
        "delay_error": [round(float(x), 4) for x in late],
    }
    if se is not None:
        row["delay_error_over_se"] = [float(x) for x in np.abs(delay - made.delays) / np.maximum(se, 1e-300)]
    return row


def delays(found: Identification, motors: int) -> tuple[Array, Array | None]:
    """Delay of each motor that the result used, s, and its standard error; None where it has none."""
    given = np.broadcast_to(np.asarray(found.proposal.treatment.torque_delay_s, dtype=float), (motors,))
    return given, None if found.proposal.delays is None else found.proposal.delays.se
