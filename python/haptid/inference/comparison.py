"""Two estimates of the same parameters: which of them differ, beyond what their intervals allow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array, freeze, read_only
from haptid.errors import ConfidenceError, DifferentParametersError
from haptid.inference.comparable import Compared, Side
from haptid.inference.targets import aligned
from haptid.uncertainty.multiple_testing import together, two_sided


@dataclass(frozen=True, eq=False)
class Comparison:
    """The second of two independent estimates against the first, parameter by parameter.

    Each difference is put to Welch's test: its variance is the sum of both, its degrees of freedom are those of Welch
    (1947), Biometrika 34, eq. (28), with each estimate's own degrees of freedom. Over all parameters together the
    probability of finding one that is not there is held by Holm (1979), Scandinavian J. Statistics 6. Of an estimate
    held to what bodies can have, the free fit is compared: its deviations are known.

    Attributes:
        names, units: of the parameters compared, (k,).
        first, second: values, (k,).
        first_sd, second_sd: their honest deviations, infinite where one stretch of a log alone tells, (k,).
        first_freedom, second_freedom: degrees of freedom of each, (k,).
        covariance: of second - first, the sum of both, (k, k).
        confidence: at which a parameter counts as different, for all of them together.
        notes: sentences a user should read.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: Array
    second: Array
    first_sd: Array
    second_sd: Array
    first_freedom: Array
    second_freedom: Array
    covariance: Array
    confidence: float
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("first", "second", "first_sd", "second_sd", "first_freedom", "second_freedom", "covariance"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def difference(self) -> Array:
        """Second less first, (k,)."""
        return self.second - self.first

    @cached_property
    def se(self) -> Array:
        """Deviation of the difference, (k,)."""
        return freeze(np.hypot(self.first_sd, self.second_sd))

    @cached_property
    def dof(self) -> Array:
        """Degrees of freedom of the difference, (k,) (Welch 1947, eq. 28); the lesser where a deviation is infinite."""
        a, b = self.first_sd**2, self.second_sd**2
        least = np.minimum(self.first_freedom, self.second_freedom)
        with np.errstate(invalid="ignore"):
            made = (a + b) ** 2 / (a**2 / self.first_freedom + b**2 / self.second_freedom)
        return freeze(np.where(np.isfinite(made), made, least))

    @cached_property
    def interval(self) -> Array:
        """Interval of each difference by itself at the confidence, (k, 2)."""
        half = stats.t.ppf((1 + self.confidence) / 2, self.dof) * self.se
        return freeze(np.column_stack([self.difference - half, self.difference + half]))

    @cached_property
    def p(self) -> Array:
        """Probability of so great a difference between equal parameters, each taken by itself, (k,)."""
        return freeze(two_sided(self.difference, self.se, self.dof))

    @cached_property
    def holm(self) -> Array:
        """The same, taken together with all others (Holm 1979), (k,)."""
        return together(self.p)

    @cached_property
    def differs(self) -> tuple[str, ...]:
        """Names of the parameters that differ at the confidence."""
        return tuple(name for name, p in zip(self.names, self.holm, strict=True) if p < 1 - self.confidence)

    @cached_property
    def flipped(self) -> tuple[str, ...]:
        """Those that differ and have changed sign, both values being told from zero at the confidence."""
        sides = ((self.first, self.first_sd, self.first_freedom), (self.second, self.second_sd, self.second_freedom))
        sure = np.all([two_sided(*side) < 1 - self.confidence for side in sides], axis=0)
        turned = sure & (np.sign(self.first) != np.sign(self.second))
        return tuple(name for name, flip in zip(self.names, turned, strict=True) if flip and name in self.differs)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What differs in plain words, the surest first; then the notes."""
        order = sorted((self.names.index(name) for name in self.differs), key=lambda k: self.p[k])
        rest = len(self.names) - len(order)
        together = f"at {100 * self.confidence:g} % confidence for all {len(self.names)} together"
        last = f"The other {rest} do not differ {together}." if rest else f"All differ {together}."
        return (
            *(self._sentence(k) for k in order),
            last if order else f"No parameter differs {together}.",
            *self.notes,
        )

    def summary(self) -> str:
        """A table as text, then the sentences. The probability is Holm's; an asterisk marks what differs."""
        head = (
            "",
            "first",
            "sd",
            "second",
            "sd",
            "difference",
            f"{100 * self.confidence:g} % interval",
            "p",
            "",
            "unit",
        )
        rows = [
            (
                name,
                f"{self.first[k]:.4g}",
                f"{self.first_sd[k]:.2g}",
                f"{self.second[k]:.4g}",
                f"{self.second_sd[k]:.2g}",
                f"{self.difference[k]:.3g}",
                f"{self.interval[k, 0]:.3g} .. {self.interval[k, 1]:.3g}",
                f"{self.holm[k]:.2g}",
                "*" if name in self.differs else "",
                self.units[k],
            )
            for k, name in enumerate(self.names)
        ]
        return "\n".join([*aligned([head, *rows]), "", *self.sentences])

    def _sentence(self, k: int) -> str:
        """One difference in plain words."""
        values = f"from {self.first[k]:.4g} to {self.second[k]:.4g} {self.units[k]} (p = {self.holm[k]:.1e})"
        if self.names[k] not in self.flipped:
            size = abs(self.first[k])
            share = f", {100 * self.difference[k] / size:+.0f} % of its size" if size > 0 else ""
            return f"{self.names[k]} goes {values}{share}."
        size = two_sided(self.first[[k]] + self.second[[k]], self.se[[k]], self.dof[[k]])[0]
        kept = "its size differs too" if size * len(self.names) < 1 - self.confidence else "its size may be the same"
        return f"{self.names[k]} changes its sign, {values}; {kept}."


def compare(first: Compared, second: Compared, confidence: float = 0.95) -> Comparison:
    """Which parameters of two estimates differ: two mountings of a device, two tools, two days.

    Parameters are the same where name and unit agree; base parameters also need the same regrouping. What only one
    estimate has is left out, and a note names it.

    Args:
        first, second: base parameters, targets or folders of results, from logs or stretches without common rows; the
            devices may differ.
        confidence: for all parameters together, between 0 and 1.

    Raises:
        ConfidenceError: it is not between 0 and 1.
        DependentEstimatesError: both were made from the same rows.
        DifferentParametersError: they have no parameter in common.
    """
    if not 0 < confidence < 1:
        raise ConfidenceError(confidence)
    a, b = Side.of(first), Side.of(second)
    a.expect_apart(b)
    pairs = [(k, b.names.index(name)) for k, name in enumerate(a.names) if a.same(name, b)]
    if not pairs:
        raise DifferentParametersError(list(a.names), list(b.names))
    at_a, at_b = (list(side) for side in zip(*pairs, strict=True))
    names = tuple(a.names[k] for k in at_a)
    return Comparison(
        names=names,
        units=tuple(a.units[k] for k in at_a),
        first=a.value[at_a],
        second=b.value[at_b],
        first_sd=a.se[at_a],
        second_sd=b.se[at_b],
        first_freedom=a.dof[at_a],
        second_freedom=b.dof[at_b],
        covariance=a.covariance[np.ix_(at_a, at_a)] + b.covariance[np.ix_(at_b, at_b)],
        confidence=confidence,
        notes=_notes(a, b, names),
    )


def _notes(a: Side, b: Side, names: tuple[str, ...]) -> tuple[str, ...]:
    """What could not be compared, and what cannot be told apart for want of motion."""
    alone = dict.fromkeys(name for side in (a, b) for name in side.names if name not in names)
    notes = [f"Not compared, not in both with one unit and meaning: {', '.join(alone)}."] if alone else []
    for side, which in ((a, "first"), (b, "second")):
        if side.held:
            notes.append(f"The {which} estimate is held to what bodies can have: its free fit is compared.")
        single_block = [name for name in names if np.isinf(side.se[side.names.index(name)])]
        if single_block:
            notes.append(
                f"One stretch of the {which} log alone tells {', '.join(single_block)}: no difference can be found."
            )
    return tuple(notes)
