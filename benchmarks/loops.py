"""Loops that are not linear, closed along whole motions: positions, rates and their change, and an observation."""

from __future__ import annotations

import time

import numpy as np

import haptid
from haptid.device import NewtonClosure
from stopwatch import fastest

DEVICES = ("four_bar", "slider_crank", "five_bar", "delta")
# Twenty seconds at 1 kHz, and poses that each are reached from the start.
SAMPLES, DT, POSES = 20_000, 1e-3, 2_000
# Seconds that each is run again and again for.
LONG = 0.5


def run() -> dict[str, float]:
    """Processor time of a sample, microseconds, and the largest gap left, as a share of the mechanism's size."""
    figures = {}
    for name in DEVICES:
        device = haptid.read_device(name)
        closure = device.closure
        assert isinstance(closure, NewtonClosure)
        q, qd, qdd = course(closure.at)
        motion = haptid.Motion(
            DT, q.T, np.zeros_like(q.T), haptid.Treatment(cutoff_hz=None), rates=(qd.T.copy(), qdd.T.copy())
        )
        poses = closure.draw(np.random.default_rng(0), POSES)
        _ = device.base
        timed = {
            "positions": (lambda c=closure, q=q: c.positions(q), SAMPLES),
            "positions, rates and their change": (lambda c=closure, q=q, qd=qd: c.follow(q, qd), SAMPLES),
            "observation": (lambda d=device, m=motion: haptid.observe(d, m), SAMPLES),
            "poses anywhere, from the start": (lambda c=closure, q=poses: c.closes(q), POSES),
        }
        for what, (work, many) in timed.items():
            figures[f"{name}, {what}, us"] = fastest(work, LONG, clock=time.process_time) / many * 1e6
        gap = np.abs(closure.chain.residual(closure.positions(q).T)[0]).max() / closure.chain.size
        figures[f"{name}, gap"] = float(gap)
    return figures


def course(at: np.ndarray) -> tuple[np.ndarray, ...]:
    """Position, velocity and acceleration of the active joints from two sines each about a pose, (active, n)."""
    t, rng = DT * np.arange(SAMPLES), np.random.default_rng(1)
    omega = 2 * np.pi * rng.uniform(0.4, 2.5, (len(at), 2, 1))
    phase = rng.uniform(0, 2 * np.pi, omega.shape)
    size = 0.15 * omega ** np.arange(3)[:, None, None, None]
    angle = omega * t + phase
    q, qd, qdd = (size * np.array([np.sin(angle), np.cos(angle), -np.sin(angle)])).sum(axis=2)
    return at[:, None] + q, qd, qdd
