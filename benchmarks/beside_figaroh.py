"""figaroh's own search for an exciting trajectory beside that of haptid: the same robot, limits and duration.

python benchmarks/beside_figaroh.py URDF PYTHON [PROGRESS.npz]

URDF is FloBaRoID's `model/kuka_lwr4.urdf`, PYTHON an interpreter with figaroh and cyipopt; a search that was run before
is read from PROGRESS.npz. Its search is IPOPT on the condition number of its base regressor, by finite differences,
over the waypoints of a cubic spline that rests at each: seven of them, two seconds apart, 100 Hz and 200 iterations, as
its examples and defaults have it. Limits are those of the URDF, without its margin of 5 %; collisions are left out.
Both are measured alike, with their start and stop: by the geometric mean standard error of the base parameters, times
the root of the seconds, and by the condition numbers, raw and with unit columns, with the same base parameters.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np

import haptid
from haptid.experiment.bench.trajectories import Trajectory
from haptid.experiment.excitation import (
    Criterion,
    FourierSeries,
    Information,
    Limits,
    RawCondition,
    Search,
    design_excitation,
    observed_motion,
    quality,
)
from haptid.robot_files import import_robot

RESULT = Path(__file__).parent / "results" / "beside-figaroh.json"
WAYPOINTS, APART_S, RATE_HZ, SEED, LONGEST_S = 7, 2.0, 100, 0, 7200
SETTINGS = {
    "robot": {"name": "kuka_lwr4"},
    "tasks": {
        "identification": {
            "problem": {
                "use_joint_torques": True,
                "model_components": {"friction": True, "joint_offset": False, "actuator_inertia": False},
            },
            "signal_processing": {"sampling_frequency": float(RATE_HZ), "cutoff_frequency": 20.0},
        },
        "optimal_trajectory": {
            "problem": {"soft_lim": 0.0},
            "trajectory": {"waypoints": WAYPOINTS, "frequency": RATE_HZ, "segment_duration": APART_S},
        },
    },
}
# Harmonics and evaluations of haptid's series, as beside FloBaRoID; ramp, s.
COUNT, TRIES, RAMP = 6, 2600, 1.5
CRITERIA: dict[str, Criterion] = {"D-optimal": Information(), "raw condition": RawCondition()}


def searched(urdf: Path, python: str, folder: Path) -> Path:
    """Run figaroh's search: the file with its progress."""
    tree = ET.parse(urdf)
    for link in tree.getroot().iter("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    tree.write(folder / "robot.urdf")
    (folder / "config.yaml").write_text(json.dumps(SETTINGS), encoding="utf-8")  # JSON is YAML too
    script, out = Path(__file__).parent / "peers" / "figaroh_search.py", folder / "progress.npz"
    call = [python, str(script), "robot.urdf", "config.yaml", str(SEED), str(out)]
    environment = os.environ | {"MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(call, check=True, cwd=folder, env=environment, timeout=LONGEST_S, stdout=subprocess.DEVNULL)
    return out


def measured(model: haptid.DynamicModel, made: Trajectory) -> dict[str, float]:
    """Geometric mean standard error of unit noise at one row a second, times root seconds; condition numbers."""
    p, motors = len(model.base), sum(model.device.measured)
    found = quality(observed_motion(model, made), tuple(range(p)), np.zeros(p), np.ones(motors))
    mean = float(np.exp(-0.5 * found.information / p))
    return {"mean standard error": mean, "condition": found.scaled, "condition raw": found.raw}


def run(urdf: Path, progress: Path) -> dict[str, float]:
    """Both searches: processor time and quality at each improvement of theirs, and of haptid's motions."""
    model = haptid.DynamicModel(replace(import_robot(urdf).device, collision=()))
    noted = np.load(progress)
    figures = {"base parameters": float(len(model.base))}
    for k, seconds in enumerate(noted["seconds"]):
        made = Trajectory(1 / RATE_HZ, *noted[f"states{k}"])
        for what, figure in measured(model, made).items():
            figures[f"figaroh, {seconds:.1f} s, evaluation {noted['evaluations'][k]}: {what}"] = figure
    figures["figaroh, processor time of the whole search, s"] = float(noted["whole"])
    seconds = (WAYPOINTS - 1) * APART_S
    torque = tuple(model.device.joints[j].torque_limit or np.inf for j in model.device.active)
    family = FourierSeries(seconds, 1 / (seconds - 2 * RAMP), COUNT, RAMP)
    for name, criterion in CRITERIA.items():
        begun = time.process_time()
        found = design_excitation(model, family, Limits(torque=torque), criterion=criterion, search=Search(tries=TRIES))
        figures[f"haptid, {name}: processor time of the search, s"] = time.process_time() - begun
        for what, figure in measured(model, found.trajectory(1 / RATE_HZ)).items():
            figures[f"haptid, {name}: {what}"] = figure
    return figures


def main() -> None:
    """Run both, print the figures and keep them."""
    if len(sys.argv) < 3 or not Path(sys.argv[1]).exists():
        print("skipped: no URDF, or no interpreter with figaroh and cyipopt, was given")
        return
    from run import machine

    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(sys.argv[1]).resolve()
        progress = Path(sys.argv[3]) if len(sys.argv) > 3 else searched(urdf, sys.argv[2], Path(folder))
        figures = run(urdf, progress)
    for what, figure in figures.items():
        print(f"  {what:75s} {figure:12.4g}")
    RESULT.write_text(json.dumps({"where": machine(), "figures": figures}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
