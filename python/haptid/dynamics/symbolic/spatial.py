"""Loops that are neither linear nor planar dyads: relations that closing them adds to those of the opened mechanism.

States that close such a loop modulo a prime would need the roots of polynomials of high degree. But every relation of
the mechanism with these loops opened holds when they are closed, and is exact; what closing adds are few and short
relations among the base parameters of the opened mechanism. Their coefficients are known as numbers at any lengths, by
Newton's method and least squares, and are recognised as Laurent polynomials in the lengths that reproduce them at
more sets of lengths than they have unknowns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Device, NewtonClosure
from haptid.device.toml.reader import resized
from haptid.dynamics.base_parameters import NO_EFFECT, random_regressor
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.symbolic.arithmetic import PRIMES, Coefficient, Laurent, Points, Powers, PrimeField, Residues
from haptid.dynamics.symbolic.chain import SymbolicChain, assembled, linear_motion
from haptid.dynamics.symbolic.interpolation import EXPONENT_RANGES, monomials
from haptid.dynamics.symbolic.loops import opened_tree
from haptid.dynamics.symbolic.regressor import Columns, Pivots
from haptid.dynamics.symbolic.symbols import DIMENSIONS, LENGTH, Dimension, Symbol, dimension_ratio
from haptid.errors import LoopClosureError, RegroupingError, SingularityError

# Random sets of lengths: few first, more for coefficients that do not fit.
_SETS = (8, 32)
# Lengths are drawn within this share of their own, so that the loops still close; most draws of a set.
_SPREAD, _DRAWS = 0.1, 20
# Least number of sets beyond the unknowns of a fit.
_SPARE = 3
# Columns that leave this much of themselves depend on those kept. Coefficients are known to where they change a column
# by this share of it, or by rounding, for columns kept that nearly depend on others.
_DEPENDENT, _KNOWN, _ROUNDING = 1e-7, 1e-8, 1e-12
# Largest denominator of a number in a formula, and how far a number may be from it: lengths 10 % apart leave the
# monomials of a coefficient nearly dependent.
_DENOMINATOR, _NEAR = 12, 1e-3


@dataclass(frozen=True)
class ClosedColumns(Columns):
    """The columns of a mechanism with its loops closed, from those with its loops opened.

    Attributes:
        opened: which columns are independent with the loops opened.
        dropped: those of them that are not with the loops closed.
        coefficients: of dropped columns in the others, by (kept, dropped); those that are zero are left out.
    """

    opened: Pivots
    dropped: tuple[int, ...]
    coefficients: Mapping[tuple[int, int], Coefficient]

    def sample(self, rng: np.random.Generator, points: Points, samples: int) -> Residues:
        """Rows in which all relations hold, of any entries in the columns kept."""
        field, opened = points.field, Columns(self.chain, self.members)
        others = [k for k in range(len(self.members)) if k not in self.opened.kept]
        W = np.zeros((points.count, samples * self.chain.torques, len(self.members)), dtype=np.int64)
        for k in self.opened.kept:
            if k not in self.dropped:
                W[:, :, k] = field.draw(rng, *W.shape[:2])
        for (i, k), coefficient in self.coefficients.items():
            share = W[:, :, i] * coefficient.modulo(points)[:, None]
            W[:, :, k] = field.reduce(W[:, :, k] + share)
        relations = opened.relations(rng, points, self.opened, others)
        for row, i in enumerate(self.opened.kept):
            for column in np.flatnonzero(relations[:, row].any(axis=0)):
                share = W[:, :, i] * relations[:, row, column, None]
                W[:, :, others[column]] = field.reduce(W[:, :, others[column]] + share)
        return W


def opened_chain(model: DynamicModel) -> SymbolicChain:
    """The mechanism with the loops opened that are not linear: their passive joints are active.

    Raises:
        RegroupingError: an opened loop has relations, or terms may act on its cut.
    """
    device = model.device
    assert isinstance(device.closure, NewtonClosure)
    passive = {device.joint_names[j] for j in device.closure.unknown}
    opened = opened_tree(device.tables, device.name, passive).with_gravity(device.gravity)
    chain = assembled(
        opened, opened.tables, range(len(opened.active)), None, lambda _, __, symbols: linear_motion(opened, symbols)
    )
    known = {symbol.name for symbol in chain.symbols}
    lengths = (Symbol(name, device.lengths[name], LENGTH) for name in _varied(device) if name not in known)
    return replace(chain, symbols=(*chain.symbols, *lengths))


def closed_columns(model: DynamicModel, columns: Columns, order: Sequence[int], seed: int) -> ClosedColumns:
    """The columns with the loops closed.

    Args:
        model: with its loops.
        columns: with the loops opened, in order of preference.
        order: index of the standard parameter of each column.
        seed: of random lengths and states; the result does not depend on it.

    Raises:
        RegroupingError: a base parameter of the closed mechanism is none of the opened one; the loops close at no other
            lengths; or a coefficient is no Laurent polynomial of low degree in the named lengths.
    """
    opened = columns.pivots(PrimeField(PRIMES[0]), np.random.default_rng(seed))
    closed = set(model.base.independent_columns)
    independent = [k for k in opened.kept if order[k] in closed]
    dropped = [k for k in opened.kept if order[k] not in closed]
    if len(independent) < len(closed):
        raise _unclear(model, "base parameters with loops closed are not among those with loops opened")
    numbers = _Numbers(model, ([order[k] for k in independent], [order[k] for k in dropped]), seed)
    forms = _forms(numbers, model, [order[k] for k in independent], [order[k] for k in dropped])
    coefficients = {(independent[i], dropped[k]): coefficient for (i, k), coefficient in forms.items()}
    return ClosedColumns(columns.chain, columns.members, opened, tuple(dropped), coefficients)


def _forms(
    numbers: _Numbers, model: DynamicModel, independent: Sequence[int], dropped: Sequence[int]
) -> dict[tuple[int, int], Coefficient]:
    """Formulas of the coefficients that are not zero, by (kept, dropped).

    Raises:
        RegroupingError: one of them has none.
    """
    parameters, varied = model.device.parameters, [symbol.name for symbol in numbers.varied]
    units = [DIMENSIONS.get(unit) for unit in parameters.units]
    left = {
        (i, k): dimension_ratio(units[a], units[b]) for i, a in enumerate(independent) for k, b in enumerate(dropped)
    }
    forms: dict[tuple[int, int], Coefficient] = {}
    for count in _SETS:
        numbers.extend(count)
        for place, dimension in list(left.items()):
            coefficient = _fit(numbers, place, dimension)
            if coefficient is not None:
                del left[place]
                if coefficient.numerator.terms:
                    forms[place] = coefficient
        if not left:
            return forms
    i, k = next(iter(left))
    names = parameters.names[independent[i]], parameters.names[dropped[k]]
    raise RegroupingError(
        f"the coefficient of {names[1]} in base parameter {names[0]} has no formula: no Laurent polynomial of low "
        f"degree in {', '.join(varied) or 'named lengths (there are none)'} fits at {len(numbers.values)} sets.",
        where=names,
        advice="Name the lengths that loops depend on in [lengths], or use the groupings of `base_parameters`.",
    )


class _Numbers:
    """Coefficients of the dropped columns in those kept, as numbers, at sets of lengths.

    The first set is the device's own; each of the next has one length changed, all others random ones.
    """

    def __init__(self, model: DynamicModel, columns: tuple[Sequence[int], Sequence[int]], seed: int) -> None:
        self._model, self._columns, self._rng = model, columns, np.random.default_rng(seed)
        self.varied = [Symbol(name, model.device.lengths[name], LENGTH) for name in _varied(model.device)]
        own = {symbol.name: symbol.value for symbol in self.varied}
        self.lengths: list[Mapping[str, float]] = [own]
        self.values: list[Array] = []
        first, self.unknown = _coefficients(model, columns)
        self.values.append(first)
        for symbol in self.varied:
            self._add({symbol.name})

    def extend(self, count: int) -> None:
        """Random sets until there are this many."""
        while len(self.values) < 1 + len(self.varied) + count:
            self._add({symbol.name for symbol in self.varied})

    def _add(self, changed: set[str]) -> None:
        own = self.lengths[0]
        for _ in range(_DRAWS):
            moved = {n: x * (1 + _SPREAD * self._rng.uniform(-1, 1)) if n in changed else x for n, x in own.items()}
            try:
                values, _ = _coefficients(_at_lengths(self._model, moved), self._columns)
            except (LoopClosureError, SingularityError):
                continue
            self.lengths.append(moved)
            self.values.append(values)
            return
        raise _unclear(self._model, f"the loops do not close where {', '.join(sorted(changed))} differ by 10 %")


def _fit(numbers: _Numbers, place: tuple[int, int], dimension: Dimension | None) -> Coefficient | None:
    """One coefficient from its numbers, None where no form fits."""
    y, limit = np.array([values[place] for values in numbers.values]), float(numbers.unknown[place])
    moving = [symbol for symbol, value in zip(numbers.varied, y[1:], strict=False) if abs(value - y[0]) > limit]
    if not moving:
        forms: Iterator[tuple[Powers, ...]] = iter([((),)])
    elif dimension is None:
        return None
    else:
        forms = (tuple(islice(monomials(moving, dimension, *span), len(y))) for span in EXPONENT_RANGES)
    fits = (_polynomial(numbers.lengths, y, form, limit) for form in forms if 0 < len(form) <= len(y) - _SPARE)
    return next((Coefficient(fit) for fit in fits if fit is not None), None)


def _polynomial(
    lengths: Sequence[Mapping[str, float]], y: Array, form: Sequence[Powers], limit: float
) -> Laurent | None:
    """The combination of monomials with ratios of small integers that has these values, None where there is none."""
    monomial = [Laurent.of([(exponents, Fraction(1))]) for exponents in form]
    values = np.array([[each.value(point) for each in monomial] for point in lengths])
    sizes = np.abs(values).max(axis=0)
    factors = np.linalg.lstsq(values / sizes, y, rcond=None)[0] / sizes
    ratios = [Fraction(float(factor)).limit_denominator(_DENOMINATOR) for factor in factors]
    rounded = np.array([float(ratio) for ratio in ratios])
    residual = np.abs(values @ rounded - y)
    if (np.abs(factors - rounded) > _NEAR).any() or (residual > np.maximum(limit, _KNOWN * np.abs(y))).any():
        return None
    return Laurent.of(zip(form, ratios, strict=True))


def _coefficients(model: DynamicModel, columns: tuple[Sequence[int], Sequence[int]]) -> tuple[Array, Array]:
    """Coefficients of the dropped columns in those kept, and what of each is not known, (kept, dropped) each.

    Raises:
        RegroupingError: at these lengths the dropped columns depend on those kept no more.
    """
    W = random_regressor(model, seed=0, columns=len(columns[0]))
    independent, dropped = (W[:, list(part)] for part in columns)
    lengths, others = np.linalg.norm(independent, axis=0)[:, None], np.linalg.norm(dropped, axis=0)
    others = np.maximum(others, NO_EFFECT / _DEPENDENT * lengths.max())  # without effect where it is less
    Q, R = np.linalg.qr(independent / lengths.T)
    if (np.linalg.norm(dropped - Q @ (Q.T @ dropped), axis=0) > _DEPENDENT * others).any():
        raise _unclear(model, "its relations with the loops closed hold at the device's own lengths only")
    rounding = np.linalg.norm(np.linalg.inv(R), axis=1, keepdims=True)  # 1 / what is left of each column kept
    return np.linalg.solve(R, Q.T @ dropped) / lengths, np.maximum(_KNOWN, _ROUNDING * rounding) * others / lengths


def _at_lengths(model: DynamicModel, lengths: Mapping[str, float]) -> DynamicModel:
    """The same mechanism with other named lengths; those written as formulas follow."""
    return DynamicModel(resized(model.device, lengths))


def _varied(device: Device) -> list[str]:
    """Names of the lengths that the file gives as numbers other than zero."""
    return [name for name, value in device.tables.lengths.items() if not isinstance(value, str) and value]


def _unclear(model: DynamicModel, reason: str) -> RegroupingError:
    return RegroupingError(
        f"{model.device.name}: loops that are not planar: {reason}.",
        where=model.device.name,
        found=reason,
        advice="Use the numeric groupings of `base_parameters`.",
    )
