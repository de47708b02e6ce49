"""Base parameters with symbolic lengths: which are kept, and exact formulas of the regrouping.

The regressor is evaluated modulo primes at random exact states, brought to reduced row echelon form at many sets of
lengths, and each coefficient is interpolated from its residues and checked at another prime. Nothing is rounded, and no
symbolic trigonometry is needed.

Source of the problem: Khalil and Bennis (1995), Int. J. Robotics Research 14(2); Gautier (1991), J. Robotic Systems
8(4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device import FormulaClosure, NewtonClosure
from haptid.device.expressions import CustomColumn
from haptid.device.toml.reader import read_tables
from haptid.dynamics.base_parameters import preference
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.symbolic import formulas
from haptid.dynamics.symbolic.arithmetic import (
    ONE,
    PRIMES,
    Coefficient,
    Laurent,
    Points,
    PrimeField,
    Residues,
    UnluckyDrawError,
    rational,
)
from haptid.dynamics.symbolic.chain import SymbolicChain, symbolic_chain
from haptid.dynamics.symbolic.interpolation import fit_coefficient, span_of
from haptid.dynamics.symbolic.loops import check_closure, dyad_chain, dyads, opened_tree
from haptid.dynamics.symbolic.regressor import ColumnGroup, Columns, Pivots, Relations, quantities, scatter
from haptid.dynamics.symbolic.spatial import opened_chain, symbols_of, with_loops_closed
from haptid.dynamics.symbolic.symbols import DIMENSIONLESS, DIMENSIONS, Dimension, Symbol, dimension_ratio, draw
from haptid.errors import RegroupingError, listed

if TYPE_CHECKING:
    from haptid.dynamics.base_parameters import BaseParameters


# Sets of lengths from which coefficients are interpolated, draws of each length on its own, and primes: few first, more
# for coefficients that do not fit.
SETS = ((16, 1, 1), (48, 6, 2), (200, 6, 2))
# Sets of lengths at which the relations are checked.
CHECKED_SETS = 3
# Most draws: each fails with odds of one in a million.
_DRAWS = 4


@dataclass(frozen=True, eq=False)
class Regroupings:
    """Base parameters of a device as linear combinations of its standard parameters, exact in its lengths.

    Attributes:
        names: ZZ1R where others regroup into ZZ1, FC2 where nothing does, (p,).
        units: of each, (p,).
        independent_columns: index in the standard parameters of the one each is named after, (p,).
        coefficients: of the standard parameters in each base parameter, by index; one for its own column, (p,).
        standard: names of the standard parameters.
        links: index of the joint each belongs to, -1 for a motor's.
        no_effect: names of the standard parameters without effect on any torque.
        symbols: lengths and other quantities that the coefficients depend on.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    independent_columns: tuple[int, ...]
    coefficients: tuple[Mapping[int, Coefficient], ...]
    standard: tuple[str, ...]
    links: tuple[int, ...] = field(repr=False)
    no_effect: tuple[str, ...]
    symbols: tuple[Symbol, ...]

    def __post_init__(self) -> None:
        read_only = tuple(MappingProxyType(dict(row)) for row in self.coefficients)
        object.__setattr__(self, "coefficients", read_only)

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def formulas(self) -> tuple[str, ...]:
        """Of every base parameter, such as `ZZ2 + IA2 + ZZ6 + ZZ7 + (M3 + M4 + M8 + M9) d3^2`."""
        return tuple(formulas.text(row, column, self.standard, self.links) for row, column in self._rows)

    @cached_property
    def latex(self) -> tuple[str, ...]:
        """Of every base parameter, such as `ZZ_{2R} = ZZ_{2} + (M_{3} + M_{4}) d_{3}^{2}`."""
        return tuple(
            f"{formulas.subscript(name)} = {formulas.latex(row, column, self.standard, self.links)}"
            for name, (row, column) in zip(self.names, self._rows, strict=True)
        )

    @cached_property
    def texts(self) -> tuple[Mapping[str, str], ...]:
        """Of every base parameter, the coefficient of each standard parameter in it: {"M3": "d3^2", "MX6": "d6/d3"}."""
        return tuple(
            MappingProxyType({self.standard[k]: formulas.coefficient(row[k]) for k in sorted(row)})
            for row in self.coefficients
        )

    @cached_property
    def values(self) -> Array:
        """The coefficients at the device's own lengths, (p, standard parameters)."""
        lengths = {symbol.name: symbol.value for symbol in self.symbols}
        matrix = np.zeros((len(self.names), len(self.standard)))
        for row, coefficients in zip(matrix, self.coefficients, strict=True):
            for k, coefficient in coefficients.items():
                row[k] = coefficient.value(lengths)
        return freeze(matrix)

    @property
    def _rows(self) -> tuple[tuple[Mapping[int, Coefficient], int], ...]:
        return tuple(zip(self.coefficients, self.independent_columns, strict=True))


def regroupings(model: DynamicModel, seed: int = 0) -> Regroupings:
    """Base parameters of a device with symbolic lengths, checked against the numeric ones.

    Columns are taken in the same order of preference as by `base_parameters`. That those kept are independent is
    certain; that the relations hold is checked at other lengths, states and another prime, so that a wrong one has odds
    of less than one in a billion (Schwartz 1980, J. ACM 27(4)).

    Args:
        seed: of random draws; the result does not depend on it.

    Loops that are neither linear nor planar dyads are opened first; what closing them adds is recognised from numbers
    at many sets of lengths (`spatial`).

    Raises:
        RegroupingError: a joint follows by a polynomial; a loop closes at the device's own lengths only; a loop that is
            not linear has relations, or terms may act on its cut; too many angles are no quarter turns; a coefficient
            is no ratio of polynomials of low degree; a column of accelerations depends on other parameters; or the
            numeric base parameters differ, because the device's lengths are a special case.
    """
    if isinstance(model.device.closure, FormulaClosure):
        raise RegroupingError(
            f"{model.device.name}: joints follow by polynomials, for which there are no regroupings with symbols.",
            where=model.device.name,
            advice="Use the numeric regroupings of its base parameters.",
        )
    if not isinstance(model.device.closure, NewtonClosure):
        exact = chain_regroupings(model, symbolic_chain(model.device), seed)
    elif (chain := _planar_chain(model, seed)) is not None:
        exact = chain_regroupings(model, chain, seed)
    else:
        exact = chain_regroupings(model, opened_chain(model), seed, closing=True)
    check_agreement(exact, model)
    return exact


def _planar_chain(model: DynamicModel, seed: int) -> SymbolicChain | None:
    """The mechanism whose loops are planar dyads, None where they are not."""
    device = model.device
    assert isinstance(device.closure, NewtonClosure)
    passive = [j for j in range(len(device.joints)) if j not in device.active]
    joints, cuts = cast(Any, device.joints), cast(Any, device.closure.cuts)  # what they join is all that is read
    if isinstance(dyads(joints, cuts, passive), str):
        return None
    tree = opened_tree(device.tables, device.name).with_gravity(device.gravity)
    try:
        return dyad_chain(tree, device.tables, device.name, seed)
    except RegroupingError:
        return None


def chain_regroupings(model: DynamicModel, chain: SymbolicChain, seed: int, closing: bool = False) -> Regroupings:
    """Base parameters of a mechanism whose standard parameters are those of a device.

    Args:
        model: of the device.
        chain: the mechanism.
        seed: of random draws.
        closing: whether the device has loops that are open in the mechanism.

    Raises:
        RegroupingError: see `regroupings`; or a relation does not hold where it is checked, or every draw fails.
    """
    for attempt in range(_DRAWS):
        try:
            return _regroupings(model, chain, seed + 1000 * attempt, closing)
        except UnluckyDrawError:
            continue
    raise _failed_check(f"{_DRAWS} draws in a row met a zero that should not be there")


def _regroupings(model: DynamicModel, chain: SymbolicChain, seed: int, closing: bool) -> Regroupings:
    check_closure(chain, model.device.joint_names, seed)
    parameters, order = model.device.parameters, preference(model)
    members: list[list[tuple[int, int]]] = [[] for _ in order]
    for k, j in np.argwhere(parameters.S[:, order].T).tolist():
        members[k].append((j, int(parameters.S[j, order[k]])))
    columns = Columns(chain, tuple(tuple(column) for column in members))
    dimensions = [DIMENSIONS.get(parameters.units[k]) for k in order]
    names = [parameters.names[k] for k in order]
    pivots = columns.pivots(PrimeField(PRIMES[0]), np.random.default_rng(seed))
    coefficients = _coefficients(columns, pivots, dimensions, names, seed)
    _check(columns, pivots, coefficients, names, seed)
    independent = pivots.kept
    if closing:
        independent, coefficients = with_loops_closed(model, columns, pivots.kept, coefficients, order, seed)
    one = Coefficient(ONE)
    rows = {order[k]: {order[k]: one} for k in independent}
    for (i, k), coefficient in coefficients.items():
        rows[order[i]][order[k]] = coefficient
    first, moving = sorted(rows), {*independent, *(k for _, k in coefficients)}
    different = {id(coefficient): coefficient for coefficient in coefficients.values()}  # many are one
    used = {name for coefficient in different.values() for name in coefficient.symbols}
    return Regroupings(
        names=tuple(parameters.names[k] + ("R" if len(rows[k]) > 1 else "") for k in first),
        units=tuple(parameters.units[k] for k in first),
        independent_columns=tuple(first),
        coefficients=tuple(rows[k] for k in first),
        standard=tuple(parameters.names),
        links=tuple(parameters.links),
        no_effect=tuple(parameters.names[k] for k in sorted(order[i] for i in range(len(order)) if i not in moving)),
        symbols=tuple(symbol for symbol in symbols_of(model, chain) if symbol.name in used),
    )


def _coefficients(
    columns: Columns, pivots: Pivots, dimensions: list[Dimension | None], names: list[str], seed: int
) -> dict[tuple[int, int], Coefficient]:
    """Coefficients that are not zero, by column kept and other column.

    Raises:
        RegroupingError: one of them fits no form.
    """
    coefficients: dict[tuple[int, int], Coefficient] = {}
    groups, wanted = pivots.groups, list[tuple[int, int]]()
    if not groups:
        return coefficients
    for sets, moves, primes in SETS:
        points, R = _residues(columns, groups, (sets, moves, primes), seed)
        wanted = wanted or sorted(R[0])
        known: dict[tuple[object, ...], Coefficient | None] = {}
        for i, k in wanted:
            y = [residues[i, k] for residues in R]
            dimension = dimension_ratio(dimensions[i], dimensions[k])
            key = (dimension, *(residues.tobytes() for residues in y))
            if key not in known:
                known[key] = _coefficient(columns.chain.symbols, points, y, (sets, moves), dimension)
            if (coefficient := known[key]) is not None:
                coefficients[i, k] = coefficient
        wanted = [place for place in wanted if place not in coefficients]
        if not wanted:
            return coefficients
        groups = tuple(group for group in groups if any(i in group.kept for i, _ in wanted))
    i, k = wanted[0]
    raise RegroupingError(
        f"the coefficient of {names[k]} in base parameter {names[i]} has no formula: no ratio of polynomials of low "
        f"degree fits at {SETS[-1][0]} sets of lengths.",
        where=(names[i], names[k]),
        advice="Write fewer different lengths and angles, or use the numeric groupings of `base_parameters`.",
    )


def _residues(
    columns: Columns, groups: Sequence[ColumnGroup], sets: tuple[int, int, int], seed: int
) -> tuple[list[Points], list[Relations]]:
    """Sets of lengths for the first primes, and the residues of the relations there."""
    points, R = [], []
    for prime in PRIMES[: sets[2]]:
        rng = np.random.default_rng([seed, *sets, prime])
        points.append(scatter(columns.chain.symbols, PrimeField(prime), rng, *sets[:2]))
        R.append(columns.relations(rng, points[-1], groups))
    return points, R


def _coefficient(
    symbols: tuple[Symbol, ...],
    points: list[Points],
    y: list[Residues],
    layout: tuple[int, int],
    dimension: Dimension | None,
) -> Coefficient | None:
    """One coefficient: first which quantities it depends on, then its form."""
    sets, moves = layout
    along = {
        name: [0, *range(sets + k * moves, sets + (k + 1) * moves)]
        for k, names in enumerate(quantities(symbols))
        for name in names
    }
    moving = [s for s in symbols if any((r[along[s.name]] != r[0]).any() for r in y)]
    if not moving:
        constant = rational(tuple(int(r[0]) for r in y), tuple(set_of_points.field.prime for set_of_points in points))
        is_constant = all((r[:sets] == r[0]).all() for r in y)
        return Coefficient(Laurent.number(constant)) if constant is not None and is_constant else None
    if dimension is None:
        return None
    spans = {s.name: span_of(points[0], y[0], s.name, along[s.name]) for s in moving if s.dimension != DIMENSIONLESS}
    return fit_coefficient(points, [r[:sets] for r in y], moving, dimension, spans)


def _check(
    columns: Columns, pivots: Pivots, coefficients: Mapping[tuple[int, int], Coefficient], names: list[str], seed: int
) -> None:
    """Check every relation at new states, new lengths and another prime; columns without relation must vanish there.

    Raises:
        RegroupingError: one of them does not hold.
    """
    field, rng = PrimeField(PRIMES[2]), np.random.default_rng([seed, PRIMES[2]])
    points = draw(columns.chain.symbols, field, rng, CHECKED_SETS)
    W = columns.sample(rng, points, 1 + max((group.samples for group in pivots.groups), default=0))
    left, different = W.copy(), {id(coefficient): coefficient for coefficient in coefficients.values()}
    residues = {place: coefficient.modulo(points)[:, None] for place, coefficient in different.items()}
    for (i, k), coefficient in coefficients.items():
        left[:, :, k] = field.reduce(left[:, :, k] - W[:, :, i] * residues[id(coefficient)])
    left[:, :, pivots.kept] = 0
    wrong = np.flatnonzero(left.any(axis=(0, 1)))
    if len(wrong):
        raise _failed_check(f"at another prime the relation of {names[wrong[0]]} does not hold", names[wrong[0]])


# Symbolic and numeric coefficients may differ by this much: relatively, and relative to a coefficient that makes both
# columns equally long. The numeric method solves with columns whose lengths differ by orders of magnitude, and its
# rounding error grows with their condition: machine epsilon times the norm of the coefficient's row of the inverse of
# R, at most 15 times that in 200 random loops in space; this multiple is allowed.
RELATIVE, ROUNDING, _MULTIPLE = 1e-6, 1e-7, 100


def check_agreement(exact: Regroupings, model: DynamicModel) -> None:
    """Raise unless the symbolic and the numeric method keep the same parameters and regroup the others alike.

    Args:
        exact: the symbolic result.
        model: its device, for the numeric one.

    Raises:
        RegroupingError: they disagree, or only one of them keeps a column of accelerations.
    """
    numeric = model.base
    tied = [name for name in accelerated(model) if (name in _kept(exact)) != (name in _kept(numeric))]
    if tied:
        raise RegroupingError(
            f"a column of accelerations, {listed(tied)}, is not independent of the other parameters, which symbolic "
            "groupings do not detect.",
            where=tied[0],
            advice=(
                "Leave the column out, write it as a rotor inertia, or use the numeric groupings of `base_parameters`."
            ),
        )
    if exact.independent_columns != numeric.independent_columns or exact.no_effect != numeric.no_effect:
        only = [_names(exact, a, b) for a, b in ((exact, numeric), (numeric, exact))]
        raise _disagreement(len(exact), len(numeric), only[0], only[1])
    difference, kept = np.abs(exact.values - numeric.regrouping), list(exact.independent_columns)
    rounding = np.maximum(ROUNDING, _MULTIPLE * np.finfo(float).eps * numeric.growth)
    limit = rounding[:, None] * numeric.lengths / numeric.lengths[kept][:, None] + RELATIVE * np.abs(exact.values)
    if (difference > limit).any():
        row, column = np.unravel_index(int(np.argmax(difference - limit)), difference.shape)
        place = f"{exact.standard[column]} in {exact.names[row]}"
        values = (float(exact.values[row, column]), float(numeric.regrouping[row, column]))
        raise _disagreement(len(exact), len(numeric), [f"{values[0]:.6g} {place}"], [f"{values[1]:.6g} {place}"])


def accelerated(model: DynamicModel) -> list[str]:
    """Names of the user-defined columns that read accelerations."""
    rates = {f"a_{name}" for name in model.device.joint_names}
    return [term.name for term in model.externals if isinstance(term.shape, CustomColumn) and term.shape.reads(rates)]


def _kept(relations: Regroupings | BaseParameters) -> list[str]:
    """Standard parameters that base parameters are named after."""
    return [relations.standard[k] for k in relations.independent_columns]


def _names(exact: Regroupings, first: Regroupings | BaseParameters, second: Regroupings | BaseParameters) -> list[str]:
    """What one method keeps, or finds without effect, and the other does not."""
    only_first = [exact.standard[k] for k in first.independent_columns if k not in second.independent_columns]
    return only_first + [f"{name} without effect" for name in first.no_effect if name not in second.no_effect]


def loop_regroupings(path: str | Path, seed: int = 0) -> Regroupings:
    """Base parameters, with symbolic lengths, of a device whose loops are planar dyads (four-bar, five-bar linkages).

    Two passive joints and a pin close each loop; the other joints are active, and have motors, unless the file names
    motors for some of them only. It requires neither guess nor start pose, and it does not compare with numeric base
    parameters as `regroupings` does. A loop that closes in two assembly modes is taken in both: the relations hold in
    either.

    Args:
        path: of the device file.
        seed: of random draws; the result does not depend on it.

    Raises:
        DeviceError: in one of its kinds, what is wrong with the file.
        RegroupingError: a loop is no planar dyad, its links are not in one plane, or a coefficient is no ratio of
            polynomials of low degree.
    """
    tables, file = read_tables(path)
    tree = opened_tree(tables, file)
    return chain_regroupings(DynamicModel(tree), dyad_chain(tree, tables, file, seed), seed)


def _failed_check(check: str, place: str | None = None) -> RegroupingError:
    return RegroupingError(
        f"the symbolic groupings fail their own check: {check}.",
        where=place,
        advice=(
            "Try another seed; if it stays, use the numeric groupings of `base_parameters` and report the device file."
        ),
    )


def _disagreement(exact: int, numeric: int, only_exact: Sequence[str], only_numeric: Sequence[str]) -> RegroupingError:
    halves = (("former", only_exact), ("latter", only_numeric))
    differences = "; ".join((f"only the {source} have {listed(names)}" for source, names in halves if names))
    return RegroupingError(
        f"base parameters with symbolic lengths ({exact}) and at the device's own lengths ({numeric}) differ: "
        f"{differences}.",
        found=(exact, numeric),
        advice=(
            "The device's lengths or angles are special, or a column's law ties it to others: write equal lengths by "
            "one name and lengths of zero as 0, or use the numeric groupings of `base_parameters`."
        ),
    )
