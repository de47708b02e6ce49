"""False alarms and power of the test of how far the rigid model holds, on logs of one axis and of the PHANToM.

Rigid: torque noise of 0.3 to 5 %, white and autoregressive. Elastic: the axis with a resonance of its link at 12 to 80
Hz, excited up to 8 Hz, positions at the motor; for each how often elasticity is found, and the resonance stated.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import diagnosed
from elastic_axis import ROTOR, estimated
from haptid.estimation import Estimate
from haptid.inference.diagnosis import Finding
from haptid.inference.diagnosis.residuals import residuals
from haptid.inference.diagnosis.rigid_range import frequency_ranges, rigid_range

RESULT = Path(__file__).parent / "results/rigid-range.json"
AXES, ARMS, ELASTIC = 300, 60, 20
NOISE, PHI, RESONANCES = (0.003, 0.01, 0.05), (0.0, 0.9), (12.0, 20.0, 40.0, 80.0)


def found(estimate: Estimate) -> Finding:
    """The finding."""
    return rigid_range(frequency_ranges(estimate, residuals(estimate)))


def main() -> None:
    """Measure, print, store."""
    settings = [(NOISE[k % 3], PHI[k // 3 % 2]) for k in range(AXES)]
    axes = [found(estimated(k, seconds=20.0, noise=n, phi=p, dt=4e-3)) for k, (n, p) in enumerate(settings)]
    arms = [found(diagnosed.estimated(diagnosed.log(k, noise=n, phi=p))) for k, (n, p) in enumerate(settings[:ARMS])]
    figures: dict[str, float] = {
        "rigid axes": AXES,
        "false alarms, axes": sum(one.status != "ok" for one in axes),
        "rigid PHANToMs": ARMS,
        "false alarms, PHANToMs": sum(one.status != "ok" for one in arms),
    }
    for resonance in RESONANCES:
        made = [found(estimated(1000 + k, resonance)) for k in range(ELASTIC)]
        stated = [one.figures["motor 1, resonance, Hz"] for one in made if "motor 1, resonance, Hz" in one.figures]
        figures[f"{resonance:g} Hz: found, of {ELASTIC}"] = len(stated)
        if stated:
            figures[f"{resonance:g} Hz: stated times root of the link's share, median"] = float(
                np.median(stated) * np.sqrt(1 - ROTOR)
            )
    for name, value in figures.items():
        print(f"{name}: {value:.3g}")
    RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
