"""Loops that are not linear, closed along whole motions: positions, rates and their change, and an observation."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import haptid
from haptid.device import NewtonClosure
from stopwatch import fastest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from closed_devices import NAMES, path

# Twenty seconds at 1 kHz, and poses that each are reached from the start.
SAMPLES, DT, POSES = 20_000, 1e-3, 2_000
# Seconds that each is run again and again for.
LONG = 0.5


def run() -> dict[str, float]:
    """Processor time of a sample, microseconds, and the largest gap left, as a share of the mechanism's size."""
    figures = {}
    for name in NAMES:
        model = haptid.DynamicModel(haptid.read_device(name))
        closure = model.device.closure
        assert isinstance(closure, NewtonClosure)
        q, qd, qdd = path(model, SAMPLES * DT, DT)
        motion = haptid.Motion(
            DT, q.T, np.zeros_like(q.T), haptid.Treatment(cutoff_hz=None), rates=(qd.T.copy(), qdd.T.copy())
        )
        poses = closure.draw(np.random.default_rng(0), POSES)
        _ = model.base
        timed = {
            "positions": (lambda c=closure, q=q: c.positions(q), SAMPLES),
            "positions, rates and their change": (lambda c=closure, q=q, qd=qd: c.follow(q, qd), SAMPLES),
            "observation": (lambda d=model, m=motion: haptid.observe(d, m), SAMPLES),
            "poses anywhere, from the start": (lambda c=closure, q=poses: c.closes(q), POSES),
        }
        for what, (work, many) in timed.items():
            figures[f"{name}, {what}, us"] = fastest(work, LONG, clock=time.process_time) / many * 1e6
        gap = np.abs(closure.chain.residual(closure.positions(q).T)[0]).max() / closure.chain.size
        figures[f"{name}, gap"] = float(gap)
    return figures
