"""The zoo as a benchmark: draw, score on several cores, aggregate, keep."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from zoo.case import Case, draw
from zoo.score import score
from zoo.table import CLASSES, aggregate

CASES, SEED = 240, 0
# What `make bench` keeps of each class; a run of the zoo by itself keeps all, and every case.
FIGURES = {
    "refused": "logs refused",
    "error 50": "error of torque on unseen motion, median, %",
    "error 90": "error of torque on unseen motion, 90 % point, %",
    "ratio 50": "error over that of the best treatment, median",
    "ratio 90": "error over that of the best treatment, 90 % point",
    "covered": "share of 95 % intervals that hold the truth",
}
RESULTS = Path(__file__).resolve().parents[1] / "results"


def run() -> dict[str, float]:
    """Figures of the draw of development, by class."""
    cases = draw(CASES, SEED)
    figures = aggregate(cases, scores(cases, os.cpu_count() or 1))
    return {
        f"{name}: {what}": of[figure]
        for name, of in figures.items()
        for figure, what in FIGURES.items()
        if of[figure] == of[figure]  # a class of which every log was refused has none
    }


def scores(cases: Sequence[Case], jobs: int, fresh: bool = False, diagnosed: bool = False) -> list[dict[str, Any]]:
    """Scores of cases, in their order; how many are done goes to standard error."""
    one, made = partial(score, fresh=fresh, diagnosed=diagnosed), []
    with ProcessPoolExecutor(jobs) as pool:
        for row in pool.map(one, cases):
            made.append(row)
            print(f"\r{len(made)} of {len(cases)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return made


def chosen(cases: Sequence[Case], only: str | None) -> list[Case]:
    """The cases of a class; all where it is None."""
    return [case for case in cases if only is None or CLASSES[only](case)]


def final_seed() -> int:
    """A seed derived from the hash of the commit, so that nothing can have been tuned on its cases."""
    return int(commit()[:7], 16)


def commit() -> str:
    """Hash of the commit."""
    done = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, cwd=RESULTS, check=True)
    return done.stdout.strip()


def keep(path: Path, settings: dict[str, Any], rows: Sequence[dict[str, Any]], figures: dict[str, Any]) -> None:
    """Store scores and aggregates with the commit and the settings, one line a case."""
    lines = ",\n".join("  " + json.dumps(_rounded(row)) for row in rows)
    head = json.dumps({"commit": commit()[:10], "settings": settings, "figures": _rounded(figures)}, indent=1)
    path.write_text(f'{head[:-2]},\n "cases": [\n{lines}\n ]\n}}\n', encoding="utf-8")


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if value == value else None
    return value
