"""Logs of an arm that holds poses: gravity, dry friction of the last motion with scatter, coarse encoders, noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import haptid
from haptid.experiment import bench

# Of the generic arm with three joints: centre and half range of the grid, rad.
CENTRE, AMPLITUDE = (0.0, 0.6, -1.0), (0.8, 0.6, 0.7)
# Positions sampled like those of a hobby servo: rate, counts per turn.
RATE_HZ, COUNTS = 50.0, 4096
FRICTION, SCATTER, NOISE = 0.2, 0.1, 0.02


def channels(joints: int, unit: str = "N m") -> haptid.Channels:
    """Channels q1.., tau1.. at the joints, and t."""
    q, tau = (tuple(f"{what}{k + 1}" for k in range(joints)) for what in ("q", "tau"))
    return haptid.Channels(haptid.Signal(q, "rad"), haptid.Signal(tau, unit), "t")


def held_log(
    model: haptid.DynamicModel,
    beta: np.ndarray,
    seed: int,
    *,
    approach: float | None = 0.12,
    points: int = 3,
    friction: float = FRICTION,
    scatter: float = SCATTER,
    centre: tuple[float, ...] = CENTRE,
    amplitude: tuple[float, ...] = AMPLITUDE,
) -> haptid.Log:
    """A log of a grid of poses, each reached from below and from above where an approach is given.

    A joint that rests keeps a part of its dry friction, which is drawn for each move: between 1 - 2 scatter and all.

    Args:
        model: rigid, with base parameters `beta`; its own friction must be zero in them.
        beta: base parameters, (p,).
        seed: of noise and friction.
    """
    kind = bench.Grid(centre, amplitude, points, 1.0, 0.8, approach=None if approach is None else (approach,))
    rng = np.random.default_rng(seed)
    planned = bench.plan(kind, model, 1 / RATE_HZ, rng)
    q, side = planned.q.T, np.sign(planned.qd.T)
    for j in range(len(side)):
        moving = np.maximum.accumulate(np.where(side[j] != 0, np.arange(side.shape[1]), 0))
        starts = np.cumsum(np.append(0, np.diff(side[j][moving]) != 0))
        kept = 1 - 2 * scatter * rng.uniform(size=starts[-1] + 1)
        side[j] = side[j][moving] * kept[starts]
    tau = haptid.inverse_dynamics(model, beta, q, np.zeros_like(q), np.zeros_like(q))
    tau = tau + friction * side + NOISE * rng.standard_normal(tau.shape)
    step = 2 * np.pi / COUNTS
    t = np.arange(q.shape[1]) / RATE_HZ
    measured = (step * np.round(q / step)).T
    return haptid.Log(Path(f"poses-{seed}.csv"), f"poses {seed}", t, measured, tau.T, channels(len(q)))


def rigid_beta(model: haptid.DynamicModel, chi: np.ndarray) -> np.ndarray:
    """Base parameters without friction."""
    kinds = model.device.parameters.kinds
    return model.base.of(np.where([kind in ("FC", "FV") for kind in kinds], 0.0, chi))
