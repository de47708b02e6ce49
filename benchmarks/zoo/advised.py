"""Scores of advice: on wrong logs whether the first action names the cause, on right ones whether any is proposed."""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import haptid
from haptid.advice import advise
from haptid.advice.search import search_of
from haptid.inference.diagnosis import diagnose
from haptid.study.identify import Identification
from zoo.case import Array
from zoo.wrong import CAUSES, WrongPlant, identified

# A test that knows the cause has power 0.9 at level 0.01 above this distance, in standard errors.
TOLD = stats.norm.isf(0.01) + stats.norm.isf(0.1)
# Causes that concern one motor, which the action has to name.
OF_ONE = ("torque sign", "time shift", "dead", "stuck", "spring", "rotor inertia", "ripple", "asymmetry")
# Causes that bodies that can exist tell, whatever the prediction.
BY_BODIES = {"torque sign": ("axis", "pendulum"), "position sign": ("pendulum",)}


def score(plant: WrongPlant) -> dict[str, Any]:
    """Cause, actions and rank of a case, as JSON takes it."""
    row: dict[str, Any] = {"case": str(plant.case), "seed": plant.case.seed, "cause": plant.cause}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = identified(plant, Path(folder))
        except haptid.errors.HaptidError as error:
            return row | {"refused": str(error).replace(folder, "")[:200]}
        begin = time.process_time()
        made = advise(found, diagnose(found.estimate))
        row["seconds"] = time.process_time() - begin
        row["error"] = found.unseen[0].comparable.relative
        row["actions"] = [[action.kind, *action.places] for action in made.actions]
        said = [text.lower() for text in made.undetermined]
        row["said"] = any("cannot be determined" in text or "too small" in text for text in said)
        if plant.cause != "none":
            row |= {"size": plant.size, "motor": plant.motor, "rank": rank(plant, row["actions"])}
            row["distance"] = distance(found, replace(plant, cause="none"))
            row["told"] = bool(row["distance"] > TOLD) or plant.case.device in BY_BODIES.get(plant.cause, ())
    return row


def rank(plant: WrongPlant, actions: Sequence[Sequence[str]]) -> int | None:
    """Place of the first action that mends the cause, from 1; None where there is none."""
    device = plant.model.device
    own = {device.row_names[plant.motor], device.joints[device.active[plant.motor]].name}
    for k, (kind, *places) in enumerate(actions, 1):
        if kind in CAUSES[plant.cause][0]:
            right = plant.cause not in OF_ONE or any(place.split(" ", 1)[-1] in own for place in places)
            if right:
                return k
    return None


def distance(found: Identification, right: WrongPlant) -> float:
    """How far unseen errors lie above those of the same log without the cause, in standard errors, block by block."""
    with tempfile.TemporaryDirectory() as folder:
        without = identified(right, Path(folder))
    wrong, plain = _relative(found), _relative(without)
    difference = wrong.mean() - plain.mean()
    return float(difference / np.sqrt(wrong.var(ddof=1) / len(wrong) + plain.var(ddof=1) / len(plain)))


def _relative(found: Identification) -> Array:
    """Unseen error of every block over its torque, (blocks,)."""
    search = search_of(found.model, found.estimate.observation.motions, found.estimate.beta, columns=False)
    base = search.base()
    own = search.bench.squares(base.setting) * search.bench.weights**2
    return np.sqrt(base.errors.sum(axis=1) / own.sum(axis=1))


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Figures of all cases, and by cause."""
    right = [row for row in rows if row["cause"] == "none" and "refused" not in row]
    wrong = [row for row in rows if row["cause"] != "none"]
    told = [row for row in wrong if row.get("told")]
    silent = [row for row in wrong if not row.get("told") and "refused" not in row]

    def share(of: Sequence[dict[str, Any]], most: int) -> float:
        return sum(row["rank"] is not None and row["rank"] <= most for row in of) / max(len(of), 1)

    by_cause = {}
    for cause in CAUSES:
        own = [row for row in told if row["cause"] == cause]
        by_cause[cause] = {"told": len(own), "first": share(own, 1), "first three": share(own, 3)}
    unnamed = [row for row in silent if not row["actions"]]
    return {
        "right models": len(right),
        "false alarms": sum(bool(row["actions"]) for row in right) / len(right) if right else None,
        "wrong models": len(wrong),
        "refused when read": sum("refused" in row for row in wrong),
        "told": len(told),
        "first cause right": share(told, 1),
        "among the first three": share(told, 3),
        "named though not told": share(silent, 3),
        "wrong action though not told": sum(bool(r["actions"]) and r["rank"] is None for r in silent)
        / max(len(silent), 1),
        "no action, and said what cannot be determined": sum(r["said"] for r in unnamed) / max(len(unnamed), 1),
        "seconds, median": float(np.median([row["seconds"] for row in rows if "seconds" in row])),
        "causes": by_cause,
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rank of the true cause in every wrong case: a line for each cause, a column for each device.

    In brackets where a test that knows the cause has less power than 0.9; "-" where it is not named, "." where there is
    no action at all.
    """
    devices = list(dict.fromkeys(_device(row) for row in rows if row["cause"] != "none"))
    lines = [f"{'':15}" + "".join(f"{device:>12}" for device in devices)]
    for cause in CAUSES:
        cells = [
            " ".join(_cell(row) for row in rows if row["cause"] == cause and _device(row) == device)
            for device in devices
        ]
        lines.append(f"{cause:15}" + "".join(f"{cell:>12}" for cell in cells))
    return "\n".join(lines)


def _device(row: dict[str, Any]) -> str:
    return str(row["case"]).split("device=")[1].split()[0]


def _cell(row: dict[str, Any]) -> str:
    if "refused" in row:
        return "x"
    made = str(row["rank"]) if row["rank"] else "-" if row["actions"] else "."
    return made if row["told"] else f"({made})"
