"""`estimate(observation, method)`: base parameters with covariance, confidence intervals, status and notes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from haptid._internal.arrays import Array, freeze_fields, read_only
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import index_of
from haptid.estimation.feasibility.feasible import FeasibleParameters
from haptid.estimation.intervals.between_logs import BetweenLogs
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.clusters import Clusters
from haptid.estimation.intervals.covariance import Intervals, Limiting, Spread, with_prior_variance
from haptid.estimation.least_squares import Solution, solve
from haptid.estimation.method import Fit, Fitting, Knowing, Method, PointEstimate, Reduced, rows_of
from haptid.estimation.methods.anchored import reference_torque
from haptid.estimation.methods.constrained import BoundedSolution, Constrained
from haptid.estimation.methods.wls import WLS
from haptid.estimation.parameter import Parameter, not_told_from_zero
from haptid.estimation.torque_uncertainty import judged_uncertainty
from haptid.observation.observation import Observation
from haptid.observation.plan import Block
from haptid.uncertainty.figures import per_cent
from haptid.uncertainty.quantities import LEVEL, Quantities, half_width

# Condition number with unit columns above which single parameters are unreliable (Gautier's rule).
WELL_CONDITIONED = 200.0
# Name of nuisances that are estimated from rows of another estimate.
_MOVED = "estimated nuisances"
# Standard error of the torque in other motion above which an estimate is uncertain, per cent, and the note on it.
_LARGEST_SE, _UNDETERMINED = 3.0, "The torque of other motion in the log's poses is uncertain"


@runtime_checkable
class Restricted(Method, Protocol):
    """A method with inequality constraints, such as `PhysicallyConsistent`."""

    def constrain(self, observation: Observation, free: Solution) -> Constrained | BoundedSolution:
        """The constrained solution, with the unconstrained one."""


@displayed
@dataclass(frozen=True, eq=False)
class Estimate:
    """Base parameters estimated from an observation.

    `beta` is the symbol of the base parameters throughout, as in y = W beta + rho: of an estimate it is
    `quantities.values`, of a function's argument a vector in the order of `model.base`.

    With inequality constraints, covariance, standard errors and degrees of freedom are those of the unconstrained fit.

    Attributes:
        observation: the rows it was made from.
        method: of estimation.
        fit: the unconstrained solution, and the rows as least squares saw them.
        intervals: covariance estimator.
        quantities: names, units, values, cluster-robust covariance and degrees of freedom of the base parameters;
            unbounded where a parameter is excited in a single block, so that its standard error cannot be estimated.
        classical_covariance: classical, valid for white residuals, (p, p).
        weights: of each motor's rows, (motors,); of a method that weights single rows one over each motor's residual.
        status: "ok"; "uncertain" where the log does not determine the torque of other motion, or a standard error;
            "constrained_outside_ci" where constraints contradict an interval; "noisy_positions" where noise of the
            positions, or their filter, changes the predicted torque too much.
        notes: for the user.
        constrained_fit: of a method with inequality constraints: the constrained and the unconstrained estimate, and
            the active constraints; None of the others.
        zero: indices of the parameters fixed at zero, without uncertainty.
        nuisances: by how much one standard error of each nuisance (a delay, the noise of the encoders) moves the
            parameters, by its name, (k, p) each, SI; part of `covariance`. What nuisances that are estimated from the
            same rows are moved by is in the scores of `fit`.
    """

    observation: Observation
    method: Method
    fit: Fit
    intervals: Intervals
    quantities: Quantities
    classical_covariance: Array
    weights: Array
    status: str
    notes: tuple[str, ...]
    constrained_fit: Constrained | BoundedSolution | None = None
    zero: tuple[int, ...] = ()
    nuisances: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze_fields(self, "classical_covariance", "weights")

    @property
    def model(self) -> DynamicModel:
        return self.observation.model

    @property
    def base(self) -> BaseParameters:
        return self.observation.base

    @property
    def names(self) -> tuple[str, ...]:
        """Of the base parameters, (p,)."""
        return self.quantities.names

    @property
    def units(self) -> tuple[str, ...]:
        """Of the base parameters, (p,)."""
        return self.quantities.units

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Time blocks of the logs that it was made from."""
        return self.observation.blocks

    @property
    def free(self) -> Array:
        """Base parameters of the unconstrained fit, to which covariance and standard errors belong, (p,), SI."""
        return self.constrained_fit.free if self.constrained_fit else self.beta

    @cached_property
    def unconstrained(self) -> Quantities:
        """Base parameters of the unconstrained fit, with covariance and degrees of freedom."""
        return replace(self.quantities, values=self.free)

    @property
    def constrained(self) -> bool:
        """Whether a constraint is active, so that `beta` differs from `free`."""
        return bool(self.constrained_fit and self.constrained_fit.active)

    @property
    def free_parameters(self) -> tuple[int, ...]:
        """Indices of the parameters that are not fixed at zero."""
        return tuple(k for k in range(len(self.base)) if k not in self.zero)

    @property
    def feasible(self) -> FeasibleParameters | None:
        """Bodies that have these base parameters, of a method that looks for them."""
        return self.constrained_fit.feasible if isinstance(self.constrained_fit, Constrained) else None

    @property
    def beta(self) -> Array:
        """Base parameters, (p,), SI."""
        return self.quantities.values

    @property
    def covariance(self) -> Array:
        """Cluster-robust covariance, (p, p)."""
        return self.quantities.covariance

    @property
    def dof(self) -> Array:
        """Degrees of freedom of each interval, (p,)."""
        return self.quantities.dof

    @property
    def single_block(self) -> tuple[int, ...]:
        """Parameters excited in a single block: their standard errors cannot be estimated and are infinite."""
        return self.quantities.unbounded

    @cached_property
    def unexcited(self) -> tuple[int, ...]:
        """Indices of the parameters whose values mean nothing, since the rows do not tell them.

        They do not tell such a parameter from zero, and one standard error of it is as much torque, in a reference
        motion at the log's speed, as was measured in the log (`reference_torque`); or it is not determined at all, and
        left out at zero; or it is in the model only through the rounding of the device file's angles. Torque alone does
        not decide: the reference motion may go much further than the device can, where a spring known to 1 % has much.
        """
        invented = {self.names.index(name) for name in self.model.only_by_rounding}
        left_out = set(self.zero) & set(self.single_block)
        return tuple(sorted(invented | left_out | self._open))

    @property
    def _open(self) -> set[int]:
        """Indices of those not told from zero with a standard error of as much torque as measured; none of poses."""
        if not self.observation.motions:
            return set()
        ends = self.conf_int()
        # Constraints may bound a parameter more narrowly; without a standard error there is the classical one.
        finite = np.maximum(np.where(np.isfinite(self.se), self.se, 0.0), self._classical_se)
        size = np.minimum(finite, np.diff(ends, axis=1)[:, 0] / 2)
        large = size * np.linalg.norm(reference_torque(self.observation), axis=0) > 1.0
        untold = not_told_from_zero(self.beta, np.maximum(self.se, self._classical_se), ends)
        return set(np.flatnonzero(large & untold).tolist())

    @property
    def _classical_se(self) -> Array:
        return np.sqrt(np.diag(self.classical_covariance))

    @cached_property
    def torque_uncertainty(self) -> float:
        """Standard error of the torque in other motion of the log's poses, per cent of the measured torque.

        nan where the rows are not of motions, but of poses or of a stream.
        """
        return judged_uncertainty(self.observation, self.covariance)

    @cached_property
    def clusters(self) -> Clusters:
        """Scores of the time blocks, for joint tests of several estimates."""
        return Clusters.of(self.fit, self.shifts)

    @property
    def shifts(self) -> Array:
        """By how much one standard error of each part of the nuisances moves the parameters, (n, p), SI."""
        return np.array([row for shifts in self.nuisances.values() for row in shifts]).reshape(-1, len(self.beta))

    @cached_property
    def between_logs(self) -> BetweenLogs | None:
        """Scatter between logs, and intervals of a repeat; None with fewer than three logs, and of a point estimate."""
        return self.between_logs_of(self.unconstrained, self.beta, np.eye(len(self.beta)))

    def between_logs_of(self, estimated: Quantities, values: Array, C: Array) -> BetweenLogs | None:
        """The same of combinations of base parameters.

        Args:
            estimated: the combinations in the unconstrained fit.
            values: in the estimate, (q,), SI.
            C: factors of the base parameters, (q, p).
        """
        if isinstance(self.method, PointEstimate):
            return None
        return BetweenLogs.of(self.fit, estimated, values, C, self.shifts)

    @property
    def se(self) -> Array:
        """Cluster-robust standard errors, (p,)."""
        return self.quantities.se

    @property
    def correlation(self) -> Array:
        """Correlations of the errors, (p, p); NaN next to a zero variance."""
        return self.quantities.correlation

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals, (p, 2).

        With inequality constraints: by `Profile`, or those of the unconstrained fit, cut at the constraints and widened
        to the estimate.
        """
        if self.constrained_fit is None:
            return self.quantities.conf_int(level)
        if level not in self._constrained_intervals:
            half = half_width(self.se, self.dof, level)
            if isinstance(self.intervals, Limiting):
                ends = self.intervals.limits(self.fit, self.constrained_fit, half)
            else:
                ends = self.constrained_fit.interval(half)
            self._constrained_intervals[level] = read_only(ends)
        return self._constrained_intervals[level]

    @cached_property
    def _constrained_intervals(self) -> dict[float, Array]:
        """Those computed so far, by level: each profile is a set of cone programmes."""
        return {}

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The estimate, parameter by parameter."""
        classical = self._classical_se
        constrained_outside_ci = (
            self.constrained_fit.constrained_outside_ci(half_width(self.se, self.dof)) if self.constrained_fit else ()
        )
        return tuple(
            Parameter(
                name=name,
                unit=self.base.units[k],
                grouping=self.base.groupings[k],
                value=float(self.beta[k]),
                se=float(self.se[k]),
                classical_se=float(classical[k]),
                prior=self.model.base_prior[k],
                free=float(self.free[k]),
                constrained_outside_ci=name in constrained_outside_ci,
                owner=self,
                index=k,
            )
            for k, name in enumerate(self.names)
        )

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[index_of(name, self.base.names, "base parameter")]

    def spread(self, combinations: Array) -> Spread:
        """Covariance and degrees of freedom of combinations (q, p) of base parameters, of the unconstrained fit."""
        spread = self.intervals.spread(self.fit, combinations)
        for shifts in self.nuisances.values():
            covariance, dof = with_prior_variance(spread.covariance, spread.dof, combinations, shifts)
            spread = replace(spread, covariance=covariance, dof=dof)
        return spread

    def with_nuisance(self, name: str, shifts: Array) -> Estimate:
        """The estimate with the variance that a nuisance adds in its covariance.

        Args:
            name: of the nuisance, "torque delay".
            shifts: by how much one standard error of each of its k parts moves the base parameters, (k, p), SI.
        """
        own = self.quantities
        covariance, dof = with_prior_variance(own.covariance, own.dof, np.eye(len(own.values)), shifts)
        return replace(
            self,
            quantities=replace(own, covariance=covariance, dof=dof),
            nuisances={**self.nuisances, name: read_only(shifts)},
        )

    def with_moved_nuisances(self, moved: Array) -> Estimate:
        """The estimate with the errors of nuisances that are estimated from its own rows in its scores and covariance.

        Args:
            moved: by how much the errors of each time block move the parameters through them, (blocks, p), SI.
        """
        made = replace(self, fit=self.fit.with_moved(read_only(moved)))
        spread = made.spread(np.eye(len(self.beta)))
        return replace(made, quantities=replace(self.quantities, covariance=spread.covariance, dof=spread.dof))

    def with_nuisances_of(self, other: Estimate) -> Estimate:
        """The estimate with the nuisances of another one: by block where the rows are the same, else by their size."""
        made, moved = self, other.fit.moved
        if moved is not None and other.blocks == self.blocks and isinstance(self.intervals, ClusterRobust):
            made = made.with_moved_nuisances(moved)
        elif moved is not None:
            _, sizes, directions = np.linalg.svd(moved, full_matrices=False)
            made = made.with_nuisance(_MOVED, sizes[:, None] * directions)
        for name, shifts in other.nuisances.items():
            made = made.with_nuisance(name, shifts)
        return made

    def _shown(self) -> Overview:
        rows = [[p.name, *p.cells[:3], p.unit] for p in self.parameters]
        title = f"Estimate of {self.model.device.name} by {self.method.name}: {self.observation.rows} rows"
        return Overview(title, ("", "value", "95 % interval", "std err %", "unit"), rows, self.notes)


def estimate(observation: Observation, method: Method, intervals: Intervals | None = None) -> Estimate:
    """Estimate base parameters with cluster-robust confidence intervals.

    Args:
        method: `OLS()`, `WLS()`, `GLS()`, `PhysicallyConsistent()`, ...
        intervals: covariance estimator; `ClusterRobust()` where None.

    Raises:
        NoRowsError: fewer rows than parameters.
        IdentifiabilityError: the motion does not excite a direction of the parameters.
        PhysicalConsistencyError, ConvergenceError: `PhysicallyConsistent()` finds no bodies.
    """
    intervals = intervals or ClusterRobust()
    zero = method.zero(observation) if isinstance(method, Reduced) else ()
    fit = method.fit(observation) if isinstance(method, Fitting) else fitted(observation, method, zero)
    solution, spread = fit.solution, intervals.spread(fit)
    constrained = method.constrain(observation, solution) if isinstance(method, Restricted) else None
    quantities = Quantities(
        names=observation.base.names,
        units=observation.base.units,
        values=constrained.beta if constrained else solution.beta,
        covariance=spread.covariance,
        dof=spread.dof,
        unbounded=tuple(
            int(k) for k in (range(len(solution.beta)) if isinstance(method, PointEstimate) else spread.alone)
        ),
    )
    status, notes = _status_and_notes(observation, method, quantities, constrained, zero)
    own = fit.observation is observation
    made = Estimate(
        observation=observation,
        method=method,
        fit=fit,
        intervals=intervals,
        quantities=quantities,
        classical_covariance=fit.classical_covariance,
        weights=fit.weights if own else np.array([WLS().weight(m, solution.beta) for m in observation.motors]),
        status=status,
        notes=notes,
        constrained_fit=constrained,
        zero=zero,
    )
    return made if isinstance(method, PointEstimate) else judged(made)


def judged(fitted: Estimate) -> Estimate:
    """An estimate with status and notes on the torque of other motion, by its present covariance."""
    notes = tuple(note for note in fitted.notes if not note.startswith(_UNDETERMINED))
    size, unbounded = fitted.torque_uncertainty, bool(fitted.single_block)
    if unbounded or not size > _LARGEST_SE:
        return fitted if notes == fitted.notes else replace(fitted, notes=notes)
    text = (
        f"{_UNDETERMINED}: its standard error is {per_cent(size, 3)} of the measured torque (limit {_LARGEST_SE:g} %). "
        "Record longer, or motion that differs more in speed and acceleration from pose to pose."
    )
    return replace(fitted, status="uncertain" if fitted.status == "ok" else fitted.status, notes=(text, *notes))


def fitted(observation: Observation, method: Method, zero: tuple[int, ...]) -> Fit:
    """Least squares on the rows as the method transforms them, with its equality constraints and priors."""
    known = method.knowledge(observation) if isinstance(method, Knowing) else None
    rows = rows_of(method, observation)
    weights = method.weights(rows)
    return Fit(rows, weights, solve(rows, weights, zero, known), method.unit_residual)


def _status_and_notes(
    observation: Observation,
    method: Method,
    quantities: Quantities,
    constrained: Constrained | BoundedSolution | None,
    zero: tuple[int, ...],
) -> tuple[str, tuple[str, ...]]:
    """The status of an estimate, and notes for the user, each once."""
    notes = list(observation.model.device.notes)
    for motion in observation.motions:
        notes += motion.log.notes if motion.log else ()
    notes = list(dict.fromkeys([*notes, *observation.notes]))
    if observation.model.only_by_rounding:
        notes.append(
            f"{', '.join(observation.model.only_by_rounding)}: in the model only through the rounding of the device "
            "file's angles (`haptid model` says where). Do not quote these values."
        )
    raw, scaled = observation.condition_without(zero)
    status = "ok"
    if scaled > WELL_CONDITIONED:
        notes.append(
            f"The regressor is ill-conditioned (condition number {scaled:.0f} with unit columns, {raw:.0f} raw). "
            f"Torque is predicted for motion like the log's; single parameters only where the standard error is small."
        )
    if isinstance(method, PointEstimate):
        notes.append(method.why_no_intervals)
    elif quantities.unbounded:
        status = "uncertain"
        names = ", ".join(quantities.names[k] for k in quantities.unbounded)
        notes.append(
            f"Excited in a single time block: {names}. The standard error cannot be estimated (interval: unbounded). "
            f"Record longer, or repeat the motion."
        )
    if constrained:
        half = half_width(quantities.se, quantities.dof)
        status = "constrained_outside_ci" if constrained.constrained_outside_ci(half) else status
        notes += constrained.notes(half)
    return status, tuple(notes)
