"""How often a diagnosis is wrong on clean logs, and how often it finds the fault that is there.

The PHANToM under a multisine, 20 s at 1 kHz, encoders of 4000 counts, torque with noise of 1 % of its size, treated as
proposed. Clean logs: share of logs, per cent, in which each look speaks up (its level is 1 %). Faults: share of logs in
which the look for it does.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from diagnosed import estimated, log
from haptid.inference.diagnosis import diagnose

CLEAN, FAULTY = 100, 40
NOISES = {"white noise": {}, "AR(1) 0.95": {"phi": 0.95, "noise": 0.02}}
FAULTS = {
    "Stribeck, a quarter of dry friction": ({"stribeck": 0.25}, "friction near standstill"),
    "Stribeck, a tenth of dry friction": ({"stribeck": 0.1}, "friction near standstill"),
    "asymmetric friction, 2 %": ({"offset": 0.02}, "friction by direction"),
    "torque half a sample late": ({"late": 0.5}, "time delay"),
    "torque a tenth of a sample late": ({"late": 0.1}, "time delay"),
    "gear ratio left out": ({"gains": (1.0, 2.73, 1.0)}, "units and signs"),
    "dry friction falls by a tenth": ({"warming": 0.1}, "drift"),
}


def run() -> dict[str, float]:
    """Shares in per cent."""
    figures: dict[str, float] = {}
    for what, settings in NOISES.items():
        found = [diagnose(estimated(log(seed, **settings))) for seed in range(CLEAN)]
        spoken = Counter(f.name for each in found for f in each.findings if f.status != "ok")
        for finding in found[0].findings:
            figures[f"clean, {what}: {finding.name}"] = 100 * spoken[finding.name] / CLEAN
        figures[f"clean, {what}: any bad finding"] = 100 * float(np.mean([each.status == "bad" for each in found]))
    for what, (settings, name) in FAULTS.items():
        hits = [diagnose(estimated(log(seed, **settings)))[name].status != "ok" for seed in range(FAULTY)]
        figures[f"{what}: found"] = 100 * float(np.mean(hits))
    return figures
