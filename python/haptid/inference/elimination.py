"""Essential parameters by backward elimination of base parameters, stopped by a robust F-test.

The parameter with the largest relative standard error is set to zero and the rest estimated again (Gautier 1997; Janot
et al. 2007, section 4), until the largest satisfies a rule, or until an F-test against the full model is significant.

Standard errors are cluster-robust. The test is that of Rao and Scott (1984, Annals of Statistics 12(1)), for serially
correlated residuals: with C the cluster-robust and T the classical covariance of the d eliminated parameters,
A = T^-1 C,

    F = b' T^-1 b / tr A,  on k = (tr A)^2 / tr A^2 and k nu degrees of freedom,

where b are their values in the full model and nu the least of their effective degrees of freedom. White residuals have
C = T: then it is the classical F-test, (increase of the residual sum of squares / d) / variance. For one parameter it
is the square of its cluster-robust t.
"""

from __future__ import annotations

from dataclasses import field
from typing import Protocol

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.errors import setting_error
from haptid.estimation.bias import like
from haptid.estimation.estimate import Estimate, Restricted, estimate
from haptid.estimation.least_squares import EXCITED
from haptid.estimation.method import Method
from haptid.estimation.methods.constrained import FixedAtZero
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation, observe
from haptid.uncertainty.distributions import f_tail
from haptid.uncertainty.figures import per_cent, relative_se_cell
from haptid.uncertainty.quantities import aligned
from haptid.validation.validation import Validation, fit_errors, validate

# Significance level of the F-test.
_SIGNIFICANCE = 0.05
# Columns of unit length whose least singular value is below this are collinear to rounding error.
COLLINEAR = 1e-7


class Rule(Protocol):
    """When the largest relative standard error is small enough."""

    def limit(self, smallest: float) -> float:
        """Its upper limit, per cent, given the smallest one."""

    @property
    def text(self) -> str:
        """The rule in words."""


@dataclass(frozen=True)
class GautierRatio:
    """Gautier's rule: the ratio of the largest to the smallest relative standard error.

    Attributes:
        times: upper limit of the ratio.
    """

    times: float = 10.0

    def __post_init__(self) -> None:
        if not (positive(self.times) and self.times > 1):
            raise setting_error("times", self.times, "a finite number above 1", "GautierRatio")

    def limit(self, smallest: float) -> float:
        """Upper limit of the largest, per cent, given the smallest one."""
        return self.times * smallest

    @property
    def text(self) -> str:
        """The rule in words."""
        return f"{self.times:g} times the smallest"


@dataclass(frozen=True)
class MaxRelativeStd:
    """A fixed upper limit of the relative standard error.

    Attributes:
        percent: of the value.
    """

    percent: float = 30.0

    def __post_init__(self) -> None:
        if not positive(self.percent):
            raise setting_error("percent", self.percent, "a finite number above zero", "MaxRelativeStd")

    def limit(self, smallest: float) -> float:
        """Upper limit of the largest, per cent, for any smallest one."""
        del smallest
        return self.percent

    @property
    def text(self) -> str:
        """The rule in words."""
        return f"{self.percent:g} %"


@dataclass(frozen=True)
class FTest:
    """F-test of eliminated parameters against the full model.

    Attributes:
        F: statistic.
        dof: degrees of freedom of numerator and denominator.
        p: p-value of the hypothesis that these parameters are zero.
    """

    F: float
    dof: tuple[float, float]
    p: float


@dataclass(frozen=True)
class EliminationStep:
    """One step of the elimination.

    Attributes:
        name: of the parameter eliminated.
        relative_se: before the step, per cent of its value.
        test: of it and all those eliminated before it.
        error: relative torque error without them, on the rows of the fit, per cent.
    """

    name: str
    relative_se: float
    test: FTest
    error: float


@dataclass(frozen=True, eq=False)
class Elimination:
    """Backward elimination from a full to a reduced estimate.

    Attributes:
        full: the estimate at the start.
        reduced: the estimate at the end, with zero for the eliminated parameters.
        steps: the steps, in order.
        rejected: the step that the F-test rejected, None where there was none.
        reason: the stopping criterion that was met, a sentence.
        seen: errors of both on the rows of the fit, full and reduced.
        unseen: the same on unseen rows, None without them.
    """

    full: Estimate
    reduced: Estimate
    steps: tuple[EliminationStep, ...]
    rejected: EliminationStep | None
    reason: str
    seen: tuple[Validation, Validation]
    unseen: tuple[Validation, Validation] | None

    @property
    def essential(self) -> tuple[str, ...]:
        """Names of the essential parameters: those that remain."""
        return tuple(self.reduced.base.names[k] for k in self.reduced.free_parameters)

    @property
    def shift(self) -> Array:
        """Change of each parameter, in its standard errors in the full model, (p,); NaN if eliminated."""
        moved = (self.reduced.beta - self.full.beta) / np.where(self.full.se > 0, self.full.se, np.nan)
        moved[list(self.reduced.zero)] = np.nan
        return np.asarray(moved)

    def summary(self) -> str:
        """As text: the steps, the reduced estimate with the change of each parameter, and both errors."""
        parts = [
            [f"{len(self.full.free_parameters)} parameters, {len(self.essential)} essential. {self.reason}"],
            self._steps_table(),
            self._essential_table(),
            aligned(
                [
                    ["error %", "full", "reduced"],
                    *(
                        [kind, *(per_cent(v.relative, 3).removesuffix(" %") for v in validations)]
                        for kind, validations in (("rows of the fit", self.seen), ("unseen rows", self.unseen))
                        if validations
                    ),
                ]
            ),
        ]
        return "\n\n".join("\n".join(lines) for lines in parts if lines)

    def _steps_table(self) -> list[str]:
        """The steps, and the one that was rejected."""
        tried = [*self.steps, *([self.rejected] if self.rejected else [])]
        if not tried:
            return []
        rows = [
            [
                step.name,
                relative_se_cell(step.relative_se, 100.0),
                f"{step.test.F:.3g}",
                f"{step.test.dof[0]:.1f}, {step.test.dof[1]:.0f}",
                f"{step.test.p:.2g}",
                per_cent(step.error, 3).removesuffix(" %"),
                "rejected" if step is self.rejected else "",
            ]
            for step in tried
        ]
        return aligned([["without", "std err %", "F", "dof", "p", "error %", ""], *rows])

    def _essential_table(self) -> list[str]:
        """The parameters that remain, to the digits that their standard errors leave."""
        parameters = self.reduced.parameters
        rows = [
            [p.name, p.cells.value, p.cells.interval, p.unit, p.cells.relative, f"{self.shift[p.index]:+.2f}"]
            for p in (parameters[k] for k in self.reduced.free_parameters)
        ]
        return aligned([["essential", "value", "95 % interval", "unit", "std err %", "change, std errs"], *rows])


@dataclass(frozen=True)
class BackwardElimination:
    """Settings of backward elimination.

    Attributes:
        rule: when the largest relative standard error is small enough.
        level: significance level of the F-test.
    """

    rule: Rule = field(default_factory=GautierRatio)
    level: float = _SIGNIFICANCE

    def __post_init__(self) -> None:
        if not 0 < self.level < 1:
            raise setting_error("level", self.level, "a probability between 0 and 1", "BackwardElimination")


def eliminate(
    full: Estimate, procedure: BackwardElimination | None = None, unseen: Motion | Observation | None = None
) -> Elimination:
    """Essential parameters of an estimate, by backward elimination.

    Args:
        full: an estimate by `OLS()` or `WLS()`; parameters that are already eliminated stay so.
        procedure: rule and significance level; Gautier's rule at 0.05 where None.
        unseen: rows outside the fit, on which both are validated.

    Raises:
        SettingError: the estimate is constrained: a zero may violate the constraints.
        SharedRowsError: rows of `unseen` were in the fit.
    """
    if isinstance(full.method, Restricted):
        raise setting_error("the method", full.method.name, "the estimate by OLS() or WLS()", "eliminate")
    procedure = procedure or BackwardElimination()
    if isinstance(unseen, Motion):
        unseen = observe(full.model, unseen)
    now, rejected = full, None
    steps: list[EliminationStep] = []
    while (name := least_precise(now)) is not None and not satisfied(now, procedure.rule):
        smaller = refit_without(full, (*(step.name for step in steps), name))
        step = EliminationStep(
            name, now[name].relative_se, rao_scott_test(full, smaller.zero), fit_errors(smaller).relative
        )
        if step.test.p < procedure.level:
            rejected = step
            break
        now, steps = smaller, [*steps, step]
    validations = (validate(full, unseen), validate(now, unseen)) if unseen is not None else None
    return Elimination(
        full,
        now,
        tuple(steps),
        rejected,
        stop_reason(now, rejected, procedure),
        (fit_errors(full), fit_errors(now)),
        validations,
    )


def eliminate_by_motor(
    full: Estimate, procedure: BackwardElimination | None = None, unseen: Motion | Observation | None = None
) -> tuple[Elimination, ...]:
    """Backward elimination for every motor separately, on its own rows.

    From one motor's rows alone, not all parameters may be identifiable. Collinear ones that come last are eliminated at
    the start, and `full` of that motor's elimination has linear combinations of them. Delays and noise of positions
    are found from the rows of all motors: here intervals are without them, and nothing is subtracted.

    Args:
        full: an estimate of all motors.
        procedure: rule and significance level.
        unseen: rows outside the fit.
    """
    if isinstance(unseen, Motion):
        unseen = observe(full.model, unseen)
    eliminations = []
    for motor in full.observation.motors:
        rows = full.observation.only(motor.name)
        names = tuple(full.base.names[k] for k in sorted({*full.zero, *not_identifiable(rows)}))
        own = estimate(rows, FixedAtZero(names, _weighting(full)))
        eliminations.append(eliminate(own, procedure, unseen.only(motor.name) if unseen is not None else None))
    return tuple(eliminations)


def refit_without(full: Estimate, names: tuple[str, ...]) -> Estimate:
    """The estimate from the same rows and weights, with more parameters at zero, and what the treatment moves them by.

    What is subtracted from the full one is subtracted here, and its nuisances (delays, noise) are in the intervals.
    """
    already = tuple(full.base.names[k] for k in full.zero)
    return like(estimate(full.observation, FixedAtZero((*already, *names), _weighting(full))), full)


def _weighting(full: Estimate) -> FixedWeights:
    names = tuple(motor.name for motor in full.observation.motors)
    return FixedWeights(full.method, tuple(full.weights.tolist()), names)


@dataclass(frozen=True)
class FixedWeights:
    """Weights fixed at those of a fit with more parameters.

    Attributes:
        method: that made them.
        by_motor: weight of each motor's rows.
        motors: their names.
    """

    method: Method
    by_motor: tuple[float, ...]
    motors: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.method.name

    @property
    def unit_residual(self) -> bool:
        return self.method.unit_residual

    def weights(self, observation: Observation) -> Array:
        """Of the observation's motors, (motors,)."""
        known = dict(zip(self.motors, self.by_motor, strict=True))
        return np.array([known[motor.name] for motor in observation.motors])


def least_precise(now: Estimate) -> str | None:
    """The parameter with the largest relative standard error; None where only one is left."""
    free = now.free_parameters
    if len(free) < 2:
        return None
    return now.base.names[max(free, key=lambda k: now.parameters[k].relative_se)]


def satisfied(now: Estimate, rule: Rule) -> bool:
    """Whether the largest relative standard error satisfies the rule."""
    relative = [now.parameters[k].relative_se for k in now.free_parameters]
    return max(relative) <= rule.limit(min(relative))


def rao_scott_test(full: Estimate, zero: tuple[int, ...]) -> FTest:
    """Rao and Scott's F-test that the parameters `zero` of the full model are zero."""
    left_out = [k for k in zero if k not in full.zero]
    square = np.ix_(left_out, left_out)
    factor = linalg.cholesky(full.classical_covariance[square], lower=True)
    half = linalg.solve_triangular(factor, full.covariance[square], lower=True)
    A = linalg.solve_triangular(factor, half.T, lower=True)
    b = linalg.solve_triangular(factor, full.beta[left_out], lower=True)
    inflation = float(np.trace(A))
    above = inflation**2 / float(np.sum(A**2))
    below = above * float(full.dof[left_out].min())
    F = float(b @ b) / inflation
    return FTest(F, (above, below), float(f_tail(F, above, below)))


def stop_reason(now: Estimate, rejected: EliminationStep | None, procedure: BackwardElimination) -> str:
    """Which stopping criterion was met."""
    if rejected is not None:
        return (
            f"The F-test rejects the elimination of {rejected.name}, whose relative standard error is "
            f"{rejected.relative_se:.3g} %: p = {rejected.test.p:.2g}, below {procedure.level:g}."
        )
    if len(now.free_parameters) < 2:
        return "Only one parameter is left."
    return f"The largest relative standard error is within {procedure.rule.text}."


def not_identifiable(rows: Observation) -> tuple[int, ...]:
    """Indices of the base parameters whose columns are zero, or collinear with those before them."""
    R = rows.stack()[:-1, :-1]
    lengths = np.linalg.norm(R, axis=0)
    scaled = R / np.where(lengths > 0, lengths, 1.0)
    independent: list[int] = []
    for k in range(len(lengths)):
        least = np.linalg.svd(scaled[:, [*independent, k]], compute_uv=False)[-1]
        if lengths[k] > EXCITED * lengths.max() and least > COLLINEAR:
            independent.append(k)
    return tuple(k for k in range(len(lengths)) if k not in independent)
