"""The parameters that the code computes with: second moments, as few as the torque needs.

The inertia tensor J of a link is the trace of its second moments less these: J = tr(E) 1 - E. In second moments the
moment of inertial forces is (U E) - (U E)', with U = skew(wd) + skew(w)^2, and the freedom of base parameters can be
used to make the zz entries vanish.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.device.parameters import INERTIAL
from haptid.dynamics.base_parameters import NO_EFFECT, eliminate, regroup
from haptid.dynamics.model import DynamicModel
from haptid.export.graph import Expr
from haptid.export.vectors import combined

# Kept first to last.
PREFERENCE = ("YY", "XX", "MX", "MY", "XY", "XZ", "YZ", "rotor", "ZZ", "MZ", "M")
# From the inertia tensor's six entries to the second moments', in the order of INERTIAL.
TO_MOMENTS = 0.5 * np.array(
    [
        [-1, 0, 0, 1, 0, 1],
        [0, -2, 0, 0, 0, 0],
        [0, 0, -2, 0, 0, 0],
        [1, 0, 0, -1, 0, 1],
        [0, 0, 0, 0, -2, 0],
        [1, 0, 0, 1, 0, -1],
    ],
    dtype=float,
)
# A factor this small beside the largest of its row is rounding.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Moments:
    """Parameters of the bodies and rotors that remain.

    Attributes:
        links: what each link keeps: kind to row of `factors`.
        rotors: weights over the coordinates' accelerations, (active,), and row of `factors`.
        factors: the parameters from the device's base parameters, (kept, p), SI.
    """

    links: tuple[Mapping[str, int], ...]
    rotors: tuple[tuple[Array, int], ...]
    factors: Array

    def expressions(self, parameters: Sequence[Expr]) -> list[Expr]:
        """The parameters as sums of base parameters, made once."""
        return [combined(row, parameters) for row in self.factors]


def moments_of(model: DynamicModel, seed: int = 0) -> Moments:
    """The second moments that determine the torque of all rows, chosen in the order of PREFERENCE.

    Args:
        model: the dynamic model.
        seed: of the random states; the result does not depend on it.
    """
    rotors = [k for k, term in enumerate(model.terms) if term.kind == "rotor"]
    raw = [*range(10 * len(model.device.joints)), *(10 * len(model.device.joints) + k for k in rotors)]
    change, inverse = _changes(len(model.device.joints), len(rotors))
    W = _regressor(model, raw, seed) @ inverse
    S = change @ model.device.parameters.S[raw]
    kinds = [*(INERTIAL * len(model.device.joints)), *(["rotor"] * len(rotors))]
    lengths = np.linalg.norm(W, axis=0)
    effective = (lengths > NO_EFFECT * lengths.max(initial=0.0)) & (S != 0).any(axis=1)
    order = sorted(np.flatnonzero(effective).tolist(), key=lambda k: _rank(kinds[k], k))
    kept, Q, _ = eliminate(W / np.where(effective, lengths, 1.0), order, model.device.base_tolerance)
    kept = sorted(kept)
    factors = (
        regroup(W, Q, kept, effective) @ np.where(effective[:, None], S, 0.0)[:, list(model.base.independent_columns)]
    )
    largest = np.abs(factors).max(axis=1, initial=0.0, keepdims=True)
    factors[np.abs(factors) < ROUNDING * largest] = 0.0
    bodies: list[dict[str, int]] = [{} for _ in model.device.joints]
    for row, k in enumerate(kept):
        if k < 10 * len(model.device.joints):
            bodies[k // 10][kinds[k]] = row
    turned = tuple(
        (model.terms[rotors[k - 10 * len(model.device.joints)]].weights, row)
        for row, k in enumerate(kept)
        if k >= 10 * len(model.device.joints)
    )
    return Moments(tuple(bodies), turned, freeze(factors))


def _rank(kind: str, k: int) -> tuple[int, int]:
    place = PREFERENCE.index(kind)
    return (place, k)


def _changes(links: int, rotors: int) -> tuple[Array, Array]:
    """From the core's inertial columns' parameters to second moments, and back."""
    size = 10 * links + rotors
    change = np.eye(size)
    for i in range(0, 10 * links, 10):
        change[i : i + 6, i : i + 6] = TO_MOMENTS
    return change, np.asarray(np.linalg.inv(change), dtype=np.float64)


def _regressor(model: DynamicModel, columns: Sequence[int], seed: int) -> Array:
    """Bodies' and rotors' columns at random states, all rows: measured or not, the code gives them."""
    rng = np.random.default_rng(seed)
    n = len(model.device.drives)
    states = 4 + -(-4 * len(columns) // n)
    c = rng.uniform(-np.pi, np.pi, (n, states))
    cd, cdd = rng.uniform(-2, 2, (2, n, states))
    own = np.zeros((len(model.externals), states))
    Y = np.asarray(model.mechanism.regressor(c, cd, cdd, own, list(columns)))
    return np.ascontiguousarray(Y.transpose(0, 2, 1).reshape(-1, len(columns)))
