"""Errors of an estimate from the bench against the true parameters."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.demos.recordings import BenchRecording
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.inference.targets import Targets

# A slower joint may stick, rad/s or m/s: its dry friction is then anything up to the Coulomb friction.
STICKS = 0.02
# Least share of a motor's torque for a parameter to count.
CARRIES = 0.02


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Errors of an estimate against the true parameters.

    Attributes:
        names: of the targets, (k,).
        errors: in per cent of the true values, (k,).
        inside: whether the true value is inside the 95 % interval, (k,).
        carried: largest share of a motor's torque due to each target, (k,).
        kinds: of each target, "viscous", "Coulomb" or "body", (k,).
        torque: relative error of the torque of each motor where no joint sticks, (motors,), per cent.
    """

    names: tuple[str, ...]
    errors: Array
    inside: np.ndarray
    carried: Array
    kinds: np.ndarray
    torque: Array

    def worst(self, kind: str) -> float:
        """Largest error of the targets of a kind, per cent; of bodies, those that carry a share of the torque."""
        counted = (self.kinds == kind) & ((kind != "body") | (self.carried >= CARRIES))
        return float(np.abs(self.errors[counted]).max(initial=0.0))


def accuracy(estimated: Targets | Estimate, recording: BenchRecording, time_range: tuple[float, float]) -> Accuracy:
    """Targets, or base parameters, against the truth; torques are compared between two times of the recording, s."""
    model, estimate = recording.model, estimated.estimate if isinstance(estimated, Targets) else estimated
    C = estimated.C if isinstance(estimated, Targets) else np.eye(len(estimate.beta))
    value = C @ estimate.beta
    low, high = estimated.conf_int().T
    moving = (np.abs(recording.qd) > STICKS).all(axis=0) & recording.during(time_range)
    states = tuple(x[:, moving] for x in (recording.q, recording.qd, recording.qdd))
    truth, torque = C @ recording.beta, inverse_dynamics(model, recording.beta, *states)
    missed = inverse_dynamics(model, estimate.beta, *states) - torque
    sizes = np.linalg.norm(torque, axis=1)
    parts = np.linalg.solve(C, np.diag(truth)).T
    shares = [np.linalg.norm(inverse_dynamics(model, part, *states), axis=1) / sizes for part in parts]
    return Accuracy(
        names=estimated.names,
        errors=100 * (value - truth) / np.where(_zero(truth), np.inf, np.abs(truth)),
        inside=(low <= truth) & (truth <= high),
        carried=np.max(shares, axis=1),
        kinds=np.array([_kind(model, row) for row in C]),
        torque=100 * np.linalg.norm(missed, axis=1) / sizes,
    )


def _zero(truth: Array) -> np.ndarray:
    """Which true values are zero but for rounding: they have no relative error."""
    return np.asarray(np.abs(truth) <= 1e-9 * np.abs(truth).max())


def _kind(model: DynamicModel, row: Array) -> str:
    """Kind of a target: friction of one sort, or bodies."""
    kinds = {model.device.parameters.kinds[model.base.independent_columns[k]][:2] for k in np.flatnonzero(row)}
    return {"FV": "viscous", "FC": "Coulomb"}.get(kinds.pop(), "body") if len(kinds) == 1 else "body"
