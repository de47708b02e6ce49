"""Characteristic sizes of parameters, which scale inertias from 1e-7 kg m^2 to 10 kg m^2 to numbers near one."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel

# Power of a length in the unit of each of a link's ten parameters.
POWER = np.array([2] * 6 + [1] * 3 + [0])
# Links shorter than this have no length of their own, m.
_SHORTEST = 1e-9
# A ball whose pseudo-inertia, in its own mass and length, is the identity.
BALL = np.array([2.0, 0, 0, 2.0, 0, 2.0, 0, 0, 0, 1.0])


@dataclass(frozen=True, eq=False)
class Scale:
    """Characteristic sizes.

    Attributes:
        mass, length: of every link, (joints,), kg and m.
        chi: of every standard parameter, (n,), SI.
        ball: raw parameters of a homogeneous ball for every link, and of terms of the size of their kind, (r,), SI.
    """

    mass: Array
    length: Array
    chi: Array
    ball: Array

    @staticmethod
    def of(model: DynamicModel, beta: Array) -> Scale:
        """Lengths from the geometry; masses and terms from the largest values that base parameters of this size allow.

        The sizes only set the units of margins and of the computation, not the feasible set.
        """
        length = _lengths(model)
        S, room = np.abs(model.device.parameters.S), largest(model.base.regrouping, beta)
        free = np.argmax(S, axis=1)
        raw = np.where(S.any(axis=1), room[free], np.nan)
        links = raw[: 10 * len(length)].reshape(-1, 10) / length[:, None] ** POWER
        mass = filled(np.array([upper_quantile(row) for row in links]))
        sizes = np.concatenate([(mass[:, None] * length[:, None] ** POWER).ravel(), term_sizes(model, raw)])
        ball = sizes * np.concatenate([np.tile(BALL, len(length)), np.ones(len(model.terms))])
        return Scale(mass, length, sizes[np.argmax(S, axis=0)], ball)


def largest(regrouping: Array, beta: Array) -> Array:
    """Each standard parameter as if it alone made up a base parameter, the least over the base parameters, (n,).

    NaN where it is in no base parameter other than zero.
    """
    used = (regrouping != 0) & (beta != 0)[:, None]
    with np.errstate(over="ignore"):  # lengths may be so small that a share of a base parameter is no number
        alone = np.where(used, np.abs(beta)[:, None] / np.where(used, np.abs(regrouping), 1.0), np.inf).min(axis=0)
    return np.where(np.isfinite(alone), alone, np.nan)


def upper_quantile(values: Array) -> float:
    """The 80 % quantile of the values that are neither NaN nor zero, which outliers do not move; zero without any."""
    known = values[values > 0]
    return float(np.quantile(known, 0.8)) if len(known) else 0.0


def filled(values: Array) -> Array:
    """Sizes, with the median of the others in place of zeros; one where all are zero."""
    return np.where(values > 0, values, np.median(known) if len(known := values[values > 0]) else 1.0)


def term_sizes(model: DynamicModel, raw: Array) -> Array:
    """The largest of every kind and unit, (terms,), SI."""
    own = np.nan_to_num(raw[10 * len(model.device.joints) :])
    kinds = [(term.kind, term.unit) for term in model.terms]
    most = {kind: max(v for v, k in zip(own, kinds, strict=True) if k == kind) for kind in kinds}
    return np.array([most[kind] or 1.0 for kind in kinds])


def _lengths(model: DynamicModel) -> Array:
    """Length of every link: to its children's joints, the cut joints, the handle, (joints,), m."""
    reach = np.zeros(len(model.device.joints))
    ends = [(joint.parent, joint.translation) for joint in model.device.joints]
    ends += [(f.link, f.translation) for cut in model.device.closure.cuts for f in (cut.frame_a, cut.frame_b)]
    if model.device.handle is not None:
        ends.append((model.device.handle.link, model.device.handle.translation))
    for link, end in ends:
        if link >= 0:
            reach[link] = max(reach[link], float(np.linalg.norm(end)))
    return filled(np.where(reach < _SHORTEST, 0.0, reach))
