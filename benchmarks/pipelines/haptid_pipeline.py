"""What haptid does, and what share of the time each step takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import haptid
from haptid.log import is_long
from pipelines.setting import CUTOFF_HZ, DECIMATION, JOINTS

Case = dict[str, np.ndarray]


def pipeline(case: Case) -> tuple[Callable[[Path], dict[str, float]], Callable[[], np.ndarray]]:
    """The work on a log, and the torque of its last model on the other motion."""
    model = haptid.DynamicModel(haptid.read_device("arm7"))
    names = ([f"{kind}{k + 1}" for k in range(JOINTS)] for kind in ("q", "tau"))
    channels = haptid.Channels(haptid.Signal(next(names), "rad"), haptid.Signal(next(names), "N m"), time="t")
    treatment = haptid.Treatment(cutoff_hz=CUTOFF_HZ, decimation=DECIMATION)
    found: list[haptid.Estimate] = []

    def work(path: Path) -> dict[str, float]:
        stamps = [time.process_time()]
        log = (haptid.open_log if is_long(path) else haptid.read_log)(path, channels)
        stamps.append(time.process_time())
        motion = haptid.treat(log, treatment)
        stamps.append(time.process_time())
        observation = haptid.observe(model, motion)
        stamps.append(time.process_time())
        found.append(haptid.estimate(observation, haptid.WLS()))
        assert len(found[-1].parameters) == len(model.base)
        stamps.append(time.process_time())
        steps = ("reading", "filtering", "reduction", "estimate")
        return {step: b - a for step, a, b in zip(steps, stamps, stamps[1:], strict=False)}

    def torque() -> np.ndarray:
        return haptid.inverse_dynamics(model, found[-1].beta, case["q"], case["qd"], case["qdd"])

    return work, torque
