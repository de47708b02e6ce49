"""Minimal set of second moments, first moments, masses and rotor inertias that the code computes with.

The inertia tensor J of a link follows from its second moments E by J = tr(E) 1 - E. In second moments the moment of
inertial forces is (U E) - (U E)', with U = skew(wd) + skew(w)^2, and the choice of base parameters can be used to
eliminate the zz entries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device.parameters import INERTIAL
from haptid.device.terms.term import TermColumn
from haptid.dynamics.base_parameters import NO_EFFECT, regroup, select_independent
from haptid.dynamics.model import DynamicModel
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import combined

# Order of preference among the kinds of parameters.
_PREFERENCE = ("YY", "XX", "MX", "MY", "XY", "XZ", "YZ", "rotor", "ZZ", "MZ", "M")
# Map from the six entries of the inertia tensor to the second moments, in the order of INERTIAL.
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
# Factors below this share of the largest in their row are rounding errors.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class SecondMoments:
    """Minimal parameters of bodies and rotors.

    Attributes:
        links: parameters of each link: kind to row of `factors`.
        rotors: term of each rotor, and row of `factors`.
        factors: map from the device's base parameters to these, (kept, p), SI.
    """

    links: tuple[Mapping[str, int], ...]
    rotors: tuple[tuple[TermColumn, int], ...]
    factors: Array

    def expressions(self, parameters: Sequence[Expr]) -> list[Expr]:
        """The parameters as linear combinations of base parameters."""
        return [combined(row, parameters) for row in self.factors]


def moments_of(model: DynamicModel, seed: int = 0) -> SecondMoments:
    """Minimal parameters that determine the torque of all rows, selected in the order of PREFERENCE.

    Args:
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
    order = sorted(np.flatnonzero(effective).tolist(), key=lambda k: (_PREFERENCE.index(kinds[k]), k))
    kept, Q, _ = select_independent(W / np.where(effective, lengths, 1.0), order, model.device.base_tolerance)
    kept = sorted(kept)
    factors = (
        regroup(W, Q, kept, effective) @ np.where(effective[:, None], S, 0.0)[:, list(model.base.independent_columns)]
    )
    largest = np.abs(factors).max(axis=1, initial=0.0, keepdims=True)
    factors[np.abs(factors) < _ROUNDING * largest] = 0.0
    bodies: list[dict[str, int]] = [{} for _ in model.device.joints]
    for row, k in enumerate(kept):
        if k < 10 * len(model.device.joints):
            bodies[k // 10][kinds[k]] = row
    turned = tuple(
        (model.terms[rotors[k - 10 * len(model.device.joints)]], row)
        for row, k in enumerate(kept)
        if k >= 10 * len(model.device.joints)
    )
    return SecondMoments(tuple(bodies), turned, freeze(factors))


def _changes(links: int, rotors: int) -> tuple[Array, Array]:
    """Map from the core's inertial parameters to second moments, and its inverse."""
    size = 10 * links + rotors
    change = np.eye(size)
    for i in range(0, 10 * links, 10):
        change[i : i + 6, i : i + 6] = TO_MOMENTS
    return change, np.asarray(np.linalg.inv(change), dtype=np.float64)


def _regressor(model: DynamicModel, columns: Sequence[int], seed: int) -> Array:
    """Columns of bodies and rotors at random states, for all torque rows, measured or not."""
    rng = np.random.default_rng(seed)
    n = len(model.device.active)
    states = 4 + -(-4 * len(columns) // n)
    c = np.ascontiguousarray(model.device.row_map @ model.device.closure.draw(rng, states))
    cd, cdd = rng.uniform(-2, 2, (2, n, states))
    own = np.zeros((len(model.externals), states))
    Y = np.asarray(model.mechanism.regressor(c, cd, cdd, own, list(columns), model.loops(c, cd)))
    return np.ascontiguousarray(Y.transpose(0, 2, 1).reshape(-1, len(columns)))
