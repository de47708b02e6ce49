"""Proofs where the prediction would not change: bodies that can exist, and the device file's prior bodies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.advice.rows import TrialRows
from haptid.device.parameters import INERTIAL
from haptid.dynamics.inverse import core_mass, raw_parameters
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import device_rows

# Standard errors by which everything that must be positive of a motor is negative.
IMPOSSIBLE = 3.0
# Poses at which the inertia of a motor is evaluated.
_POSES = 16


@dataclass(frozen=True)
class Impossible:
    """A motor whose inertia and friction are negative.

    Attributes:
        motor: index among the rows.
        label: of the motor.
        names: what is negative, "inertia" or parameters.
        t: the least distance from zero, in standard errors.
        share: of these in the motor's torque.
        combinations: of the base parameters, all of which must be positive, (count, p).
    """

    motor: int
    label: str
    names: tuple[str, ...]
    t: float
    share: float
    combinations: Array


def impossible(estimate: Estimate, rows: TrialRows) -> Iterator[Impossible]:
    """Motors of which everything that must be positive is significantly negative.

    Args:
        estimate: of the parameters.
        rows: of the trials.
    """
    model, kinds = estimate.model, estimate.model.device.parameters.kinds
    position = rows.position
    every = np.linspace(0, position.shape[1] - 1, _POSES).astype(int)
    M = _masses(estimate, position[:, every])
    acceleration = np.gradient(rows.velocity, rows.t, axis=1) if len(rows.t) > 1 else np.zeros_like(rows.velocity)
    for m, (row, motor) in enumerate(zip(device_rows(estimate), estimate.observation.motors, strict=True)):
        others = [set(o.columns.tolist()) for k, o in enumerate(estimate.observation.motors) if k != m]
        combinations, names = [M[row]], ["inertia"]
        sizes = [_middle(acceleration[row])]  # of the factor of each
        for k in motor.columns:
            own = model.base.independent_columns[int(k)]
            if kinds[own] in ("FC", "FV") and not any(int(k) in there for there in others):
                combinations.append(np.eye(len(model.base))[int(k)])
                names.append(model.base.names[int(k)])
                sizes.append(1.0 if kinds[own] == "FC" else _middle(rows.velocity[row]))
        spread = estimate.spread(np.array(combinations))
        se = np.sqrt(np.diag(spread.covariance))
        t = np.array(combinations) @ estimate.beta / np.maximum(se, np.finfo(float).tiny)
        significant = [k for k in range(len(t)) if se[k] > 0 and abs(t[k]) > IMPOSSIBLE]
        if significant and all(t[k] < 0 for k in significant) and (0 in significant or len(significant) > 1):
            negative = tuple(names[k] for k in significant)
            parts = np.array(combinations) @ estimate.beta * np.array(sizes)
            share = float(np.linalg.norm(parts[significant])) / max(
                _middle(rows.y[m][rows.used[m]]), np.finfo(float).tiny
            )
            yield Impossible(
                m, motor.label, negative, float(np.abs(t[significant]).min()), share, np.array(combinations)
            )


def _middle(signal: Array) -> float:
    """Size of a signal that a few jumps, as from log to log, do not change."""
    return float(np.median(np.abs(signal))) if signal.size else 0.0


def _masses(estimate: Estimate, c: Array) -> Array:
    """Diagonal of the mass matrix over these poses as a linear function of the base parameters, (rows, p)."""
    model = estimate.model
    made = np.zeros((len(model.device.row_names), len(model.base)))
    for k in range(len(model.base)):
        if model.device.parameters.kinds[model.base.independent_columns[k]] in (*INERTIAL, "IA"):
            M = core_mass(model, raw_parameters(model, np.eye(len(model.base))[k]), c)
            made[:, k] = np.diagonal(M.mean(axis=0))
    return made
