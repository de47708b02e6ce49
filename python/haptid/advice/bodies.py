"""Proofs where the prediction would not change: bodies that can exist, and the device file's prior bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.rows import TrialRows
from haptid.device.parameters import INERTIAL
from haptid.dynamics.inverse import core_mass, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import device_rows

# Standard errors by which everything that must be positive of a motor is negative.
IMPOSSIBLE = 3.0
# Poses at which the inertia of a motor is evaluated.
_POSES = 16
# Least share of what is negative in the torque of a motor that is reversed.
SHOWS = 0.05


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
        least: values of these below which each is negative beyond its uncertainty, (count,): 0 of those that were.
    """

    motor: int
    label: str
    names: tuple[str, ...]
    t: float
    share: float
    combinations: Array
    least: Array


def impossible(estimate: Estimate, rows: TrialRows) -> Iterator[Impossible]:
    """Motors of which everything that must be positive is significantly negative.

    Args:
        estimate: of the parameters.
        rows: of the trials.
    """
    for one in _must_be_positive(estimate, rows):
        significant = one.significant
        told = len(significant) > 1 or not {0, *one.dry}.isdisjoint(significant)  # a delay makes viscosity negative
        if told and all(one.t[k] < 0 for k in significant):
            negative = tuple(one.names[k] for k in significant)
            parts = one.combinations @ estimate.beta * one.sizes
            share = float(np.linalg.norm(parts[significant])) / max(
                _middle(rows.y[one.motor][rows.used[one.motor]]), np.finfo(float).tiny
            )
            least = float(np.abs(one.t[significant]).min())
            below = np.where(np.isin(np.arange(len(one.t)), significant), 0.0, -IMPOSSIBLE * one.se)
            yield Impossible(one.motor, one.label, negative, least, share, one.combinations, below)


def right_signs(estimate: Estimate, rows: TrialRows) -> frozenset[int]:
    """Motors, by number, whose torque reversed had a significantly negative inertia or friction, which cannot be.

    Args:
        estimate: of the parameters.
        rows: of the trials.
    """
    found = _must_be_positive(estimate, rows)
    return frozenset(one.motor for one in found if any(one.t[k] > 0 for k in one.significant))


def inertias_below_zero(model: DynamicModel, rows: TrialRows) -> Callable[[Array], int]:
    """How many motors have a negative inertia by base parameters, (p,), that shows in their torque.

    Args:
        model: of the columns.
        rows: of the trials.
    """
    motors = list(model.known_rows)
    M = _masses(model, _poses(rows))[motors]
    acceleration = _acceleration(rows)[motors]
    torque = np.array([_middle(y[used]) for y, used in zip(rows.y, rows.used, strict=True)])
    size = np.array(list(map(_middle, acceleration)))
    share = M * np.divide(size, torque, out=np.zeros(len(torque)), where=torque > 0)[:, None]
    return lambda beta: int((share @ beta < -SHOWS).sum())


@dataclass(frozen=True, eq=False)
class _Positive:
    """What must be positive of a motor: the inertia that it moves, and its own friction.

    Attributes:
        motor, label: of the motor.
        names: of the combinations.
        combinations: of the base parameters, (count, p).
        sizes: factor of each in the torque.
        se, t: standard error of each, and it over that.
        significant: those, by number, that are far from zero.
        dry: those, by number, of dry friction.
    """

    motor: int
    label: str
    names: tuple[str, ...]
    combinations: Array
    sizes: Array
    se: Array
    t: Array
    significant: list[int]
    dry: tuple[int, ...]


def _must_be_positive(estimate: Estimate, rows: TrialRows) -> Iterator[_Positive]:
    model, kinds = estimate.model, estimate.model.device.parameters.kinds
    M, acceleration = _masses(model, _poses(rows)), _acceleration(rows)
    for m, (row, motor) in enumerate(zip(device_rows(estimate), estimate.observation.motors, strict=True)):
        others = [set(o.columns.tolist()) for k, o in enumerate(estimate.observation.motors) if k != m]
        combinations, names, own_kinds = [M[row]], ["inertia"], ["inertia"]
        sizes = [_middle(acceleration[row])]  # of the factor of each
        for k in motor.columns:
            own = model.base.independent_columns[int(k)]
            if kinds[own] in ("FC", "FV") and not any(int(k) in there for there in others):
                combinations.append(np.eye(len(model.base))[int(k)])
                names.append(model.base.names[int(k)])
                own_kinds.append(kinds[own])
                sizes.append(1.0 if kinds[own] == "FC" else _middle(rows.velocity[row]))
        C = np.array(combinations)
        se = np.sqrt(np.diag(estimate.spread(C).covariance))
        t = C @ estimate.beta / np.maximum(se, np.finfo(float).tiny)
        significant = [k for k in range(len(t)) if se[k] > 0 and abs(t[k]) > IMPOSSIBLE]
        dry = tuple(k for k, kind in enumerate(own_kinds) if kind == "FC")
        yield _Positive(m, motor.label, tuple(names), C, np.array(sizes), se, t, significant, dry)


def _middle(signal: Array) -> float:
    """Size of a signal that a few jumps, as from log to log, do not change."""
    return float(np.median(np.abs(signal))) if signal.size else 0.0


def _poses(rows: TrialRows) -> Array:
    """Positions of some rows, (coordinates, poses)."""
    return rows.position[:, np.linspace(0, rows.position.shape[1] - 1, _POSES).astype(int)]


def _acceleration(rows: TrialRows) -> Array:
    """Of the coordinates at the rows, (coordinates, rows)."""
    return np.gradient(rows.velocity, rows.t, axis=1) if len(rows.t) > 1 else np.zeros_like(rows.velocity)


def _masses(model: DynamicModel, c: Array) -> Array:
    """Diagonal of the mass matrix over these poses as a linear function of the base parameters, (rows, p)."""
    made = np.zeros((len(model.device.row_names), len(model.base)))
    for k in range(len(model.base)):
        if model.device.parameters.kinds[model.base.independent_columns[k]] in (*INERTIAL, "IA"):
            M = core_mass(model, raw_parameters(model, np.eye(len(model.base))[k]), c)
            made[:, k] = np.diagonal(M.mean(axis=0))
    return made
