"""How well a motion excites a device's parameters, before anything moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._values import Array, read_only
from haptid.bench.trajectories import Trajectory
from haptid.device import Device
from haptid.observation import Observation, conditions, observe
from haptid.treatment import Motion, Treatment

# All rows in a few blocks: here nothing is left out.
ONE = 1e9


@dataclass(frozen=True, eq=False)
class Quality:
    """What a motion tells of some base parameters.

    Attributes:
        names: of the parameters, (k,).
        raw, scaled: condition number of their columns of W, as they are and scaled to unit length.
        information: log det of the information W' W / noise^2 per row, parameters in units of their values.
        relative_sd: deviation of each, white noise of the given deviation on every row, per cent of its value, (k,);
            infinite for a value of zero.
        rows: of all motors.
    """

    names: tuple[str, ...]
    raw: float
    scaled: float
    information: float
    relative_sd: Array
    rows: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "relative_sd", read_only(self.relative_sd))


def observed(device: Device, trajectory: Trajectory) -> Observation:
    """The rows of W that a planned motion would give, as triangles."""
    still = np.zeros((len(trajectory), sum(device.measured)))
    rates = (trajectory.qd, trajectory.qdd)
    motion = Motion(trajectory.dt, trajectory.q, still, Treatment(cutoff_hz=None, block=ONE), rates=rates)
    return observe(device, motion)


def quality(observation: Observation, columns: tuple[int, ...], beta: Array, noise: Array) -> Quality:
    """What the rows of a motion tell of some base parameters, the others left out.

    Args:
        observation: the rows.
        columns: indices of the parameters.
        beta: base parameters, (p,), SI.
        noise: deviation of a row of each motor, (motors,), N m or N.
    """
    picked = list(columns)
    raw, scaled = conditions(observation.stack()[:-1, picked])
    W = observation.stack(1.0 / noise)[:-1, picked]
    values = np.abs(beta[picked])
    sizes = np.where(values > 0, values, 1.0 / np.maximum(np.linalg.norm(W, axis=0), np.finfo(float).tiny))
    sd = deviations(W * sizes)
    information = 2 * float(np.log(np.maximum(linalg.svdvals(W * sizes), np.finfo(float).tiny)).sum())
    return Quality(
        names=tuple(observation.base.names[k] for k in picked),
        raw=raw,
        scaled=scaled,
        information=information - len(picked) * float(np.log(observation.rows)),
        relative_sd=np.where(values > 0, 100 * sd, np.inf),
        rows=observation.rows,
    )


def deviations(W: Array) -> Array:
    """Of the least-squares solution of rows with unit noise, (k,); infinite where W is singular."""
    R = np.linalg.qr(W, mode="r")
    if np.abs(np.diag(R)).min() <= np.finfo(float).eps * np.abs(R).max():
        return np.full(W.shape[1], np.inf)
    return np.asarray(np.linalg.norm(linalg.solve_triangular(R, np.eye(len(R))), axis=1))
