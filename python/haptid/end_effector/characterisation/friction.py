"""Friction at the handle: viscous friction, and dry friction that depends on the direction of motion."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.terms.friction import DRY
from haptid.device.terms.term import TermColumn
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.jacobian import HandleJacobian

# A joint is at rest in a motion where its rate is below this share of the fastest one's.
STILL = 1e-9


def viscous_matrix(model: DynamicModel, beta: Array, qa: Array) -> Array:
    """Viscous friction matrix of the torque rows' coordinates, (poses, active, active), N m s/rad."""
    made = np.zeros((qa.shape[1], *(len(model.device.active),) * 2))
    for term, value in _terms(model, beta, ("viscous",)):
        shares = _shares(model, term, qa)
        made += value * np.einsum("as,bs->sab", shares, shares) / (2 if term.side else 1)
    return made


def dry_torque(model: DynamicModel, beta: Array, qa: Array, rates: Array) -> Array:
    """Dry friction of a motion in the limit of low speed, (active, samples), N m or N: only signs of rates count.

    Stribeck terms have their value at rest. Coordinates at rest have no friction here, though they may have stiction.

    Args:
        beta: its base parameters, (p,), SI.
        qa: positions of the active joints, (active, samples), rad or m.
        rates: of the torque rows' coordinates, (active, samples).
    """
    made = np.zeros_like(rates)
    fastest = np.abs(rates).max(axis=0, initial=0.0)
    for term, value in _terms(model, beta, DRY):
        shares = _shares(model, term, qa)
        rate = (shares * rates).sum(axis=0)
        sign = np.where(np.abs(rate) > STILL * fastest, np.sign(rate), 0.0)
        if term.kind == "coulomb+":
            sign = np.maximum(sign, 0.0)
        elif term.kind == "coulomb-":
            sign = np.minimum(sign, 0.0)
        made += value * shares * sign
    return made


def coulomb_level(model: DynamicModel, beta: Array, qa: Array) -> Array:
    """Sum of the dry friction on each coordinate, (active, poses), N m or N: Fc in Janot et al. (2007)."""
    made = np.zeros((len(model.device.active), qa.shape[1]))
    for term, value in _terms(model, beta, DRY):
        made += value * np.abs(_shares(model, term, qa)) / (2 if term.side else 1)
    return made


def _shares(model: DynamicModel, term: TermColumn, qa: Array) -> Array:
    """Rates of a term's velocity with respect to the coordinates, (active, poses) or (active, 1)."""
    return model.shares(term, model.device.row_map @ qa, np.zeros_like(qa))


def _terms(model: DynamicModel, beta: Array, kinds: tuple[str, ...]) -> list[tuple[TermColumn, float]]:
    """Terms of these kinds with a nonzero parameter, each with its parameter."""
    values = raw_parameters(model, beta)[10 * len(model.device.joints) :]
    pairs = zip(model.terms, values, strict=True)
    return [(term, float(value)) for term, value in pairs if term.nature in kinds and value]


def force_at_handle(handle: HandleJacobian, inverse: Array, torque: Array) -> Array:
    """Force at the handle, (poses, m), in equilibrium with torques of all coordinates, (active, poses)."""
    return np.asarray(np.einsum("pnm,np->pm", inverse, torque[list(handle.moving)]))
