"""Base parameters, numerically: the smallest parameter set that determines the torque, and the regrouping into it.

Source: Gautier (1991), J. Robotic Systems 8(4), with an ordered elimination in place of the pivoted QR, so that the
parameters kept are those of the literature.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.regressor import rows
from haptid.errors import IdentifiabilityError

if TYPE_CHECKING:
    from haptid.dynamics.model import DynamicModel

# A column this small relative to the largest has no effect. Tested before columns are scaled to unit length: scaled
# rounding noise would otherwise count as rank.
NO_EFFECT = 1e-12
# A regrouping coefficient this small relative to the ratio of its columns' lengths is rounding.
_ROUNDING = 1e-9
# Least ratio between the least independent column kept and the most independent one dropped.
CLEAR_GAP = 1e3
# Rest of a combination outside the base parameters, as a share of what cancelled: below this it is rounding.
CANCELLED = 1e-7
# Most groupings that an error lists.
MOST_GROUPS = 3
# Columns that are made independent of those before together.
_TOGETHER = 64
# Within a link, the parameters that the literature keeps come first.
_PREFERENCE = ("ZZ", "XX", "XY", "XZ", "YZ", "MX", "MY", "IA", "YY", "MZ", "M")


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The base parameters of a device: beta = regrouping @ chi.

    Attributes:
        names: ZZ1R where others regroup into ZZ1, FC2 where nothing does, (p,).
        units: of each, (p,).
        independent_columns: index in the device's standard parameters of the one each is named after, (p,).
        regrouping: (p, standard parameters), the identity on `independent_columns`.
        standard: names of the standard parameters.
        no_effect: names of the standard parameters without effect on any torque.
        tolerance: relative length below which a column counts as a combination of those before it.
        gap: least relative length kept, and greatest dropped (0 where nothing was).
        lengths: of the standard parameters' columns at the random states, (standard parameters,).
        growth: how much rounding grows in each row of the regrouping: norm of the row of the inverse of R, of columns
            of unit length, (p,).
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    independent_columns: tuple[int, ...]
    regrouping: Array
    standard: tuple[str, ...]
    no_effect: tuple[str, ...]
    tolerance: float
    gap: tuple[float, float]
    lengths: Array
    growth: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "regrouping", lengths=(len(self.standard),), growth=(len(self.names),))

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def groupings(self) -> tuple[str, ...]:
        """Readable formulas, such as `ZZ1 + IA1 + YY2 + 0.2025 M3`."""
        return tuple(
            formula(row, self.standard, column)
            for row, column in zip(self.regrouping, self.independent_columns, strict=True)
        )

    @property
    def is_clear(self) -> bool:
        """Whether the numerical rank is unambiguous: a wide gap between columns kept and columns dropped."""
        return self.gap[0] > CLEAR_GAP * max(self.gap[1], np.finfo(float).eps)

    def of(self, chi: Array) -> Array:
        """Base parameters of standard parameters chi, (p,)."""
        return np.asarray(self.regrouping @ chi)


def formula(coefficients: Array, names: tuple[str, ...], first: int) -> str:
    """A linear combination as text, the named entry first, then in the parameters' own order."""
    others = [int(k) for k in np.flatnonzero(coefficients) if k != first]
    text = ""
    for k in (first, *others):
        value = float(coefficients[k])
        size = "" if np.isclose(abs(value), 1.0, rtol=1e-9) else f"{abs(value):.6g} "
        sign = ("- " if value < 0 else "+ ") if text else ("-" if value < 0 else "")
        text += f"{' ' if text else ''}{sign}{size}{names[k]}"
    return text


def base_parameters(model: DynamicModel, seed: int = 0) -> BaseParameters:
    """Base parameters of a device, from the regressor at random states.

    Columns are taken in order of preference and kept when they are independent of those kept before: the device
    file's own choices, then link by link ZZ XX XY XZ YZ MX MY IA YY MZ M, then the other terms, those of motors and
    active joints before those of passive joints.

    Args:
        seed: of the random states; the result does not depend on it.
    """
    return base_parameters_of(model, random_regressor(model, seed), model.device.base_tolerance)


def base_parameters_of(model: DynamicModel, W: Array, tolerance: float) -> BaseParameters:
    """Base parameters of some rows of a regressor.

    Args:
        W: regressor of the standard parameters, (rows, standard parameters).
        tolerance: relative length below which a column counts as a combination of those before it.
    """
    parameters = model.device.parameters
    lengths = np.linalg.norm(W, axis=0)
    effective = lengths > NO_EFFECT * lengths.max(initial=0.0)
    order = [k for k in preference(model) if effective[k]]
    independent, Q, gap = select_independent(W / np.where(effective, lengths, 1.0), order, tolerance)
    independent = sorted(independent)  # shown in the parameters' own order
    regrouping = regroup(W, Q, independent, effective)
    R = Q.T @ (W[:, independent] / lengths[independent])
    names = tuple(
        parameters.names[k] + ("R" if np.count_nonzero(row) > 1 else "")
        for k, row in zip(independent, regrouping, strict=True)
    )
    return BaseParameters(
        names=names,
        units=tuple(parameters.units[k] for k in independent),
        independent_columns=tuple(independent),
        regrouping=regrouping,
        standard=tuple(parameters.names),
        no_effect=tuple(parameters.names[k] for k in np.flatnonzero(~effective)),
        tolerance=tolerance,
        gap=gap,
        lengths=lengths,
        growth=np.linalg.norm(np.linalg.inv(R), axis=1),
    )


def random_regressor(model: DynamicModel, seed: int, columns: int | None = None) -> Array:
    """The regressor of the standard parameters at random states, (rows, standard parameters).

    Only measured torques have rows: what acts on an unmotorised axis alone is not identifiable. Positions cover the
    whole circle, whatever the joint limits: identifiability is a property of the structure. Positions of loops that
    close at some poses only are drawn from these, inside the limits.

    Args:
        seed: of the random states.
        columns: there are four times as many rows; None: as the standard parameters.
    """
    rng = np.random.default_rng(seed)
    S = model.device.parameters.S
    states = 4 + -(-4 * (S.shape[1] if columns is None else columns) // max(sum(model.device.known), 1))
    c = model.device.row_map @ model.device.closure.draw(rng, states)
    cd, cdd = rng.uniform(-2, 2, (2, *c.shape))
    # What is left of the motion before is any number: laws with other constants then differ.
    history = {name: rng.uniform(-1, 1, states) for name in model.history(c, cd, np.zeros(states))}
    Y = rows(model, c, cd, cdd, history)[list(model.device.known)]
    return np.asarray(Y.transpose(0, 2, 1).reshape(-1, Y.shape[1]) @ S)


def preference(model: DynamicModel) -> list[int]:
    """Indices of the standard parameters, in the order in which they are preferred as base parameters."""
    parameters = model.device.parameters
    first = {name: k for k, name in enumerate(model.device.keep)}
    rank = {kind: k for k, kind in enumerate(_PREFERENCE)}

    def key(k: int) -> tuple[int, int, int, int]:
        kind, link = parameters.kinds[k], parameters.links[k]
        chosen = first.get(parameters.names[k], len(first))
        if kind in rank:
            return (chosen, link, rank[kind], k)
        passive = link >= 0 and link not in model.device.active
        return (chosen, len(model.device.joints), passive, k)

    return sorted(range(len(parameters.names)), key=key)


def select_independent(W: Array, order: list[int], tolerance: float) -> tuple[list[int], Array, tuple[float, float]]:
    """Ordered elimination: columns of unit length are kept when independent of those kept before.

    Returns:
        the columns kept, an orthonormal basis of them, and the least length kept and greatest dropped.
    """
    Q = np.empty((len(W), min(W.shape)), order="F")
    independent: list[int] = []
    least, greatest = 1.0, 0.0
    for start in range(0, len(order), _TOGETHER):
        block = order[start : start + _TOGETHER]
        before = Q[:, : len(independent)]
        rests = W[:, block] - before @ (before.T @ W[:, block])
        rests -= before @ (before.T @ rests)
        for k, rest in zip(block, rests.T, strict=True):
            own = Q[:, len(before.T) : len(independent)]
            rest = rest - own @ (own.T @ rest)
            length = float(np.linalg.norm(rest))
            if 0.01 * tolerance < length < 0.05:  # much was cancelled: once more is enough (Kahan and Parlett)
                rest -= Q[:, : len(independent)] @ (Q[:, : len(independent)].T @ rest)
                length = float(np.linalg.norm(rest))
            if length > tolerance and len(independent) < Q.shape[1]:
                least = min(least, length)
                Q[:, len(independent)] = rest / length
                independent.append(k)
            else:
                greatest = max(greatest, length)
    return independent, Q[:, : len(independent)], (least, greatest)


def regroup(W: Array, Q: Array, independent: list[int], effective: np.ndarray) -> Array:
    """Coefficients of every standard parameter in the base parameters, (kept, standard)."""
    lengths = np.linalg.norm(W, axis=0)
    scale = lengths[independent][:, None]
    R = Q.T @ (W[:, independent] / scale.T)  # of unit columns: parameters of small effect do not spoil its condition
    coefficients = np.linalg.solve(R, Q.T @ W) / scale if independent else np.zeros((0, W.shape[1]))
    # What a coefficient changes in a column, relative to that column: below ROUNDING it is noise.
    share = np.abs(coefficients) * lengths[independent][:, None] / np.where(effective, lengths, np.inf)
    coefficients[share < _ROUNDING] = 0.0
    coefficients[:, independent] = np.eye(len(independent))
    return coefficients


def base_combinations(model: DynamicModel, names: Sequence[str], rows: Array) -> Array:
    """Combinations of standard parameters, (k, n), as combinations of base parameters, (k, p).

    A combination is identifiable iff C_kept @ regrouping reproduces its other coefficients.

    Raises:
        IdentifiabilityError: a combination is not identifiable, given by its name.
    """
    base = model.base
    C = rows[:, list(base.independent_columns)]
    shown = C @ base.regrouping
    cancelled = np.abs(rows) + np.abs(C) @ np.abs(base.regrouping)
    hidden = np.where(np.abs(rows - shown) > CANCELLED * cancelled, rows - shown, 0.0)
    for k in np.flatnonzero(hidden.any(axis=1)).tolist():
        raise _unidentifiable(model, names[k], hidden[k], shown[k])
    return freeze(np.ascontiguousarray(C))


def _unidentifiable(model: DynamicModel, target: str, hidden: Array, shown: Array) -> IdentifiabilityError:
    base = model.base
    holding = np.flatnonzero((base.regrouping[:, hidden != 0] != 0).any(axis=1) & (not shown.any()))
    groups = [f"{base.names[k]} = {base.groupings[k]}" for k in holding[:MOST_GROUPS]]
    texts = [formula(row, base.standard, int(np.argmax(row != 0))) if row.any() else "" for row in (hidden, shown)]
    combination = f" What it shows is {texts[1]}." if texts[1] else ""
    within = f" It is identifiable only within {'; '.join(groups)}." if groups else ""
    return IdentifiabilityError(
        f"target {target} is not identifiable: no torque of this device depends on {texts[0]} by itself."
        f"{combination}{within}",
        where=target,
        found=texts[0],
        advice="Write the target as a sum of base parameters; `haptid model` prints them with their regrouping.",
    )
