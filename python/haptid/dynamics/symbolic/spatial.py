"""Loops that are neither linear nor planar dyads: relations that closing them adds to those of the opened mechanism.

States that close such a loop modulo a prime would need the roots of polynomials of high degree. But every relation of
the mechanism with these loops opened holds when they are closed, and is exact; what closing adds are few and short
relations among the base parameters of the opened mechanism. Their coefficients are known as numbers at any lengths, by
Newton's method and least squares, and are recognised as Laurent polynomials in the lengths that reproduce them at
more sets of lengths than they have unknowns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import islice

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Device, NewtonClosure
from haptid.device.toml.reader import resized
from haptid.dynamics.base_parameters import NO_EFFECT, random_regressor
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.symbolic.arithmetic import Coefficient, Laurent, Powers
from haptid.dynamics.symbolic.chain import SymbolicChain, assembled, linear_motion
from haptid.dynamics.symbolic.closed_rows import ClosedRows, RowsAtLengths
from haptid.dynamics.symbolic.interpolation import EXPONENT_RANGES, monomials, with_cosines, with_sines
from haptid.dynamics.symbolic.loops import opened_tree
from haptid.dynamics.symbolic.regressor import Columns
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

# Coefficients by (column kept, other column).
Coefficients = dict[tuple[int, int], Coefficient]


def opened_chain(model: DynamicModel) -> SymbolicChain:
    """The mechanism with the loops opened that are not linear: their passive joints are active.

    Raises:
        RegroupingError: an opened loop has relations, or terms may act on its cut.
    """
    device = model.device
    assert isinstance(device.closure, NewtonClosure)
    passive = {device.joint_names[j] for j in device.closure.unknown}
    opened = opened_tree(device.tables, device.name, passive, device).with_gravity(device.gravity)
    active = range(len(opened.active))
    return assembled(
        opened, device.tables, active, None, lambda _, __, symbols: linear_motion(opened, symbols), passive
    )


def with_loops_closed(
    model: DynamicModel, columns: Columns, kept: Sequence[int], relations: Coefficients, order: Sequence[int], seed: int
) -> tuple[tuple[int, ...], Coefficients]:
    """The columns kept and all relations with the loops closed.

    Args:
        model: with its loops.
        columns: with the loops opened, in order of preference.
        kept: those that are independent.
        relations: of the others.
        order: index of the standard parameter of each column.
        seed: of random lengths and states; the result does not depend on it.

    Raises:
        RegroupingError: a base parameter of the closed mechanism is none of the opened one; the loops close at no other
            lengths; or a coefficient is no Laurent polynomial of low degree in the named lengths.
    """
    closed = set(model.base.independent_columns)
    independent = tuple(k for k in kept if order[k] in closed)
    dropped = [k for k in kept if order[k] not in closed]
    if len(independent) < len(closed):
        raise _unclear(model, "base parameters with loops closed are not among those with loops opened")
    added = _forms(_Numbers(model, columns, order, (independent, dropped), seed), model, order) if dropped else {}
    return independent, _joined(relations, added, dropped)


def _joined(relations: Coefficients, added: Coefficients, dropped: Sequence[int]) -> Coefficients:
    """All relations in the columns kept with the loops closed: those dropped are put into the others' relations."""
    instead: dict[int, list[tuple[int, Coefficient]]] = {k: [] for k in dropped}
    for (i, k), coefficient in added.items():
        instead[k].append((i, coefficient))
    total = dict(added)
    for (row, k), coefficient in relations.items():
        if row not in instead:
            parts = [(row, coefficient)]
        else:
            parts = [(i, factor * coefficient) for i, factor in instead[row]]
        for i, part in parts:
            total[i, k] = with_sines(with_cosines(total[i, k]) + with_cosines(part)) if (i, k) in total else part
    return {place: coefficient for place, coefficient in total.items() if coefficient.numerator.terms}


def _forms(numbers: _Numbers, model: DynamicModel, order: Sequence[int]) -> Coefficients:
    """Formulas of the coefficients that are not zero, by (kept, dropped).

    Raises:
        RegroupingError: one of them has none.
    """
    parameters = model.device.parameters
    units = [DIMENSIONS.get(parameters.units[k]) for k in order]
    forms: Coefficients = {}
    for count in _SETS:
        numbers.extend(count)
        fitted: list[tuple[Coefficient, Array]] = []
        for i, k in set(numbers.values) - set(forms):
            y, limit = np.array(numbers.values[i, k]), numbers.limits[i, k]
            fit = next((fit for fit in fitted if _agree(fit[1], y, limit)), None)  # many are equal
            fit = fit or _fit(numbers, y, limit, dimension_ratio(units[i], units[k]))
            if fit is not None:
                fitted.append(fit)
                forms[i, k] = fit[0]
        if len(forms) == len(numbers.values):
            return {place: coefficient for place, coefficient in forms.items() if coefficient.numerator.terms}
    i, k = min(set(numbers.values) - set(forms))
    names, lengths = (parameters.names[order[i]], parameters.names[order[k]]), [s.name for s in numbers.varied]
    raise RegroupingError(
        f"the coefficient of {names[1]} in base parameter {names[0]} has no formula: no Laurent polynomial of low "
        f"degree in {', '.join(lengths) or 'named lengths (there are none)'} fits at {len(numbers.lengths)} sets.",
        where=names,
        advice="Name the lengths that loops depend on in [lengths], or use the groupings of `base_parameters`.",
    )


class _Numbers:
    """Coefficients of the dropped columns in those kept, as numbers, at sets of lengths.

    The first set is the device's own; each of the next has one length changed, all others random ones. At the device's
    own lengths the numeric base parameters tell on which columns kept a dropped one depends. Where these do not suffice
    at other lengths, all are taken.

    Attributes:
        varied: lengths that the file gives as numbers other than zero.
        lengths: of each set.
        values: coefficients at each set, by (kept, dropped).
        limits: what of each is not known.
    """

    def __init__(
        self,
        model: DynamicModel,
        columns: Columns,
        order: Sequence[int],
        split: tuple[Sequence[int], Sequence[int]],
        seed: int,
    ) -> None:
        self._model, self._order, self._rng, base = model, order, np.random.default_rng(seed), model.base
        self._rows, (self._kept, self._dropped) = ClosedRows.of(model, columns), split
        self.varied = [Symbol(name, model.device.lengths[name], LENGTH) for name in varied(model.device)]
        self.lengths: list[Mapping[str, float]] = [{symbol.name: symbol.value for symbol in self.varied}]
        row = {k: i for i, k in enumerate(base.independent_columns)}
        own = base.regrouping[np.ix_([row[order[k]] for k in self._kept], [order[k] for k in self._dropped])]
        kept, others = (base.lengths[[order[k] for k in part]] for part in split)
        others = np.maximum(others, NO_EFFECT / _DEPENDENT * kept.max(initial=0.0))  # without effect where it is less
        growth = base.growth[[row[order[k]] for k in self._kept]]
        limits = np.maximum(_KNOWN, _ROUNDING * growth)[:, None] * others / kept[:, None]
        places = [(a, b) for a in range(len(self._kept)) for b in range(len(self._dropped))]
        self.limits = {(self._kept[a], self._dropped[b]): float(limits[a, b]) for a, b in places}
        self._own = {(self._kept[a], self._dropped[b]): float(own[a, b]) for a, b in places}
        known = {place for place, value in self._own.items() if abs(value) > self.limits[place]}
        self._support = {k: [i for i in self._kept if (i, k) in known] for k in self._dropped}
        self.values = {place: [self._own[place]] for place in self._places}

    @property
    def points(self) -> dict[str, Array]:
        """Every length at all sets, (sets,)."""
        return {name: np.array([each[name] for each in self.lengths]) for name in self.lengths[0]}

    @property
    def _places(self) -> list[tuple[int, int]]:
        return [(i, k) for k, kept in self._support.items() for i in kept]

    def extend(self, count: int) -> None:
        """One set for each length, and random ones until there are this many.

        Raises:
            RegroupingError: the loops close at none of many lengths, or the dropped columns do not depend on those kept
                there.
        """
        names = [symbol.name for symbol in self.varied]
        changed = [*([name] for name in names), *[names] * count][len(self.lengths) - 1 :]
        lengths: list[Mapping[str, float]] = [{}] * len(changed)
        rows: list[RowsAtLengths | None] = [None] * len(changed)
        for _ in range(_DRAWS):
            left = [k for k, made in enumerate(rows) if made is None]
            if not left:
                break
            for k in left:
                lengths[k] = self._moved(changed[k])
            for k, made in zip(left, self._at([lengths[k] for k in left]), strict=True):
                rows[k] = made
        found = [made for made in rows if made is not None]
        if len(found) < len(rows):
            moved = ", ".join(sorted(changed[next(k for k, made in enumerate(rows) if made is None)]))
            raise _unclear(self._model, f"the loops do not close where {moved} differ by 10 %")
        self.lengths += lengths
        if more := self._solve(found):
            self._support |= {k: list(self._kept) for k in more}
            self.values = {place: [self._own[place]] for place in self._places}
            found = [made for made in self._at(self.lengths[1:]) if made is not None]
            if len(found) < len(self.lengths) - 1 or self._solve(found):
                raise _unclear(self._model, "its relations with the loops closed hold at the device's own lengths only")

    def _at(self, lengths: Sequence[Mapping[str, float]]) -> list[RowsAtLengths | None]:
        if not all(self._model.device.measured):
            return [self._moving(each) for each in lengths]
        most = max(len(kept) for kept in self._support.values())
        return self._rows.at(self._rng, lengths, self._columns, most)

    def _moving(self, lengths: Mapping[str, float]) -> RowsAtLengths | None:
        """Rows of measured torque at one set, in motion: only all torques at rest imply those in motion."""
        try:
            model = DynamicModel(resized(self._model.device, lengths))
            W = random_regressor(model, seed=0, columns=len(self._kept))
        except (LoopClosureError, SingularityError):
            return None
        return W[:, [self._order[k] for k in self._columns]], float(np.linalg.norm(W, axis=0).max())

    @property
    def _columns(self) -> list[int]:
        """The columns that all relations need."""
        return sorted({*self._dropped, *(i for kept in self._support.values() for i in kept)})

    def _moved(self, changed: Sequence[str]) -> dict[str, float]:
        own = self.lengths[0].items()
        return {n: x * (1 + _SPREAD * self._rng.uniform(-1, 1)) if n in changed else x for n, x in own}

    def _solve(self, rows: Sequence[RowsAtLengths]) -> list[int]:
        """Add the coefficients of these rows; returns the dropped columns that do not depend on their support."""
        more: list[int] = []
        W, at = np.stack([made for made, _ in rows]), {k: place for place, k in enumerate(self._columns)}
        floor = NO_EFFECT / _DEPENDENT * np.array([longest for _, longest in rows])
        for k, kept in self._support.items():
            columns, wanted = W[:, :, [at[i] for i in kept]], W[:, :, at[k]]
            sizes = np.linalg.norm(columns, axis=1)
            Q, R = np.linalg.qr(columns / sizes[:, None])
            shares = np.swapaxes(Q, 1, 2) @ wanted[:, :, None]
            left = np.linalg.norm(wanted - (Q @ shares)[:, :, 0], axis=1)
            if (left > _DEPENDENT * np.maximum(np.linalg.norm(wanted, axis=1), floor)).any():
                more.append(k)
            values = np.linalg.solve(R, shares)[:, :, 0] / sizes
            for i, column in zip(kept, values.T, strict=True):
                self.values[i, k] += column.tolist()
        return more


def _agree(values: Array, y: Array, limit: float) -> bool:
    """Whether a formula has these values at all sets of lengths."""
    return bool((np.abs(values - y) <= np.maximum(limit, _KNOWN * np.abs(y))).all())


def _fit(numbers: _Numbers, y: Array, limit: float, dimension: Dimension | None) -> tuple[Coefficient, Array] | None:
    """The coefficient with these values, and its own values; None where no form fits."""
    moving = [symbol for symbol, value in zip(numbers.varied, y[1:], strict=False) if abs(value - y[0]) > limit]
    if not moving:
        forms: Iterator[tuple[Powers, ...]] = iter([((),)])
    elif dimension is None:
        return None
    else:
        forms = (tuple(islice(monomials(moving, dimension, *span), len(y))) for span in EXPONENT_RANGES)
    fits = (_polynomial(numbers.points, y, form, limit) for form in forms if 0 < len(form) <= len(y) - _SPARE)
    return next((fit for fit in fits if fit is not None), None)


def _polynomial(
    points: Mapping[str, Array], y: Array, form: Sequence[Powers], limit: float
) -> tuple[Coefficient, Array] | None:
    """The combination of monomials with ratios of small integers that has these values, None where there is none."""
    values = np.ones((len(y), len(form)))
    for k, exponents in enumerate(form):
        for name, exponent in exponents:
            values[:, k] *= points[name] ** exponent
    sizes = np.abs(values).max(axis=0)
    factors = np.linalg.lstsq(values / sizes, y, rcond=None)[0] / sizes
    ratios = [Fraction(factor).limit_denominator(_DENOMINATOR) for factor in factors.tolist()]
    rounded = np.array([float(ratio) for ratio in ratios])
    made = values @ rounded
    if (np.abs(factors - rounded) > _NEAR).any() or not _agree(made, y, limit):
        return None
    return Coefficient(Laurent.of(zip(form, ratios, strict=True))), made


def symbols_of(model: DynamicModel, chain: SymbolicChain) -> tuple[Symbol, ...]:
    """Symbols of a mechanism, and the named lengths on which closing its opened cuts may depend."""
    if not chain.opened:
        return chain.symbols
    known, lengths = {symbol.name for symbol in chain.symbols}, model.device.lengths
    return (*chain.symbols, *(Symbol(n, lengths[n], LENGTH) for n in varied(model.device) if n not in known))


def varied(device: Device) -> list[str]:
    """Names of the lengths that the file gives as numbers other than zero."""
    return [name for name, value in device.tables.lengths.items() if not isinstance(value, str) and value]


def _unclear(model: DynamicModel, reason: str) -> RegroupingError:
    return RegroupingError(
        f"{model.device.name}: loops that are not planar: {reason}.",
        where=model.device.name,
        found=reason,
        advice="Use the numeric groupings of `base_parameters`.",
    )
