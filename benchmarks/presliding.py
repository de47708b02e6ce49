"""Held-out errors of presliding friction beside Coulomb friction, on recordings of real robots.

EMPS: fitted to one log, judged on the other, within 30 ms of a reversal and on all rows. TX40 and KR300: their studies'
own cross-validation with the device's Coulomb friction replaced, errors on all rows behind the reference filter.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from pathlib import Path

import numpy as np

import haptid
from haptid.study import read_study
from haptid.study.identify import Identification, identify

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = Path(haptid.__file__).parent / "device/library"
RESULT = ROOT / "benchmarks/results/presliding.json"
NEAR_S, STILL = 0.03, 1e-4
SEARCHED = "distance = { start = 0.003, low = 1e-5, high = 0.2 }"
DECADES = "distances = [1e-4, 1e-3, 1e-2]"


def emps(data: Path) -> dict[str, float]:
    """Errors of the unseen log with pulses, by friction: near reversals, and of all rows, per cent."""
    made = {}
    for name, study in (("Stribeck", "friction-study"), ("LuGre", "presliding-study")):
        made |= _emps_errors(identify(read_study(ROOT / f"examples/emps/{study}.toml"), data / "emps"), name)
    with tempfile.TemporaryDirectory() as folder:
        text = (ROOT / "examples/emps/presliding.toml").read_text(encoding="utf-8")
        parts = text.split("[[terms]]")
        parts = [part for part in parts if '"lugre"' not in part] + ['\nkind = "coulomb"\njoints = "all"\n']
        plan = (ROOT / "examples/emps/presliding-study.toml").read_text(encoding="utf-8")
        Path(folder, "presliding.toml").write_text("[[terms]]".join(parts), encoding="utf-8")
        Path(folder, "study.toml").write_text(plan, encoding="utf-8")
        made |= _emps_errors(identify(read_study(Path(folder, "study.toml")), data / "emps"), "Coulomb")
    return made


def _emps_errors(found: Identification, name: str) -> dict[str, float]:
    motion = next(run.observation.motions[0] for run in found.runs if run.entry.role == "validate")
    predicted = haptid.predict(found.estimate, motion)
    t, v = motion.times(np.arange(len(motion))), np.gradient(motion.q[:, 0], motion.dt)
    turns = t[1:][np.diff(np.sign(np.where(np.abs(v) < STILL, 0, v))) != 0]
    near = np.abs(predicted.t[:, None] - turns).min(axis=1) < NEAR_S
    e, y = predicted.measured - predicted.predicted, predicted.measured
    return {
        f"EMPS, {name}, near reversals": 100 * float(np.linalg.norm(e[:, near]) / np.linalg.norm(y[:, near])),
        f"EMPS, {name}, all rows": 100 * float(np.linalg.norm(e) / np.linalg.norm(y)),
    }


def arm(name: str, data: Path, frictions: dict[str, str]) -> dict[str, list[float]]:
    """Errors of every fold, all motors and then motor by motor, by friction, per cent."""
    made = {}
    device = (LIBRARY / f"{name}.toml").read_text(encoding="utf-8")
    plan = (ROOT / f"examples/{name}/study.toml").read_text(encoding="utf-8")
    for friction, term in frictions.items():
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "d.toml").write_text(device.replace('kind = "coulomb"', term), encoding="utf-8")
            path = Path(folder, "study.toml")
            path.write_text(re.sub('device = ".*"', 'device = "d.toml"', plan, count=1), encoding="utf-8")
            for k, fold in enumerate(identify(read_study(path), data / name).unseen):
                errors = [fold.comparable.relative, *(motor.relative for motor in fold.comparable.motors)]
                made[f"{name}, {friction}, fold {k + 1}"] = errors
    return made


def main() -> None:
    """Measure, print, store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared/data", help="folder of the recordings")
    data = parser.parse_args().data
    coulomb = 'kind = "coulomb"'
    maxwell, dahl = f'kind = "maxwell-slip"\n{DECADES}', f'kind = "dahl"\n{SEARCHED}'
    figures: dict[str, float | list[float]] = {
        **emps(data),
        **arm("staubli_tx40", data, {"Coulomb": coulomb, "Maxwell-slip": maxwell}),
        **arm("kuka_kr300", data, {"Coulomb": coulomb, "Dahl": dahl}),
    }
    for name, value in figures.items():
        print(f"{name}: {', '.join(f'{x:.2f}' for x in np.atleast_1d(value))} %")
    RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
