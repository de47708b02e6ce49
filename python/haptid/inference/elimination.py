"""Essential parameters: base parameters left out one by one, as long as the log does not miss them.

The parameter of the largest relative deviation is left out and the rest estimated again (Gautier 1997; Janot et al.
2007, section 4), until the largest is within a rule, or until an F-test against the full model objects.

The deviation is the honest one. The test is Rao and Scott's (1984, Annals of Statistics 12(1)), for residuals that
are serially correlated: with C the honest and T the textbook covariance of the d parameters left out, A = T^-1 C,

    F = b' T^-1 b / tr A,  on k = (tr A)^2 / tr A^2 and k nu degrees of freedom,

where b are their values in the full model and nu the least of their effective degrees of freedom (blocks that carry
them, over time blocks). White residuals have C = T: then it is the textbook F-test, (rise of the residual's sum of
squares / d) / variance. Of one parameter it is the square of its honest t.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy import linalg, stats

from haptid._internal.arrays import Array, positive
from haptid.errors import MethodSettingError
from haptid.estimation.estimate import Estimate, Restricted, estimate
from haptid.estimation.least_squares import EXCITED
from haptid.estimation.methods.zeroed import FixedAtZero
from haptid.motion.treatment import Motion
from haptid.observation.observation import Observation, observe
from haptid.validation.validation import Validation, direct, validate

# An F-test objects below this probability.
LEVEL = 0.05
# Columns of unit length whose least singular value is below this are told apart by rounding alone.
BY_ITSELF = 1e-7


class Rule(Protocol):
    """When the largest relative deviation is small enough."""

    def limit(self, smallest: float) -> float:
        """What it must not exceed, per cent, from the smallest one."""

    @property
    def text(self) -> str:
        """The rule in words."""


@dataclass(frozen=True)
class GautierRatio:
    """Gautier's rule: no relative deviation is over so many times the smallest one.

    Attributes:
        times: how many.
    """

    times: float = 10.0

    def __post_init__(self) -> None:
        if not (positive(self.times) and self.times > 1):
            raise MethodSettingError("GautierRatio", "times", self.times, "a finite number above 1")

    def limit(self, smallest: float) -> float:
        """What the largest must not exceed, per cent, from the smallest one."""
        return self.times * smallest

    @property
    def text(self) -> str:
        """The rule in words."""
        return f"{self.times:g} times the smallest"


@dataclass(frozen=True)
class MaxRelativeStd:
    """No relative deviation is over a stated one.

    Attributes:
        percent: of the value.
    """

    percent: float = 30.0

    def __post_init__(self) -> None:
        if not positive(self.percent):
            raise MethodSettingError("MaxRelativeStd", "percent", self.percent, "a finite number above zero")

    def limit(self, smallest: float) -> float:
        """What the largest must not exceed, per cent, whatever the smallest."""
        del smallest
        return self.percent

    @property
    def text(self) -> str:
        """The rule in words."""
        return f"{self.percent:g} %"


@dataclass(frozen=True)
class FTest:
    """An F-test of parameters left out, against the full model.

    Attributes:
        F: statistic.
        dof: degrees of freedom above and below.
        p: probability of as large an F if those parameters were zero.
    """

    F: float
    dof: tuple[float, float]
    p: float


@dataclass(frozen=True)
class Drop:
    """One parameter left out, after those before it.

    Attributes:
        name: of the parameter.
        relative_se: before it was left out, per cent of its value.
        test: of it and all those before it together.
        error: relative error of the torque without them, on the rows of the fit, per cent.
    """

    name: str
    relative_se: float
    test: FTest
    error: float


@dataclass(frozen=True, eq=False)
class Elimination:
    """An estimate and its essential parameters.

    Attributes:
        full: the estimate that it began with.
        reduced: the last one: zero for the parameters left out, and otherwise an estimate like any other.
        drops: in order.
        refused: what the F-test objected to, None where it did not.
        reason: why it ended there, a sentence.
        seen: relative error of both on the rows of the fit, full and reduced.
        unseen: the same on unseen rows, None without them.
    """

    full: Estimate
    reduced: Estimate
    drops: tuple[Drop, ...]
    refused: Drop | None
    reason: str
    seen: tuple[Validation, Validation]
    unseen: tuple[Validation, Validation] | None

    @property
    def essential(self) -> tuple[str, ...]:
        """Names of the parameters kept."""
        return tuple(self.reduced.base.names[k] for k in self.reduced.kept)

    @property
    def shift(self) -> Array:
        """How far leaving out others moved each parameter, in its own deviations of before, (p,); NaN if left out."""
        moved = (self.reduced.beta - self.full.beta) / np.where(self.full.se > 0, self.full.se, np.nan)
        moved[list(self.reduced.zero)] = np.nan
        return np.asarray(moved)

    def summary(self) -> str:
        """As text: what was left out, what that moved, the reduced estimate, and both errors."""
        lines = [f"{len(self.full.kept)} parameters, {len(self.essential)} essential. {self.reason}"]
        for k, drop in enumerate(self.drops, 1):
            lines.append(f"  {k:2d} without {_line(drop)}")
        if self.refused:
            lines.append(f"     refused {_line(self.refused)}")
        for k in self.reduced.kept:
            p = self.reduced.parameters[k]
            lines.append(
                f"  {p.name:8s} {p.value:11.4g} {p.unit:10s} {p.interval[0]:11.4g} .. {p.interval[1]:.4g}, "
                f"{p.relative_se:.2g} %, moved by {self.shift[k]:+.2f} of its deviations"
            )
        for kind, both in (("rows of the fit", self.seen), ("unseen rows", self.unseen)):
            if both:
                lines.append(f"  error on {kind}: {both[0].relative:.3f} % full, {both[1].relative:.3f} % reduced")
        return "\n".join(lines)


def _line(drop: Drop) -> str:
    F, (above, below) = drop.test.F, drop.test.dof
    return (
        f"{drop.name:8s} relative deviation {drop.relative_se:9.3g} %, F({above:.1f}, {below:.0f}) = {F:.3g}, "
        f"p = {drop.test.p:.2g}, error {drop.error:.3f} %"
    )


@dataclass(frozen=True)
class BackwardElimination:
    """How to find essential parameters.

    Attributes:
        rule: when the largest relative deviation is small enough.
        level: probability below which the F-test objects.
    """

    rule: Rule = field(default_factory=GautierRatio)
    level: float = LEVEL

    def __post_init__(self) -> None:
        if not 0 < self.level < 1:
            raise MethodSettingError("Essential", "level", self.level, "a probability between 0 and 1")


def essential(
    full: Estimate, how: BackwardElimination | None = None, unseen: Motion | Observation | None = None
) -> Elimination:
    """Leave out, one by one, the parameters that the log does not miss.

    Args:
        full: an estimate by `OLS()` or `WLS()`; what it has left out already stays out.
        how: rule and level; Gautier's rule at 0.05 where left out.
        unseen: rows that the fit has not seen, to compare both on.

    Raises:
        MethodSettingError: the estimate is held to what bodies can have: a zero may lie outside of that.
        SeenRowsError: rows of `unseen` were in the fit.
    """
    if isinstance(full.method, Restricted):
        raise MethodSettingError("essential", "the method", full.method.name, "the estimate by OLS() or WLS()")
    how = how or BackwardElimination()
    if isinstance(unseen, Motion):
        unseen = observe(full.model, unseen)
    now, refused = full, None
    drops: list[Drop] = []
    while (name := largest(now)) is not None and not within(now, how.rule):
        smaller = without(full, (*(drop.name for drop in drops), name))
        drop = Drop(name, now[name].relative_se, objection(full, smaller.zero), direct(smaller).relative)
        if drop.test.p < how.level:
            refused = drop
            break
        now, drops = smaller, [*drops, drop]
    both = (validate(full, unseen), validate(now, unseen)) if unseen is not None else None
    return Elimination(full, now, tuple(drops), refused, reason(now, refused, how), (direct(full), direct(now)), both)


def eliminate_by_motor(
    full: Estimate, how: BackwardElimination | None = None, unseen: Motion | Observation | None = None
) -> tuple[Elimination, ...]:
    """The same for every motor by itself: the parameters that its own rows do not miss.

    One motor's rows may not tell all the parameters that they hold apart. Of those that they do not, the ones that
    come last are left out from the start, and `full` of that motor's reduction stands for sums of them.

    Args:
        full: an estimate of all motors.
        how: rule and level.
        unseen: rows that the fit has not seen.
    """
    if isinstance(unseen, Motion):
        unseen = observe(full.model, unseen)
    found = []
    for motor in full.observation.motors:
        rows = full.observation.only(motor.name)
        names = tuple(full.base.names[k] for k in sorted({*full.zero, *untold(rows)}))
        own = estimate(rows, FixedAtZero(names, _weighting(full)))
        found.append(essential(own, how, unseen.only(motor.name) if unseen is not None else None))
    return tuple(found)


def without(full: Estimate, names: tuple[str, ...]) -> Estimate:
    """The same rows and method with more parameters left out."""
    already = tuple(full.base.names[k] for k in full.zero)
    return estimate(full.observation, FixedAtZero((*already, *names), _weighting(full)))


def _weighting(full: Estimate) -> Fixed:
    return Fixed(full.method.name, full.method.unit_residual, tuple(full.weights.tolist()), _motors(full.observation))


def _motors(observation: Observation) -> tuple[str, ...]:
    return tuple(motor.name for motor in observation.motors)


@dataclass(frozen=True)
class Fixed:
    """Weights that are known already: of a fit with more parameters.

    Attributes:
        name, unit_residual: of the method that made them.
        by_motor: weight of each motor's rows.
        motors: their names.
    """

    name: str
    unit_residual: bool
    by_motor: tuple[float, ...]
    motors: tuple[str, ...]

    def weights(self, observation: Observation) -> Array:
        """Of the observation's motors, (motors,)."""
        known = dict(zip(self.motors, self.by_motor, strict=True))
        return np.array([known[motor.name] for motor in observation.motors])


def largest(now: Estimate) -> str | None:
    """The parameter of the largest relative deviation; None where only one is left."""
    kept = now.kept
    if len(kept) < 2:
        return None
    return now.base.names[max(kept, key=lambda k: now.parameters[k].relative_se)]


def within(now: Estimate, rule: Rule) -> bool:
    """Whether the largest relative deviation obeys the rule."""
    relative = [now.parameters[k].relative_se for k in now.kept]
    return max(relative) <= rule.limit(min(relative))


def objection(full: Estimate, zero: tuple[int, ...]) -> FTest:
    """Rao and Scott's F-test that all parameters of `zero` that the full model has are zero."""
    out = [k for k in zero if k not in full.zero]
    square = np.ix_(out, out)
    factor = linalg.cholesky(full.classical_covariance[square], lower=True)
    half = linalg.solve_triangular(factor, full.covariance[square], lower=True)
    A = linalg.solve_triangular(factor, half.T, lower=True)
    b = linalg.solve_triangular(factor, full.beta[out], lower=True)
    inflation = float(np.trace(A))
    above = inflation**2 / float(np.sum(A**2))
    below = above * float(full.dof[out].min())
    F = float(b @ b) / inflation
    return FTest(F, (above, below), float(stats.f.sf(F, above, below)))


def reason(now: Estimate, refused: Drop | None, how: BackwardElimination) -> str:
    """Why the reduction ended."""
    if refused is not None:
        return (
            f"The F-test objects to leaving out {refused.name}, whose relative deviation is {refused.relative_se:.3g} "
            f"%: p = {refused.test.p:.2g}, below {how.level:g}."
        )
    if len(now.kept) < 2:
        return "Only one parameter is left."
    return f"The largest relative deviation is within {how.rule.text}."


def untold(rows: Observation) -> tuple[int, ...]:
    """Indices of the base parameters whose columns the rows do not have, or make of those before them."""
    R = rows.stack()[:-1, :-1]
    lengths = np.linalg.norm(R, axis=0)
    scaled = R / np.where(lengths > 0, lengths, 1.0)
    kept: list[int] = []
    for k in range(len(lengths)):
        least = np.linalg.svd(scaled[:, [*kept, k]], compute_uv=False)[-1]
        if lengths[k] > EXCITED * lengths.max() and least > BY_ITSELF:
            kept.append(k)
    return tuple(k for k in range(len(lengths)) if k not in kept)
