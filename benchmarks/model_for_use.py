"""The model for use on the zoo: errors on unseen motion of the free, the consistent and the chosen fit.

    python benchmarks/model_for_use.py [--cases 120] [--seed 11] [--hard]

`--hard` draws only logs that a default fit finds difficult: short ones, slow motion, few bits, effects that the model
does not have. In every other case the device file has prior bodies, each parameter off by some thirty per cent.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np  # noqa: E402

import haptid  # noqa: E402
from haptid.device import INERTIAL  # noqa: E402
from haptid.study import read_study  # noqa: E402
from haptid.study.identify import identify  # noqa: E402
from haptid.validation.model_for_use import ModelForUse, _made, model_for_use  # noqa: E402
from zoo.case import Case, draw  # noqa: E402
from zoo.oracle import Unseen  # noqa: E402
from zoo.plant import Plant  # noqa: E402
from zoo.recording import record, write  # noqa: E402

RESULTS = Path(__file__).resolve().parent / "results" / "model-for-use.json"
# Relative error of mass and inertia of the prior bodies, and that of their centres over the length of the link.
PRIOR_ERROR, CENTRE_ERROR = 0.3, 0.1
# A log is hard below this duration, this frequency of motion, or this many bits of a turn of the joint.
SHORT_S, SLOW_HZ, COARSE_BITS = 12.0, 0.3, 13.0
# A fit is worse or better than another by noise if it is within this factor or within this error, per cent.
FACTOR, POINTS = 1.1, 0.2


def hard(case: Case) -> bool:
    """Whether a case is short, slow, coarse or lacks an effect in its model."""
    poor = case.seconds < SHORT_S or case.motion_hz < SLOW_HZ or case.resolution_bits < COARSE_BITS
    return poor or case.misfit != "none"


def prior_bodies(plant: Plant) -> str:
    """Prior bodies for a device file: the true ones, with errors as of a drawing."""
    rng, text = plant.case.random("prior"), ""
    model = plant.model
    known = dict(zip(model.device.parameters.names, plant.chi.tolist(), strict=True))
    for joint in model.device.joints:
        own = [known.get(kind + joint.name, 0.0) for kind in INERTIAL]
        tensor, first, mass = own[:6], np.array(own[6:9]), own[9]
        if not mass > 0 or f'link = "{joint.name}"' in plant_text(plant):
            continue
        com = first / mass
        xx, xy, xz, yy, yz, zz = tensor
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about = about - mass * (com @ com * np.eye(3) - np.outer(com, com))
        size = float(np.sqrt(max(np.trace(about), 1e-12) / mass))
        scale = 1 + PRIOR_ERROR * rng.uniform(-1, 1, 2)
        moved = com + CENTRE_ERROR * size * rng.normal(size=3)
        inertia = scale[0] * scale[1] * about
        six = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        text += f'\n[[prior.bodies]]\nlink = "{joint.name}"\nmass = {scale[0] * mass:.9g}\n'
        text += f"com = [{', '.join(f'{v:.9g}' for v in moved)}]\ninertia = [{', '.join(f'{v:.9g}' for v in six)}]\n"
    return text


def plant_text(plant: Plant) -> str:
    """The device file of a plant."""
    from zoo.plant import device_text

    return device_text(plant.case)


def row(case: Case) -> dict[str, Any]:
    """Errors of one case, per cent, by the name of the fit."""
    plant = Plant(case)
    made: dict[str, Any] = {"case": str(case), "hard": hard(case), "misfit": case.misfit}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        study = write(plant, record(plant), Path(folder))
        if case.seed % 2 and case.device not in ("phantom",):
            device = next(Path(folder).glob("*device*.toml"))
            device.write_text(device.read_text(encoding="utf-8") + prior_bodies(plant), encoding="utf-8")
            made["prior"] = True
        try:
            found = identify(read_study(study))
            consistent = model_for_use(found.estimate, None, "consistent")
        except haptid.errors.HaptidError as error:
            return made | {"refused": type(error).__name__}
    score = Unseen.of(plant).error
    return made | {
        "free": score(found.estimate.beta),
        "consistent": score(consistent.beta),
        "chosen": score(found.use.beta),
        "name": found.use.name,
        "status": found.estimate.status,
        "tried": tried(found.use, found.estimate, score),
    }


def tried(use: ModelForUse, made: haptid.Estimate, score: Callable[[np.ndarray], float]) -> dict[str, list[Any]]:
    """Of each candidate: held-out error, excess with its standard error, strength, and error on unseen motion."""
    return {
        one.name: [one.error, *one.excess, one.strength, score(_made(made, one.name, one.strength).beta)]
        for one in use.candidates
    }


def figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians, high quantiles and counts over the cases that were not refused."""
    kept = [r for r in rows if "free" in r]
    made: dict[str, Any] = {"cases": len(rows), "refused": len(rows) - len(kept)}
    error = {name: np.array([r[name] for r in kept]) for name in ("free", "consistent", "chosen")}
    for name, values in error.items():
        made[name] = {f"{q} %": float(np.quantile(values, q / 100)) for q in (50, 75, 90, 100)}
    for name in ("consistent", "chosen"):
        ours, free = error[name], error["free"]
        made[f"{name} worse than free"] = int(np.sum((ours > FACTOR * free) & (ours > free + POINTS)))
        made[f"{name} better than free"] = int(np.sum((free > FACTOR * ours) & (free > ours + POINTS)))
    made["chosen by name"] = {n: sum(r["name"] == n for r in kept) for n in ("consistent", "free", "ridge", "entropic")}
    return made


def run() -> dict[str, float]:
    """Figures for `make bench`."""
    made = figures([row(case) for case in draw(24, 11)])
    return {f"{name}: 90 % point of the unseen error, %": made[name]["90 %"] for name in ("free", "chosen")}


def main() -> None:
    """Score, print, store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=120)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--hard", action="store_true")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    cases = [case for case in draw(given.cases, given.seed) if hard(case) or not given.hard]
    # Long logs tell nothing here that shorter ones do not.
    cases = [replace(case, seconds=min(case.seconds, 60.0)) for case in cases]
    rows = []
    with ProcessPoolExecutor(given.jobs) as pool:
        for one in pool.map(row, cases):
            rows.append(one)
            print(json.dumps(one), file=sys.stderr, flush=True)
    made = {"settings": {"cases": given.cases, "seed": given.seed, "hard": given.hard}}
    groups = {
        "all": rows,
        "hard": [r for r in rows if r["hard"]],
        "model errors": [r for r in rows if r["misfit"] != "none"],
    }
    groups["prior bodies"] = [r for r in rows if r.get("prior")]
    made["figures"] = {name: figures(group) for name, group in groups.items() if any("free" in r for r in group)}
    made["cases"] = rows
    given.out.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(made["figures"], indent=1))


if __name__ == "__main__":
    main()
