"""FloBaRoID's own search for an exciting trajectory beside that of haptid: its robot, its limits, the same period.

python benchmarks/beside_flobaroid.py CHECKOUT PYTHON [PROGRESS.npz]

CHECKOUT is a checkout of FloBaRoID, PYTHON an interpreter that has its packages; a search that was run before is read
from PROGRESS.npz. Its settings for the KUKA LWR 4 are kept, but for pictures, sudden stops and collisions, which are
off: 400 trials of a global search, then IPOPT with analytical gradients, on log det of the information with more terms.
Both are measured alike, along one period: by the geometric mean standard error of the base parameters, times the root
of the seconds, and by the condition number with unit columns. Both keep positions, velocities and torques.

With iDynTree 15.1 its code reads memory that is not set: `Vector6()` and `Vector3()` there are to be made from zeros.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import haptid
from haptid.experiment.bench.trajectories import Trajectory
from haptid.experiment.excitation import (
    FourierSeries,
    Limits,
    Search,
    design_excitation,
    observed_motion,
    quality,
)
from haptid.robot_files import import_robot

ROBOT, CONFIG = "model/kuka_lwr4.urdf", "configs/kuka_lwr4.yaml"
RESULT = Path(__file__).parent / "results" / "beside-flobaroid.json"
# Its settings that are replaced; harmonics of haptid's series: the most that it gives a joint; evaluations; ramp, s.
OFF = {"showOptimizationGraph": "0", "verbose": "0", "simulateNumStops": "0"}
COUNT, TRIES, RAMP = 6, 2600, 1.5
LONGEST_S = 3600


def searched(checkout: Path, python: str, folder: Path) -> Path:
    """Run FloBaRoID's search: the file with its progress."""
    text, urdf = (checkout / CONFIG).read_text(encoding="utf-8"), (checkout / ROBOT).read_text(encoding="utf-8")
    links = sorted(set(re.findall(r'<link name="([^"]*)"', urdf)))
    for key, value in (OFF | {"ignoreLinksForCollision": str(links)}).items():
        text = re.sub(rf"^{key}:.*$", "", text, flags=re.MULTILINE) + f"\n{key}: {value}\n"
    (folder / "config.yaml").write_text(text, encoding="utf-8")
    script, out = Path(__file__).parent / "peers" / "flobaroid_search.py", folder / "progress.npz"
    call = [python, str(script), str(checkout), str(folder / "config.yaml"), str(checkout / ROBOT), str(out)]
    environment = os.environ | {"MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(call, check=True, cwd=checkout, env=environment, timeout=LONGEST_S, stdout=subprocess.DEVNULL)
    return out


def measured(model: haptid.DynamicModel, made: Trajectory) -> tuple[float, float]:
    """Geometric mean standard error of unit noise at one row a second, times root seconds; condition, unit columns."""
    p, motors = len(model.base), sum(model.device.measured)
    found = quality(observed_motion(model, made), tuple(range(p)), np.zeros(p), np.ones(motors))
    return float(np.exp(-0.5 * found.information / p)), found.scaled


def run(checkout: Path, progress: Path) -> dict[str, float]:
    """Both searches: processor time and quality at each improvement of theirs, and of haptid's motion."""
    model = haptid.DynamicModel(replace(import_robot(checkout / ROBOT).device, collision=()))
    noted = np.load(progress)
    figures = {"base parameters": float(len(model.base))}
    period = float("nan")
    for k, seconds in enumerate(noted["seconds"]):
        states, t = noted[f"states{k}"], noted[f"times{k}"]
        period = len(t) * float(np.median(np.diff(t)))
        mean, condition = measured(model, Trajectory(period / len(t), *states))
        figures[f"FloBaRoID, {seconds:.1f} s, evaluation {noted['evaluations'][k]}: mean standard error"] = mean
        figures[f"FloBaRoID, {seconds:.1f} s, evaluation {noted['evaluations'][k]}: condition"] = condition
    figures["period, s"] = period
    joints = [model.device.joints[j] for j in model.device.active]
    torque = tuple(joint.torque_limit or np.inf for joint in joints)
    family = FourierSeries(period + 2 * RAMP, 1 / period, COUNT, RAMP)
    begun = time.process_time()
    found = design_excitation(model, family, Limits(torque=torque), search=Search(tries=TRIES))
    figures["haptid, processor time of the search, s"] = time.process_time() - begun
    whole = found.trajectory(period / 2000)
    inner = slice(round(RAMP / whole.dt), round((RAMP + period) / whole.dt))
    mean, condition = measured(model, Trajectory(whole.dt, whole.q[inner], whole.qd[inner], whole.qdd[inner]))
    return figures | {"haptid, mean standard error": mean, "haptid, condition": condition}


def main() -> None:
    """Run both, print the figures and keep them."""
    if len(sys.argv) < 3 or not (Path(sys.argv[1]) / ROBOT).exists():
        print("skipped: no checkout of FloBaRoID, or no interpreter with its packages, was given")
        return
    from run import machine

    checkout, python = Path(sys.argv[1]).resolve(), sys.argv[2]
    with tempfile.TemporaryDirectory() as folder:
        progress = Path(sys.argv[3]) if len(sys.argv) > 3 else searched(checkout, python, Path(folder))
        figures = run(checkout, progress)
    for what, figure in figures.items():
        print(f"  {what:75s} {figure:12.4g}")
    RESULT.write_text(json.dumps({"where": machine(), "figures": figures}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
