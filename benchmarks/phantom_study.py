"""Five mountings of the PHANToM as in the demo, 20 seeds each: are intervals honest, errors small, models possible?

Of every mounting and seed: a log with exact velocities and one with encoders; of ten seeds also without the amplifiers'
noise.
In the mounting with a force sensor, also one in which a hand pushes. The simulator steps by 0.5 ms: on the rows that
count, figures are those of 0.1 ms to three digits.

Limits that the figures are meant to meet: intervals hold the truth 90 times in 100 or more; with exact velocities, no
error above the published table's; with encoders, torque 0.2 %, parameters that carry 2 % of a motor's torque 1 %,
Coulomb 0.2 %, viscous 3 %; a held model possible, its mass matrix positive definite, its error 0.2 points above the
free fit's at most; the hand's force 5 times better with the model than without, the observer as good.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import haptid
from haptid.demos import read_demo
from haptid.demos.accuracy import Accuracy, accuracy
from haptid.demos.phantom_configurations.fits import Fit, fitted
from haptid.demos.phantom_configurations.hand import hand_forces
from haptid.demos.phantom_configurations.plan import PhantomDemo
from haptid.demos.recordings import BenchRecording, Take, read_recording, record
from haptid.end_effector.definiteness import definiteness
from haptid.estimation import PhysicallyConsistent, feasible_parameters

NAME, SEEDS, STEP = "phantom", range(1, 21), 5e-4
# Up to this seed there are logs without noise too.
QUIET = 10
# Between the seeds of one mounting and the next, so that no two have the same noise.
APART = 1000
# Of the workspaces, the one that is all that the device can reach.
REACHABLE = "C"
KINDS = {"parameters": "body", "Coulomb": "Coulomb", "viscous": "viscous"}


@dataclass(frozen=True)
class Found:
    """Of one mounting and seed.

    Attributes:
        inside: whether each parameter is in its interval, by sort of data.
        errors: torque, parameters, Coulomb, viscous, per cent, by sort of data.
        published: with exact velocities, greatest of the motors' errors over the published one.
        feasible, least, above: of the held model: whether bodies can have it, the least eigenvalue of its mass matrix
            in kg m^2, and how many points its validation error is above the free fit's.
        hand: errors of the hand's force in N; empty where no hand pushes.
    """

    inside: dict[str, np.ndarray]
    errors: dict[str, dict[str, float]]
    published: float
    feasible: bool
    least: float
    above: float
    hand: dict[str, float]


def study(key: str, seed: int) -> Found:
    """One mounting and seed."""
    demo, model = read_demo(NAME), haptid.DynamicModel(haptid.read_device(read_demo(NAME).device))
    drawn = seed + APART * (1 + list(demo.mountings).index(key))
    with tempfile.TemporaryDirectory() as folder:

        def made(experiment: str, exact: bool = False, quiet: bool = False) -> BenchRecording:
            path = demo.write_experiment(experiment, Path(folder))
            out = Path(folder) / f"{experiment}-{exact}-{quiet}.parquet"
            record(Take(demo.device, path, out, exact, drawn, STEP, quiet))
            return read_recording(model, path, out)

        logs = {"exact velocity": made(key, exact=True), "encoders": made(key)}
        if seed <= QUIET:
            logs["exact velocity, no noise"] = made(key, exact=True, quiet=True)
            logs["encoders, no noise"] = made(key, quiet=True)
        fits = {sort: (by_exact_velocity if "exact" in sort else encoders)(demo, log) for sort, log in logs.items()}
        near = {sort: accuracy(fit.targets, logs[sort], demo.stretch.unseen) for sort, fit in fits.items()}
        free, held = fits["encoders"], encoders(demo, logs["encoders"], PhysicallyConsistent())
        reachable = next(place for place in demo.workspaces if place.name == REACHABLE).of(model)
        return Found(
            inside={sort: one.inside for sort, one in near.items()},
            errors={sort: errors_of(one) for sort, one in near.items()},
            published=float(np.max(np.array(fits["exact velocity"].relative) / demo.errors.column(key))),
            feasible=feasible_parameters(model, held.estimate.beta).ok,
            least=definiteness(held.estimate, reachable).smallest,
            above=held.validation.relative - free.validation.relative,
            hand=hand_forces(demo.hand, free, made(demo.hand.experiment)).errors if key == demo.hand.mounting else {},
        )


def errors_of(near: Accuracy) -> dict[str, float]:
    """Per cent."""
    return {"torque": float(near.torque.max()), **{what: near.worst(kind) for what, kind in KINDS.items()}}


def by_exact_velocity(demo: PhantomDemo, recorded: BenchRecording) -> Fit:
    """The paper's way."""
    paper, halves = demo.published.treatment(recorded.dt), demo.stretch
    motions = [recorded.exact(half, paper) for half in (halves.fit, halves.unseen)]
    return fitted("exact velocity", recorded.model, motions)


def encoders(demo: PhantomDemo, recorded: BenchRecording, method: haptid.estimation.Method | None = None) -> Fit:
    """As proposed from the first half."""
    halves = demo.stretch
    treatment = haptid.propose(recorded.model, recorded.log(halves.fit)).treatment
    motions = [recorded.motion(half, treatment) for half in (halves.fit, halves.unseen)]
    return fitted("encoders", recorded.model, motions, method)


def run() -> dict[str, float]:
    """Shares, and the worst of all seeds."""
    demo = read_demo(NAME)
    jobs = [(key, seed) for key in demo.mountings for seed in SEEDS]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        made = list(pool.map(study, *zip(*jobs, strict=True)))
    by = {
        title: [f for (own, _), f in zip(jobs, made, strict=True) if own == key]
        for key, title in demo.mountings.items()
    }
    return figures_of(by)


def figures_of(by: dict[str, list[Found]]) -> dict[str, float]:
    """All figures of what was found by mounting."""
    made = [found for some in by.values() for found in some]
    least = {"seeds of each mounting": float(min(map(len, by.values())))}
    return {**least, **coverage(made, by), **sizes(by), **models(made), **hand(made)}


def coverage(made: list[Found], by: dict[str, list[Found]]) -> dict[str, float]:
    """Shares of intervals that hold the truth, per cent, by sort of data, parameter and mounting."""
    figures = {}
    for sort in made[0].inside:
        shares = held(made, sort)
        figures[f"{sort}: intervals that hold the truth, mean, %"] = float(shares.mean())
        figures |= {f"{sort}: pi_{k + 1} held, %": float(share) for k, share in enumerate(shares)}
        figures |= {
            f"{sort}, {title}: intervals, mean, %": float(held(some, sort).mean()) for title, some in by.items()
        }
    return figures


def held(made: list[Found], sort: str) -> np.ndarray:
    """Of each parameter, the share of intervals that hold the truth, per cent."""
    return np.asarray(100 * np.mean([found.inside[sort] for found in made if sort in found.inside], axis=0))


def sizes(by: dict[str, list[Found]]) -> dict[str, float]:
    """Errors: median and worst of the seeds, by sort of data and mounting, per cent."""
    figures = {}
    for title, some in by.items():
        for sort in some[0].errors:
            for what in some[0].errors[sort]:
                values = [found.errors[sort][what] for found in some if sort in found.errors]
                figures[f"{sort}, {title}: {what}, median, %"] = float(np.median(values))
                figures[f"{sort}, {title}: {what}, worst, %"] = float(np.max(values))
    return figures


def models(made: list[Found]) -> dict[str, float]:
    """Torque errors beside the published ones, and what becomes of held models."""
    return {
        "exact velocity: torque error over the published one, worst": max(found.published for found in made),
        "held: possible, %": 100 * float(np.mean([found.feasible for found in made])),
        "held: least eigenvalue of M over the reachable workspace, kg m^2": min(found.least for found in made),
        "held: validation error above the free fit's, worst, points": max(found.above for found in made),
    }


def hand(made: Iterable[Found]) -> dict[str, float]:
    """How much better the force of the hand is with the model, and with the observer."""
    felt = [found.hand for found in made if found.hand]
    ratio: Callable[[str, str], list[float]] = lambda a, b: [one[a] / one[b] for one in felt]  # noqa: E731
    through = "with the model, through the observer's low-pass"
    return {
        "hand: error without over error with the model, least": min(ratio("without the model", "with the model")),
        "hand: observer's error over the model's, mean": float(np.mean(ratio("observer", through))),
        "hand: observer's error over the model's, worst": max(ratio("observer", through)),
    }


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:85s} {figure:.4g}")
