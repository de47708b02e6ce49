"""Play and slip: false alarms, how often they are found, how far off, and in their intervals.

From the motor side alone: an axis of `tests/loose_axis.py`, 10 s of sines up to 3 Hz. Rigid: encoders of 4096 and
20 000 counts, presliding over 0.2 to 100 mrad, Stribeck friction, gravity, torque noise of 0.4 and 4 %; elastic:
resonances from 9 to 70 Hz. Loose: play of 1 to 20 mrad, most of the friction at either side.

From both sides (`--both-sides`, which does nothing else): the axis behind 300 to 3000 N m/rad with and without play,
and the elastic axis of `tests/elastic_motors.py`, whose motor's encoder slips by 0.2 to 5 mrad (`--slip`, these alone).
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import elastic_motors
import haptid
from haptid.errors import HaptidError
from haptid.inference.diagnosis.play import transmission_play
from haptid.inference.diagnosis.torsion import torsion_findings
from loose_axis import Axis, estimated, recorded

RESULT = Path(__file__).parent / "results/play.json"
RIGID_SEEDS, LOOSE_SEEDS = range(4), range(2)
RIGID = [
    Axis(presliding=distance, counts=counts, noise=noise, gravity=gravity, stribeck=stribeck)
    for distance, counts, noise, gravity, stribeck in product(
        (2e-4, 0.02, 0.1), (4096.0, 20_000.0), (0.02, 0.2), (False, True), (0.0, 0.7)
    )
]
ELASTIC = [Axis(0.0, stiffness=k, gravity=g) for k, g in product((300.0, 1000.0, 3000.0, 20_000.0), (False, True))]
SIZES = (1e-3, 2e-3, 5e-3, 0.02)
LOOSE = [
    (
        counts,
        [Axis(size, dry, counts=counts, gravity=g) for dry, g in product(((0.05, 0.25), (0.3, 0.05)), (False, True))],
    )
    for counts in (4096.0, 20_000.0)
    for size in SIZES
]


def of_axis(axis: Axis, seeds: Sequence[int]) -> list[tuple[str, dict[str, float]]]:
    """Status and figures of the finding for all seeds; a log that is refused has none."""
    made = []
    for log in recorded(axis, seeds, 10.0):
        try:
            found = transmission_play(estimated(axis, log))
        except HaptidError:
            continue
        if found is not None:
            made.append((found.status, dict(found.figures)))
    return made


DRY = [
    *({"kind": kind, "motors": "all"} for kind in ("elastic", "rotor-inertia", "coulomb")),
    *({"kind": kind, "joints": "all"} for kind in ("viscous", "coulomb")),
]
STIFF, BOTH_SEEDS, SLIP_SEEDS = (300.0, 1000.0, 3000.0), range(8), range(60)
# In whole steps of the encoder that the logs are recorded with: rounding would make another size of a part of one.
SLIPS = tuple(steps * elastic_motors.STEP for steps in (6, 32, 160))


def of_both_sides(model: haptid.DynamicModel, log: haptid.Log) -> tuple[dict[str, str], dict[str, float]] | None:
    """Statuses of the findings by name, and their figures; None where the log is refused, or has too few rows."""
    try:
        treatment = haptid.propose(model, log).treatment
        found = torsion_findings(haptid.estimate(haptid.observe(model, haptid.treat(log, treatment)), haptid.WLS()))
    except HaptidError:
        return None
    figures = {name: value for finding in found for name, value in finding.figures.items()}
    return ({finding.name: finding.status for finding in found}, figures) if found else None


def both_sides() -> dict[str, float]:
    """False alarms and play with both sides measured."""
    figures, dry = dict[str, float](), elastic_motors.axis(terms=DRY)
    for play in (0.0, 1e-3, 5e-3):
        for counts in (4096.0, 20_000.0):
            logs = [
                log
                for k in STIFF
                for log in recorded(Axis(play, stiffness=k, counts=counts), BOTH_SEEDS, 10.0, link=True)
            ]
            own = [made for made in (of_both_sides(dry, log) for log in logs) if made]
            label = f"both sides, play {1000 * play:g} mrad, {counts:g} counts"
            figures |= {f"{label}: {k}": v for k, v in counted(own, "play", play, "motor 1, {}", "play").items()}
            print({k: v for k, v in figures.items() if k.startswith(label)}, flush=True)
    return figures


def slips() -> dict[str, float]:
    """False alarms and slip with both sides measured."""
    figures = dict[str, float]()
    for size in (0.0, *SLIPS):
        made = [of_both_sides(elastic_motors.axis(), log) for log in slipped(size)]
        label = f"both sides, slip {1000 * size:.1g} mrad"
        own = [one for one in made if one]
        figures |= {f"{label}: {k}": v for k, v in counted(own, "slip", size, "motor 1, slip 1, {}", "size").items()}
        print({k: v for k, v in figures.items() if k.startswith(label)}, flush=True)
    return figures


def slipped(size: float) -> Iterator[haptid.Log]:
    """Logs of 8 s, of encoders of 12 bits and of 200 000 counts; the motor's reads more from a random time on."""
    for seed in SLIP_SEEDS:
        log, rng = elastic_motors.recorded(seed, 8.0), np.random.default_rng(seed)
        position = np.array(log.position)
        position[log.t >= rng.uniform(1.5, 6.5), 1] += size
        step = 2 * np.pi / 4096 if seed % 2 else elastic_motors.STEP
        yield replace(log, position=step * np.round(position / step))


def counted(
    own: Sequence[tuple[dict[str, str], dict[str, float]]], name: str, size: float, place: str, value: str
) -> dict[str, float]:
    """How many logs have the finding, and any other; and of its size the error, and how often its interval holds it."""
    rest = [any(status != "ok" for key, status in statuses.items() if key != name) for statuses, _ in own]
    named = [figures for statuses, figures in own if statuses[name] != "ok"]
    made: dict[str, float] = {"logs": len(own), "found" if size else "false alarms": len(named)}
    made[f"other than {name}, false alarms"] = sum(rest)
    if size and named:
        sizes = np.array([[figures[place.format(k)] for k in (value, "low", "high")] for figures in named])
        made["error, rms, %"] = 100 * float(np.sqrt(np.mean((sizes[:, 0] / size - 1) ** 2)))
        made["in the interval"] = int(((sizes[:, 1] <= size) & (size <= sizes[:, 2])).sum())
    return made


def main() -> None:
    """Measure, print, store."""
    figures: dict[str, float] = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.exists() else {}
    if "--both-sides" in sys.argv:
        figures |= both_sides()
    figures |= slips() if {"--both-sides", "--slip"} & set(sys.argv) else motor_side()
    RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def motor_side() -> dict[str, float]:
    """False alarms and play with the motors alone."""
    figures: dict[str, float] = {}
    with ProcessPoolExecutor(int(os.environ.get("PROCESSES", "1"))) as pool:

        def findings(axes: list[Axis], seeds: Sequence[int]) -> list[tuple[str, dict[str, float]]]:
            return [one for own in pool.map(of_axis, axes, [seeds] * len(axes)) for one in own]

        for name, axes in (("rigid", RIGID), ("elastic", ELASTIC)):
            own = findings(axes, RIGID_SEEDS)
            figures |= {f"{name}: logs": len(own), f"{name}: false alarms": sum(status != "ok" for status, _ in own)}
            print(figures, flush=True)
        for counts, axes in LOOSE:
            label = f"{1000 * (axes[0].play or 0.0):g} mrad, {counts:g} counts"
            figures |= {
                f"{label}: {k}": v for k, v in summary(findings(axes, LOOSE_SEEDS), axes[0].play or 0.0).items()
            }
            print({k: round(v, 3) for k, v in figures.items() if k.startswith(label)}, flush=True)
    return figures


def summary(own: list[tuple[str, dict[str, float]]], size: float) -> dict[str, float]:
    """How often play of a size was found, how far off, and how often in its interval."""
    named = np.array([[one[f"motor 1, {k}"] for k in ("play", "low", "high")] for _, one in own if one])
    figures: dict[str, float] = {"logs": len(own), "found": len(named)}
    if len(named):
        inside = (named[:, 1] <= size) & (size <= named[:, 2])
        figures["error, rms, %"] = 100 * float(np.sqrt(np.mean((named[:, 0] / size - 1) ** 2)))
        figures["in the interval"] = int(inside.sum())
    return figures


if __name__ == "__main__":
    main()
