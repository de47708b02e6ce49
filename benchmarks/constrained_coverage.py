"""Coverage of the intervals of physically consistent estimates: of the unconstrained fit cut at zero, and by profile.

    python benchmarks/constrained_coverage.py [--repetitions 100]

The truth is feasible, with friction at or near zero, so that constraints are active in most logs. The share of profile
intervals that are wider than the unconstrained ones is recorded too; where data and constraints contradict each other
(friction of the wrong sign), what is said.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np  # noqa: E402

import haptid  # noqa: E402
from haptid.estimation import PhysicallyConsistent, Profile  # noqa: E402
from motions import motion  # noqa: E402
from small_study import DEVICE  # noqa: E402

RESULTS = Path(__file__).resolve().parent / "results" / "constrained-coverage.json"
CHI = {"ZZ1": 0.075, "MX1": 0.3, "M1": 2.0, "ZZ2": 0.034, "MX2": 0.12, "M2": 1.0}
# Friction of the truth, and of logs that contradict the constraints; noise over the torque.
FEASIBLE, INFEASIBLE, NOISE = 0.002, -0.5, 0.5


def truth(model: haptid.DynamicModel, friction: float) -> np.ndarray:
    """Two bodies, and friction."""
    pairs = zip(model.device.parameters.names, model.device.parameters.kinds, strict=True)
    return model.base.of(np.array([CHI.get(n, friction if k in ("FV", "FC") else 0.0) for n, k in pairs]))


def study(repetitions: int) -> dict[str, Any]:
    """Shares, per cent."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "device.toml"
        path.write_text(DEVICE, encoding="utf-8")
        model = haptid.DynamicModel(haptid.read_device(path))
    beta = truth(model, FEASIBLE)
    inside: dict[str, list[np.ndarray]] = {"free": [], "cut": [], "profile": []}
    wider, active, width = [], [], []
    for seed in range(repetitions):
        rows = haptid.observe(model, motion(model, beta, seconds=20.0, dt=1e-2, seed=seed, noise=NOISE, phi=0.5))
        free = haptid.estimate(rows, haptid.WLS())
        cut = haptid.estimate(rows, PhysicallyConsistent())
        profile = haptid.estimate(rows, PhysicallyConsistent(), Profile())
        for name, made in (("free", free), ("cut", cut), ("profile", profile)):
            low, high = made.conf_int().T
            inside[name].append((low <= beta) & (beta <= high))
        widths = [np.diff(made.conf_int(), axis=1).ravel() for made in (free, profile)]
        wider.append(np.mean(widths[1] > widths[0] * (1 + 1e-9)))
        width.append(widths[1] / widths[0])
        active.append(cut.constrained)
    clash = motion(model, truth(model, INFEASIBLE), seconds=20.0, dt=1e-2, noise=NOISE / 5)
    said = haptid.estimate(haptid.observe(model, clash), PhysicallyConsistent())
    made = {f"{name}: intervals that hold the truth, %": 100 * float(np.mean(v)) for name, v in inside.items()}
    made |= {f"{name}: of the worst parameter, %": 100 * float(np.mean(v, axis=0).min()) for name, v in inside.items()}
    return made | {
        "logs with an active constraint, %": 100 * float(np.mean(active)),
        "profile intervals wider than free ones, %": 100 * float(np.mean(wider)),
        "width of profile over free intervals, mean": float(np.mean(width)),
        "status where data and constraints contradict each other": said.status,
        "repetitions": repetitions,
    }


def main() -> None:
    """Run, print, store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    made = study(given.repetitions)
    given.out.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(made, indent=1))


if __name__ == "__main__":
    main()
