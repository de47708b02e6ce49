"""Differences of parameters, of two estimates and of several, with tests and sentences.

Sources: Welch (1947), Biometrika 34, eq. (28); Welch (1951), Biometrika 38, eq. (20); Holm (1979), Scandinavian Journal
of Statistics 6.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.inference.joint_tests import DETECTION_POWER, JointTests
from haptid.uncertainty.distributions import t_quantile
from haptid.uncertainty.multiple_testing import holm_adjusted, johansen_p, se_above_rounding, two_sided
from haptid.uncertainty.quantities import aligned, half_width


class FamilyWise(ABC):
    """Base of results with a p-value for each of some named parameters, corrected for their number by Holm."""

    names: tuple[str, ...]
    confidence: float

    @property
    @abstractmethod
    def p(self) -> Array:
        """p-value of each parameter by itself, (k,)."""

    @cached_property
    def holm(self) -> Array:
        """p-values with Holm's correction over all parameters, (k,)."""
        return holm_adjusted(self.p)

    @cached_property
    def differs(self) -> tuple[str, ...]:
        """Names of the parameters that differ significantly."""
        return significant(self.names, self.holm, self.confidence)

    @property
    def _ranked(self) -> list[int]:
        """Indices of the parameters that differ, in order of significance."""
        return sorted((self.names.index(name) for name in self.differs), key=lambda k: float(self.p[k]))

    @abstractmethod
    def summary(self) -> str:
        """As text, the title in its first line."""

    def _shown(self) -> Overview:
        return Overview.of_text(self.summary())


@displayed
@dataclass(frozen=True, eq=False)
class Comparison(FamilyWise):
    """Differences between two independent estimates, second minus first, parameter by parameter.

    Each difference has Welch's test: its variance is the sum of both, its degrees of freedom are those of Welch (1947),
    eq. (28), from the degrees of freedom of each. Holm's correction controls the probability of any false difference
    over all parameters. Of a constrained estimate the unconstrained fit is compared, whose standard errors are known.

    Attributes:
        names, units: of the parameters compared, (k,).
        first, second: values, (k,).
        first_se, second_se: cluster-robust standard errors, infinite where they cannot be estimated, (k,).
        first_dof, second_dof: degrees of freedom of each, (k,).
        covariance: of second - first, the sum of both, (k, k).
        confidence: family-wise confidence level at which a parameter counts as different.
        notes: sentences for the user.
        joint: tests of groups of directions; None where the estimates have no common base parameters.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: Array
    second: Array
    first_se: Array
    second_se: Array
    first_dof: Array
    second_dof: Array
    covariance: Array
    confidence: float
    notes: tuple[str, ...]
    joint: JointTests | None = None

    def __post_init__(self) -> None:
        freeze_fields(self, "first", "second", "first_se", "second_se", "first_dof", "second_dof", "covariance")

    @property
    def difference(self) -> Array:
        """Second minus first, (k,)."""
        return self.second - self.first

    @cached_property
    def se(self) -> Array:
        """Standard errors of the differences, (k,)."""
        return freeze(np.hypot(self.first_se, self.second_se))

    @cached_property
    def dof(self) -> Array:
        """Degrees of freedom, (k,) (Welch 1947, eq. 28); the smaller one where a standard error is infinite."""
        a, b = self.first_se**2, self.second_se**2
        least = np.minimum(self.first_dof, self.second_dof)
        with np.errstate(invalid="ignore"):
            dof = (a + b) ** 2 / (a**2 / self.first_dof + b**2 / self.second_dof)
        return freeze(np.where(np.isfinite(dof), dof, least))

    def conf_int(self, level: float | None = None) -> Array:
        """Confidence intervals of the differences, one by one, (k, 2); at `confidence` where no level is given."""
        half = half_width(self.se, self.dof, self.confidence if level is None else level)
        return freeze(np.column_stack([self.difference - half, self.difference + half]))

    @cached_property
    def detectable(self) -> Array:
        """Smallest change that is found in 80 % of such comparisons, (k,)."""
        return detectable(self.se, self.dof, self.confidence)

    @cached_property
    def p(self) -> Array:
        """p-value of each difference by itself, (k,)."""
        return freeze(two_sided(self.difference, self.se, self.dof))

    @cached_property
    def flipped(self) -> tuple[str, ...]:
        """Those that differ and have changed sign, both values being significantly different from zero."""
        sides = ((self.first, self.first_se, self.first_dof), (self.second, self.second_se, self.second_dof))
        nonzero = np.all([two_sided(*side) < 1 - self.confidence for side in sides], axis=0)
        turned = nonzero & (np.sign(self.first) != np.sign(self.second))
        return tuple(name for name, flip in zip(self.names, turned, strict=True) if flip and name in self.differs)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What differs, in order of significance; then the notes."""
        order = self._ranked
        rest = len(self.names) - len(order)
        confidence = family_wise(self.confidence, len(self.names))
        last = f"The other {rest} do not differ {confidence}." if rest else f"All differ {confidence}."
        joint = self.joint.sentences if self.joint else ()
        return (
            *map(self._sentence, order),
            last if order else f"No parameter differs {confidence}.",
            *joint,
            *self.notes,
        )

    def summary(self) -> str:
        """A text table with Holm's p-values and an asterisk for each significant difference; then the sentences."""
        interval = f"{100 * self.confidence:g} % interval"
        rows = [["", "first", "std err", "second", "std err", "difference", interval, "p", "", "detectable", "unit"]]
        for k, (low, high) in enumerate(self.conf_int()):
            rows.append(
                [
                    self.names[k],
                    f"{self.first[k]:.4g}",
                    f"{self.first_se[k]:.2g}",
                    f"{self.second[k]:.4g}",
                    f"{self.second_se[k]:.2g}",
                    f"{self.difference[k]:.3g}",
                    f"{low:.3g} .. {high:.3g}",
                    f"{self.holm[k]:.2g}",
                    "*" if self.names[k] in self.differs else "",
                    f"{self.detectable[k]:.2g}",
                    self.units[k],
                ]
            )
        return "\n".join([*aligned(rows), "", *self.sentences])

    def _sentence(self, k: int) -> str:
        values = f"from {self.first[k]:.4g} to {self.second[k]:.4g} {self.units[k]} (p = {self.holm[k]:.1e})"
        if self.names[k] not in self.flipped:
            size = abs(self.first[k])
            share = f", {100 * self.difference[k] / size:+.0f} %" if size > 0 else ""
            return f"{self.names[k]} changes {values}{share}."
        p = two_sided(self.first[[k]] + self.second[[k]], self.se[[k]], self.dof[[k]])[0]
        size_too = p * len(self.names) < 1 - self.confidence
        magnitude = "its magnitude differs too" if size_too else "its magnitude does not differ significantly"
        return f"{self.names[k]} changes its sign, {values}; {magnitude}."


@displayed
@dataclass(frozen=True, eq=False)
class Series(FamilyWise):
    """Two or more independent estimates of the same parameters.

    Each parameter has Welch's test of equal means (1951, eq. 20), with each estimate's own standard error and degrees
    of freedom; for two estimates it is the test of `Comparison`. Holm's correction controls the probability of any
    false difference over all parameters. Of a constrained estimate the unconstrained fit is taken.

    Attributes:
        labels: of the estimates, (n,).
        names, units: of the parameters, (k,).
        value: (n, k).
        se: cluster-robust standard errors, infinite where they cannot be estimated, (n, k).
        dof: degrees of freedom of each, (n, k).
        covariance: of each estimate, (n, k, k).
        confidence: family-wise confidence level at which a parameter counts as different.
        notes: sentences for the user.
        joint: tests of groups of directions; None where the estimates have no common base parameters.
    """

    labels: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    se: Array
    dof: Array
    covariance: Array
    confidence: float
    notes: tuple[str, ...]
    joint: JointTests | None = None

    def __post_init__(self) -> None:
        n, k = len(self.labels), len(self.names)
        freeze_fields(self, value=(n, k), se=(n, k), dof=(n, k), covariance=(n, k, k))

    def __len__(self) -> int:
        return len(self.labels)

    @cached_property
    def common(self) -> Array:
        """Inverse-variance weighted mean of each parameter, (k,); NaN where every standard error is infinite."""
        se = np.column_stack([se_above_rounding(*pair) for pair in zip(self.value.T, self.se.T, strict=True)])
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.where(se > 0, (se.min(axis=0) / se) ** 2, 1.0)  # all zero without error: any weight will do
            return freeze(np.asarray((weight * self.value).sum(axis=0) / weight.sum(axis=0)))

    @cached_property
    def p(self) -> Array:
        """p-value of the hypothesis of equal values, each parameter by itself, (k,)."""
        return freeze(self.misfits(np.ones((len(self), 1))))

    def misfits(self, columns: Array) -> Array:
        """p-values of the lack of fit to a linear model in the columns, (n, c), each parameter by itself, (k,)."""
        tests = zip(self.value.T, self.se.T, self.dof.T, strict=True)
        return np.array([johansen_p(*test, columns) for test in tests])

    @cached_property
    def detectable(self) -> Array:
        """Smallest change of one estimate that is found in 80 % of such comparisons, of the least precise one, (k,)."""
        k, lasts = int(len(self) > 1), []
        for i in range(len(self)):
            with np.errstate(divide="ignore"):
                others = 1 / np.sqrt(np.sum(1 / np.delete(self.se, i, axis=0) ** 2, axis=0))
            lasts.append(detectable(np.hypot(self.se[i], k * others), self.dof.min(axis=0), self.confidence))
        return freeze(np.max(lasts, axis=0))

    @property
    def level(self) -> Array:
        """Largest family-wise confidence level at which each parameter counts as different, (k,)."""
        return 1.0 - self.holm

    def pair(self, first: str, second: str) -> Comparison:
        """Two of the estimates by their labels, as `compare` has them."""
        a, b = self.labels.index(first), self.labels.index(second)
        return Comparison(
            names=self.names,
            units=self.units,
            first=self.value[a],
            second=self.value[b],
            first_se=self.se[a],
            second_se=self.se[b],
            first_dof=self.dof[a],
            second_dof=self.dof[b],
            covariance=self.covariance[a] + self.covariance[b],
            confidence=self.confidence,
            notes=self.notes,
            joint=self.joint if len(self) == 2 else None,
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """What differs, in order of significance; then the notes."""
        order = self._ranked
        confidence = family_wise(self.confidence, len(self.names))
        sentences = [self._sentence(k) for k in order] or [f"No parameter differs {confidence}."]
        rest = len(self.names) - len(order)
        joint = self.joint.sentences if self.joint else ()
        last = [f"The other {rest} do not differ {confidence}."] if order and rest else []
        return (*sentences, *last, *joint, *self.notes)

    def _sentence(self, k: int) -> str:
        low, high = int(np.argmin(self.value[:, k])), int(np.argmax(self.value[:, k]))
        ends = [f"{self.value[i, k]:.4g} in {self.labels[i]}" for i in (low, high)]
        return f"{self.names[k]} differs: from {ends[0]} to {ends[1]}, {self.units[k]} (p = {self.holm[k]:.1e})."

    def summary(self) -> str:
        """A text table, then the sentences. `differs up to` is a confidence level; an asterisk marks what differs."""
        columns = (cell for label in self.labels for cell in (label, "std err"))
        rows = [["", *columns, "differs up to", "", "detectable", "unit"]]
        for k, name in enumerate(self.names):
            values = zip(self.value[:, k], self.se[:, k], strict=True)
            cells = [cell for value, se in values for cell in (f"{value:.4g}", f"{se:.2g}")]
            mark = "*" if name in self.differs else ""
            rows.append([name, *cells, confidence_text(self.holm[k]), mark, f"{self.detectable[k]:.2g}", self.units[k]])
        return "\n".join([*aligned(rows), "", *self.sentences])


def detectable(se: Array, dof: Array, confidence: float) -> Array:
    """Smallest change of each parameter that a test at a family-wise level finds with a power of 80 %, (k,).

    The first step of Holm's correction, that of Bonferroni, counts: (t(1 - alpha / 2k) + t(0.8)) se.
    """
    level = (1 - confidence) / max(len(se), 1)
    return np.asarray((t_quantile(1 - level / 2, dof) + t_quantile(DETECTION_POWER, dof)) * se)


def significant(names: Sequence[str], p: Array, confidence: float) -> tuple[str, ...]:
    """Names whose p-value is below 1 - confidence."""
    return tuple(name for name, probability in zip(names, p, strict=True) if probability < 1 - confidence)


def family_wise(confidence: float, count: int) -> str:
    """A confidence level over all parameters, as sentences have it."""
    return f"at {100 * confidence:g} % confidence for all {count} together"


def confidence_text(p: float) -> str:
    """A p-value as a confidence level, rounded down: 99.89 % does not reach 99.9 %."""
    return f"{np.floor(1e3 * (1 - p)) / 10:.1f} %"
