"""Play seen from the motor side alone: false alarms, how often it is found, how far off, and in its interval.

An axis of `tests/loose_axis.py`, 10 s of sines up to 3 Hz. Rigid: encoders of 4096 and 20 000 counts, presliding over
0.2 to 100 mrad, Stribeck friction, gravity, torque noise of 0.4 and 4 %; elastic: resonances from 9 to 70 Hz.
Loose: play of 1 to 20 mrad, most of the friction at either side.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from haptid.errors import HaptidError
from haptid.inference.diagnosis.play import transmission_play
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


def main() -> None:
    """Measure, print, store."""
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
    RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


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
