"""Two branches of an interface as in the demo, 20 seeds each: are intervals honest, errors small, the reduction right?

Of every branch and seed: a log that identifies and one with another motion, with encoders and noise; motions are drawn
anew.

Limits that the figures are meant to meet: the interval of every published parameter holds the truth in 90 % of the
seeds or more; relative deviations at or below the published ones; the relative error on unseen motion at most 3 %.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import haptid
from haptid.demos import read_demo
from haptid.demos.cea_branches.plan import CeaDemo
from haptid.demos.cea_branches.results import Identified, identified
from haptid.demos.recordings import BenchRecording, Take, read_recording, record

NAME, SEEDS = "medical", range(1, 21)
# Between the seeds of one log and the next, so that no two have the same noise.
APART = 1000


@dataclass(frozen=True)
class Found:
    """Of one branch and seed.

    Attributes:
        inside, inside_full: whether each published parameter's interval holds the truth, of the essential parameters
            and of all.
        ratio: relative deviation of each over the published one.
        missing, more: how many published parameters were left out, and how many others kept.
        moved: the farthest that the reduction moved a parameter, in its own deviations of before.
        fit_errors, cross: relative errors, per cent.
        rows: of W.
        condition, condition_published: with unit columns, of all columns and of the published ones.
    """

    inside: dict[str, bool]
    inside_full: dict[str, bool]
    ratio: dict[str, float]
    missing: int
    more: int
    moved: float
    fit_errors: float
    cross: float
    rows: int
    condition: float
    condition_published: float


def plan() -> CeaDemo:
    """The demo's."""
    demo = read_demo(NAME)
    assert isinstance(demo, CeaDemo)
    return demo


def study(key: str, seed: int) -> Found:
    """One branch and seed."""
    demo, model = plan(), haptid.DynamicModel(haptid.read_device(plan().device))
    branch = demo.branch(key)
    first = seed + 2 * APART * (1 + demo.branches.index(branch))
    with tempfile.TemporaryDirectory() as folder:

        def made(experiment: str, drawn: int) -> BenchRecording:
            path, out = demo.write_experiment(experiment, Path(folder)), Path(folder) / f"{experiment}.parquet"
            record(Take(demo.device, path, out, seed=drawn))
            return read_recording(model, path, out)

        logs = made(branch.key, first), made(branch.unseen, first + APART)
        return found_of(identified(branch, demo.tables[key], demo.stretch, *logs))


def found_of(one: Identified) -> Found:
    """Figures of one identification."""
    names, full = one.table.rows, one.full
    held = {name: full[name].conf_int()[0] <= one.true(name) <= full[name].conf_int()[1] for name in names}
    return Found(
        inside={name: one.inside(name) for name in names},
        inside_full=held,
        ratio={name: one.reduced[name].relative_se / one.table.figures[name, "relative"] for name in names},
        missing=len(one.missing),
        more=len(one.more),
        moved=float(np.nanmax(np.abs(one.reduction.shift))),
        fit_errors=one.fit_errors.relative,
        cross=one.cross.relative,
        rows=one.every.rows,
        condition=one.every.condition[1],
        condition_published=one.condition_of_published[1],
    )


def run() -> dict[str, float]:
    """Shares, and the worst of all seeds."""
    demo = plan()
    jobs = [(branch.key, seed) for seed in SEEDS for branch in demo.branches]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        made = list(pool.map(study, *zip(*jobs, strict=True)))
    by = {b.title: [f for (key, _), f in zip(jobs, made, strict=True) if key == b.key] for b in demo.branches}
    return all_figures(by)


def all_figures(by: dict[str, list[Found]]) -> dict[str, float]:
    """All figures of what was found by branch."""
    figures = {"seeds of each branch": float(min(map(len, by.values())))}
    for title, some in by.items():
        figures |= {f"{title}: {what}": value for what, value in figures_of(some).items()}
    shares = [value for what, value in figures.items() if what.endswith(" held, %")]
    return {
        **figures,
        "published parameters: held, mean, %": float(np.mean(shares)),
        "published parameters: held, worst, %": min(shares),
    }


def figures_of(some: Iterable[Found]) -> dict[str, float]:
    """All figures of one branch."""
    some = list(some)
    names = list(some[0].inside)
    figures = {f"{name} held, %": 100 * float(np.mean([found.inside[name] for found in some])) for name in names}
    of_all = [[found.inside_full[name] for name in names] for found in some]
    ratios = {name: max(found.ratio[name] for found in some) for name in names}
    return {
        **figures,
        "held, mean, %": float(np.mean(list(figures.values()))),
        "of all 34: held, mean, %": 100 * float(np.mean(of_all)),
        "relative deviation over the published one, worst": max(ratios.values()),
        "relative error, in-sample, worst, %": max(found.fit_errors for found in some),
        "relative error, unseen motion, median, %": float(np.median([found.cross for found in some])),
        "relative error, unseen motion, worst, %": max(found.cross for found in some),
        "seeds in which the fifteen alone are kept": float(sum(not (f.missing or f.more) for f in some)),
        "published parameters left out, most": float(max(found.missing for found in some)),
        "others kept, most": float(max(found.more for found in some)),
        "moved by the reduction, most, deviations": max(found.moved for found in some),
        "rows of W, least": float(min(found.rows for found in some)),
        "condition, unit columns, all 34, median": float(np.median([found.condition for found in some])),
        "condition, unit columns, the fifteen, median": float(np.median([f.condition_published for f in some])),
    }


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:85s} {figure:.4g}")
