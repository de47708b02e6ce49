"""Constrained least squares: equality constraints, bounds, parameters fixed at zero, and physical consistency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.expressions import combination
from haptid.device.toml.errors_at import Place
from haptid.dynamics.base_parameters import base_combinations
from haptid.dynamics.model import DynamicModel
from haptid.errors import SettingError, setting_error, unknown_name
from haptid.estimation.feasibility.cone import never_negative
from haptid.estimation.feasibility.conic_program import ConeCondition, minimise
from haptid.estimation.feasibility.feasible import FeasibleParameters, feasible_parameters, nearest_feasible
from haptid.estimation.least_squares import Knowledge, Solution
from haptid.estimation.method import Method, Wrapper, expect_weighting
from haptid.estimation.methods.wls import WLS, weights_without
from haptid.observation.observation import MotorRows, Observation

# Relative residual of equality constraints at their least-squares solution above which they contradict each other.
CONTRADICTION = 1e-9
# Distance from a bound, relative to the parameter's standard error in the fit, within which it counts as active.
TOUCHING = 1e-6


@dataclass(frozen=True)
class FixedAtZero(Wrapper):
    """Another method with some base parameters fixed at zero, without uncertainty.

    Weights are those of the fit with all parameters: they represent the noise, which a smaller model does not change.
    Where the rows do not tell all, `WLS` takes them of the fit without those left out.

    Attributes:
        names: of the base parameters left out.
        weighting: how the motors' rows are weighted.
    """

    names: tuple[str, ...]
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("FixedAtZero", self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name} without {len(self.names)}"

    def weights(self, observation: Observation) -> Array:
        """Those of the wrapped method, (motors,)."""
        return weights_without(self.weighting, observation, self.zero)

    def zero(self, observation: Observation) -> tuple[int, ...]:
        """Indices of the base parameters left out.

        Raises:
            UnknownNameError: the device has no base parameter of that name.
        """
        return indices(observation.base.names, self.names)


def indices(known: tuple[str, ...], names: tuple[str, ...]) -> tuple[int, ...]:
    """Indices of some base parameters among all, ascending.

    Raises:
        UnknownNameError: there is none of that name.
    """
    for name in names:
        if name not in known:
            raise unknown_name(f"the device has no base parameter {name!r}.", name, known, "base parameter")
    return tuple(sorted({known.index(name) for name in names}))


@dataclass(frozen=True)
class EqualityConstraints(Wrapper):
    """Another method with equality constraints on parameters: a link of known mass, links of equal inertia.

    Solved on the R factor in the null space of the constraints.

    Source: Golub and Van Loan (2013), Matrix Computations, section 6.2.3.

    Attributes:
        relations: combinations of parameters and their values, SI, such as {"M4": 0.35, "ZZ2R - ZZ3R": 0.0}; a
            combination of standard parameters has to be one of base parameters too.
        weighting: how rows are weighted, computed without the constraints.
    """

    relations: Mapping[str, float]
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("EqualityConstraints", self.weighting)
        object.__setattr__(self, "relations", dict(self.relations))

    @property
    def name(self) -> str:
        return f"{self.weighting.name} with {len(self.relations)} relations"

    def knowledge(self, observation: Observation) -> Knowledge:
        """The equality constraints.

        Raises:
            DeviceFileError: the text is no combination of parameters.
            IdentifiabilityError: it is no combination of base parameters, so it has no effect on torque alone.
            SettingError: the constraints contradict each other.
        """
        A, b = self._rows(observation.model), np.array(list(self.relations.values()), dtype=float)
        sizes = np.linalg.norm(A, axis=1)
        met = np.linalg.lstsq(A / sizes[:, None], b / sizes, rcond=None)[0]
        violation = np.abs(A @ met - b) / (np.abs(A) @ np.abs(met) + np.abs(b) + np.finfo(float).tiny)
        if violation.max(initial=0.0) > CONTRADICTION:
            relations, left = ", ".join(f"{k} = {v:g}" for k, v in self.relations.items()), float(violation.max())
            raise SettingError(
                f"the relations {relations} contradict each other: one is off by {left:.3g} of its size at best.",
                where="relations",
                found=left,
                limit=CONTRADICTION,
                advice="Leave one out.",
            )
        rank = np.linalg.matrix_rank(A / sizes[:, None])
        if rank < len(b):  # redundant but consistent: an equivalent set of full rank
            u, values, vt = np.linalg.svd(A / sizes[:, None])
            A, b = vt[:rank], (u[:, :rank].T @ (b / sizes)) / values[:rank]
        return Knowledge(A, b, np.zeros(len(b)))

    def _rows(self, model: DynamicModel) -> Array:
        """Each relation as a combination of base parameters, (relations, p)."""
        base, parameters, rows = model.base, model.device.parameters, []
        for text in self.relations:
            row = np.zeros(len(parameters))
            symbols = {*base.names, *parameters.raw}
            for name, factor in combination(text, symbols, {}, Place("Equal", text)).items():
                if name in base.names:
                    row += factor * base.regrouping[base.names.index(name)]
                elif name in parameters.index:
                    row[parameters.index[name]] += factor * parameters.sign[name]
            rows.append(row)
        return base_combinations(model, list(self.relations), np.array(rows).reshape(len(rows), -1))


@dataclass(frozen=True)
class Bounds(Wrapper):
    """Another method with bounds on base parameters.

    A quadratic programme on the R factor. Intervals are those of the unconstrained fit, cut at the bounds and widened
    to the estimate: the unconstrained interval has the nominal coverage, and true bounds never cut off the truth.

    Source: Lawson and Hanson (1974), Solving Least Squares Problems, chapter 23.

    Attributes:
        limits: lower and upper bound of some base parameters by name, SI; None where there is none.
        weighting: how rows are weighted.
    """

    limits: Mapping[str, tuple[float | None, float | None]]
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("Bounds", self.weighting)
        object.__setattr__(self, "limits", dict(self.limits))
        for name, (low, high) in self.limits.items():
            if low is not None and high is not None and not low < high:
                raise setting_error(f"limits of {name}", (low, high), "a lower one below the upper one", "Bounds")

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, bounded"

    def constrain(self, observation: Observation, free: Solution) -> BoundedSolution:
        """The unconstrained fit if it is within the bounds, else the nearest parameters that are, in weighted torque.

        Raises:
            UnknownNameError: the device has no base parameter of that name.
            ConvergenceError: the solver stopped without a solution.
        """
        names = observation.base.names
        indices(names, tuple(self.limits))
        low, high = (np.array([self._bound(name, side) for name in names]) for side in (0, 1))
        if ((low <= free.beta) & (free.beta <= high)).all():
            return BoundedSolution(names, free.beta, free.beta, low, high)
        return BoundedSolution(names, nearest_within(free, low, high), free.beta, low, high)

    def _bound(self, name: str, side: int) -> float:
        """Lower (0) or upper (1) bound of a parameter; infinite where there is none."""
        value = self.limits[name][side] if name in self.limits else None
        return (-np.inf, np.inf)[side] if value is None else float(value)


def nearest_within(free: Solution, low: Array, high: Array) -> Array:
    """The b that minimises |R (b - beta)| between bounds, (p,)."""
    # In units of each parameter's standard error, from the unconstrained fit: numbers near one.
    size = np.linalg.norm(free.root, axis=1)
    scaled = free.R * size
    x, _ = minimise(scaled.T @ scaled, np.zeros(len(size)), bound_conditions(free.beta, size, low, high))
    beta = np.clip(free.beta + size * x, low, high)
    beta = np.where(np.abs(beta - low) < TOUCHING * size, low, beta)
    return np.asarray(np.where(np.abs(beta - high) < TOUCHING * size, high, beta))


def bound_conditions(beta: Array, size: Array, low: Array, high: Array) -> list[ConeCondition]:
    """low <= beta + size x <= high, row by row in units of size."""
    unit = np.eye(len(beta))
    lower, upper = np.isfinite(low), np.isfinite(high)
    ends = [((beta - low) / size)[lower], ((high - beta) / size)[upper]]
    return [ConeCondition(F, f) for F, f in zip((unit[lower], -unit[upper]), ends, strict=True) if len(f)]


def _outside(names: Sequence[str], beta: Array, free: Array, half: Array) -> tuple[str, ...]:
    """Names of the parameters outside of their unconstrained interval, whose half-widths are given, (p,)."""
    far = np.abs(beta - free) > half
    return tuple(name for name, is_outside in zip(names, far, strict=True) if is_outside)


@dataclass(frozen=True, eq=False)
class BoundedSolution:
    """A bounded estimate, with the unconstrained one.

    Attributes:
        names: of the base parameters, (p,).
        beta, free: the estimate and the unconstrained fit, (p,), SI.
        low, high: bounds, infinite where there is none, (p,).
    """

    names: tuple[str, ...]
    beta: Array
    free: Array
    low: Array
    high: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "beta", "free", "low", "high")

    @property
    def active(self) -> tuple[str, ...]:
        """A sentence for every active bound."""
        moved = self.beta != self.free
        at_bound = moved & ((self.beta == self.low) | (self.beta == self.high))
        return tuple(f"{self.names[k]} is at its bound {self.beta[k]:.6g}" for k in np.flatnonzero(at_bound))

    def interval(self, half: Array) -> Array:
        """The unconstrained interval, cut at the bounds and widened to the estimate, (p, 2).

        Args:
            half: half-widths of the unconstrained interval at the wanted level, (p,).
        """
        ends = np.clip(np.column_stack([self.free - half, self.free + half]), self.low[:, None], self.high[:, None])
        return np.column_stack([np.minimum(ends[:, 0], self.beta), np.maximum(ends[:, 1], self.beta)])

    def constrained_outside_ci(self, half: Array) -> tuple[str, ...]:
        """Names of the parameters outside of their unconstrained interval, whose half-widths are given, (p,)."""
        return _outside(self.names, self.beta, self.free, half)

    def notes(self, half: Array) -> tuple[str, ...]:
        """Notes for the user: active bounds, and whether they contradict the data."""
        notes = [f"{sentence}." for sentence in self.active]
        if outside := self.constrained_outside_ci(half):
            notes.append(
                f"{', '.join(outside)}: outside of the confidence interval of the unconstrained fit. Noise alone does "
                f"not explain this: check the bounds, and look for a term that is missing in the device file."
            )
        return tuple(notes)


@dataclass(frozen=True)
class PhysicallyConsistent(Wrapper):
    """Weighted least squares constrained to physically consistent parameters: of a mass distribution, passive friction.

    beta = A chi, with the pseudo-inertia of every link positive semidefinite, rotor inertia and friction non-negative;
    springs, offsets and user-defined columns are unconstrained (see `FeasibleParameters`). A semidefinite programme on
    the R factor, whose size does not depend on the length of the log. Weights are those of the unconstrained fit. Where
    that fit is feasible, it is the estimate, to the last digit.

    Torque determines beta, not chi: of all chi with these beta it has the one of least log-det divergence from the
    prior, or from a homogeneous ball for every link without one, which is well inside the cone where that is possible.
    Links with an active constraint are on its boundary; there chi is the nearest to the same centre, by a penalty of
    1e-10 of the torque's weight, corrected in a second pass, which has no effect on beta.

    Intervals are those of the unconstrained fit (by default), cut where a parameter cannot be negative, and widened to
    the estimate. The unconstrained interval has the nominal coverage and the truth is never cut off, so this one has
    it too; resampling the constrained fit itself would not be valid on the boundary (Andrews 2000, Econometrica
    68(2)). The covariance is that of the unconstrained fit. Where the whole unconstrained interval is infeasible, the
    interval is as wide as its half, from zero.

    Sources: Sousa and Cortesao (2014), IJRR 33(6); Wensing, Kim and Slotine (2018), IEEE RA-L 3(1).

    Attributes:
        weighting: how the motors' rows are weighted.
    """

    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("PhysicallyConsistent", self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, physically consistent"

    def constrain(self, observation: Observation, free: Solution) -> Constrained:
        """The unconstrained fit if it is feasible, else the nearest feasible parameters, in weighted torque.

        Raises:
            PhysicalConsistencyError: the symmetries declared for the device leave no feasible body.
            ConvergenceError: the solver stopped without a solution.
        """
        feasible = feasible_parameters(observation.model, free.beta)
        if feasible.ok:
            return Constrained(feasible, free.beta, (), costs(observation.motors, free.beta, free.beta))
        nearest, blocks = nearest_feasible(observation.model, free.beta, free.R)
        active = tuple(dict.fromkeys(_active(block.label, block.is_link) for block in blocks))
        return Constrained(nearest, free.beta, active, costs(observation.motors, free.beta, nearest.beta))


def _active(label: str, is_link: bool) -> str:
    """A sentence for an active constraint."""
    if is_link:
        return f"{label}: its inertia is on the boundary of physical consistency"
    return f"{label} would be negative: constrained to 0"


@dataclass(frozen=True)
class Cost:
    """Relative residual of one motor without and with the constraints.

    Attributes:
        label: "motor 1".
        free, constrained: 100 norm(y - y_hat) / norm(y) of the unconstrained fit and of the estimate, per cent.
    """

    label: str
    free: float
    constrained: float


def costs(motors: Sequence[MotorRows], free: Array, constrained: Array) -> tuple[Cost, ...]:
    """Relative residuals by motor of two sets of base parameters, each (p,)."""

    def relative(motor: MotorRows, beta: Array) -> float:
        return 100 * motor.residual(beta) / size if (size := motor.size(beta)) > 0 else 0.0

    return tuple(Cost(motor.label, relative(motor, free), relative(motor, constrained)) for motor in motors)


@dataclass(frozen=True, eq=False)
class Constrained:
    """A physically consistent estimate, with the unconstrained one.

    Attributes:
        feasible: the base parameters, and bodies that have them.
        free: base parameters of the unconstrained fit, (p,), SI.
        active: a sentence for every link and term with an active constraint.
        costs: relative residual of the unconstrained and of the constrained fit, by motor.
        pulled: whether it is regularised towards prior bodies too, so that it is not the best feasible fit.
    """

    feasible: FeasibleParameters
    free: Array
    active: tuple[str, ...]
    costs: tuple[Cost, ...]
    pulled: bool = False

    def __post_init__(self) -> None:
        freeze_fields(self, "free")

    @property
    def beta(self) -> Array:
        """The constrained base parameters, (p,), SI."""
        return self.feasible.beta

    def interval(self, half: Array) -> Array:
        """The unconstrained interval, cut where a parameter cannot be negative and widened to the estimate, (p, 2).

        Args:
            half: half-widths of the unconstrained interval at the wanted level, (p,).
        """
        low, high = self.free - half, self.free + half
        bounded = never_negative(self.feasible.model)
        high = np.where(bounded & (high < 0), half, high)
        low = np.where(bounded, np.maximum(low, 0.0), low)
        return np.column_stack([np.minimum(low, self.beta), np.maximum(high, self.beta)])

    def constrained_outside_ci(self, half: Array) -> tuple[str, ...]:
        """Names of the parameters outside of their unconstrained interval, whose half-widths are given, (p,)."""
        return _outside(self.feasible.model.base.names, self.beta, self.free, half)

    def notes(self, half: Array) -> tuple[str, ...]:
        """Notes for the user: active constraints, their cost, and whether they contradict the data."""
        if not self.active:
            return ()
        figures = "; ".join(f"{cost.label} {cost.free:.3g} % to {cost.constrained:.3g} %" for cost in self.costs)
        notes = [f"{sentence}." for sentence in self.active]
        notes.append(f"Relative error of the unconstrained and of the physically consistent fit: {figures}.")
        if outside := self.constrained_outside_ci(half):
            notes.append(
                f"{', '.join(outside)}: outside of the confidence interval of the unconstrained fit. Data and "
                f"constraints contradict each other, and intervals do not have the nominal coverage: look for a lag of "
                f"the velocity, or for friction that is missing in the device file. The constraint does not repair it."
            )
        return tuple(notes)
