"""Several estimates of the same parameters: which of these differ, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.errors import ConfidenceError, DifferentParametersError, FewEstimatesError, LabelCountError
from haptid.inference.comparable import Compared, Side
from haptid.inference.comparison import Comparison
from haptid.inference.targets import aligned
from haptid.uncertainty.multiple_testing import deviations_to_weigh, misfit, together


@dataclass(frozen=True, eq=False)
class Series:
    """Independent estimates side by side, parameter by parameter.

    Each parameter is put to Welch's test of equal means, with each estimate's own deviation and degrees of freedom;
    of two estimates it is the test of `compare`. Over all parameters together the probability of finding a difference
    that is not there is held by Holm's steps. Of an estimate held to what bodies can have, the free fit is taken.

    Sources: Welch (1951), Biometrika 38, eq. (20); Holm (1979), Scandinavian Journal of Statistics 6.

    Attributes:
        labels: of the estimates, (n,).
        names, units: of the parameters, (k,).
        value: (n, k).
        se: honest deviations, infinite where one stretch of a log alone tells, (n, k).
        dof: degrees of freedom of each, (n, k).
        covariance: of each estimate, (n, k, k).
        confidence: at which a parameter counts as different, for all of them together.
        notes: sentences a user should read.
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

    def __post_init__(self) -> None:
        n, k = len(self.labels), len(self.names)
        shapes = {"value": (n, k), "sd": (n, k), "freedom": (n, k), "covariance": (n, k, k)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, shape)

    def __len__(self) -> int:
        return len(self.labels)

    @cached_property
    def common(self) -> Array:
        """Weighted mean of each parameter, (k,); NaN of one that no estimate tells."""
        se = np.column_stack([deviations_to_weigh(*pair) for pair in zip(self.value.T, self.se.T, strict=True)])
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.where(se > 0, (se.min(axis=0) / se) ** 2, 1.0)  # all zero without deviation: any weight will do
            return freeze(np.asarray((weight * self.value).sum(axis=0) / weight.sum(axis=0)))

    @cached_property
    def p(self) -> Array:
        """Probability of so different values of equal parameters, each taken by itself, (k,)."""
        return freeze(self.misfits(np.ones((len(self), 1))))

    def misfits(self, columns: Array) -> Array:
        """Probability of values so far from their weighted fits to columns, (n, c), each by itself, (k,)."""
        each = zip(self.value.T, self.se.T, self.dof.T, strict=True)
        return np.array([misfit(*one, columns) for one in each])

    @cached_property
    def holm(self) -> Array:
        """The same, taken together with all others, (k,)."""
        return together(self.p)

    @property
    def level(self) -> Array:
        """Confidence up to which each parameter counts as different, for all of them together, (k,)."""
        return 1.0 - self.holm

    @property
    def differs(self) -> tuple[str, ...]:
        """Names of the parameters that differ at the confidence."""
        return tuple(name for name, p in zip(self.names, self.holm, strict=True) if p < 1 - self.confidence)

    def pair(self, first: str, second: str) -> Comparison:
        """Two of the estimates by their labels, as `compare` has them."""
        a, b = self.labels.index(first), self.labels.index(second)
        return Comparison(
            names=self.names,
            units=self.units,
            first=self.value[a],
            second=self.value[b],
            first_sd=self.se[a],
            second_sd=self.se[b],
            first_freedom=self.dof[a],
            second_freedom=self.dof[b],
            covariance=self.covariance[a] + self.covariance[b],
            confidence=self.confidence,
            notes=self.notes,
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """What differs in plain words, the surest first; then the notes."""
        order = sorted((self.names.index(name) for name in self.differs), key=lambda k: self.p[k])
        at = f"at {100 * self.confidence:g} % confidence for all {len(self.names)} together"
        said = [self._sentence(k) for k in order] or [f"No parameter differs {at}."]
        rest = len(self.names) - len(order)
        return (*said, *([f"The other {rest} do not differ {at}."] if order and rest else []), *self.notes)

    def _sentence(self, k: int) -> str:
        low, high = int(np.argmin(self.value[:, k])), int(np.argmax(self.value[:, k]))
        ends = [f"{self.value[i, k]:.4g} in {self.labels[i]}" for i in (low, high)]
        return f"{self.names[k]} differs: from {ends[0]} to {ends[1]}, {self.units[k]} (p = {self.holm[k]:.1e})."

    def summary(self) -> str:
        """A table as text, then the sentences. `differs up to` is a confidence; an asterisk marks what differs."""
        head = ("", *(cell for label in self.labels for cell in (label, "sd")), "differs up to", "", "unit")
        rows = []
        for k, name in enumerate(self.names):
            values = zip(self.value[:, k], self.se[:, k], strict=True)
            cells = [cell for value, se in values for cell in (f"{value:.4g}", f"{se:.2g}")]
            mark = "*" if name in self.differs else ""
            rows.append((name, *cells, confidence_text(self.holm[k]), mark, self.units[k]))
        return "\n".join([*aligned([head, *rows]), "", *self.sentences])


def confidence_text(p: float) -> str:
    """A probability as the confidence that it leaves, cut and not rounded: 99.9 % is not reached by 99.89 %."""
    return f"{np.floor(1e3 * (1 - p)) / 10:.1f} %"


def compare_all(estimates: Sequence[Compared], labels: Sequence[str] | None = None, confidence: float = 0.95) -> Series:
    """Which parameters of several estimates differ: devices of a series, mountings, days.

    Parameters are the same where name and unit agree; base parameters also need the same regrouping. What not every
    estimate has is left out, and a note names it.

    Args:
        estimates: two or more of base parameters, of targets or of folders of results, no two with common rows; the
            devices may differ.
        labels: one for each; "1", "2", ... where None.
        confidence: for all parameters together, between 0 and 1.

    Raises:
        ConfidenceError: it is not between 0 and 1.
        FewEstimatesError: fewer than two estimates.
        LabelCountError: not one label for each.
        DependentEstimatesError: two were made from the same rows.
        DifferentParametersError: they have no parameter in common.
    """
    if not 0 < confidence < 1:
        raise ConfidenceError(confidence)
    if len(estimates) < 2:
        raise FewEstimatesError(len(estimates), 2)
    called = tuple(str(k + 1) for k in range(len(estimates))) if labels is None else tuple(labels)
    if len(called) != len(estimates) or len(set(called)) != len(called):
        raise LabelCountError(called, len(estimates))
    sides = [Side.of(made) for made in estimates]
    for k, side in enumerate(sides):
        for other in sides[:k]:
            other.expect_apart(side)
    names = _shared(sides)
    at = [side.pick(names) for side in sides]
    chosen = list(zip(sides, at, strict=True))
    return Series(
        labels=called,
        names=names,
        units=tuple(sides[0].units[k] for k in at[0]),
        value=np.array([side.value[k] for side, k in chosen]),
        se=np.array([side.se[k] for side, k in chosen]),
        dof=np.array([side.dof[k] for side, k in chosen]),
        covariance=np.array([side.covariance[np.ix_(k, k)] for side, k in chosen]),
        confidence=confidence,
        notes=_notes(sides, called, names),
    )


def _shared(sides: Sequence[Side]) -> tuple[str, ...]:
    """Names of the parameters that all have with one meaning."""
    first, *others = sides
    names = tuple(name for name in first.names if all(first.same(name, other) for other in others))
    if not names:
        fewest = min(others, key=lambda other: sum(first.same(name, other) for name in first.names))
        raise DifferentParametersError(list(first.names), list(fewest.names))
    return names


def _notes(sides: Sequence[Side], labels: Sequence[str], names: tuple[str, ...]) -> tuple[str, ...]:
    """What could not be compared, and what cannot be told apart for want of motion."""
    alone = dict.fromkeys(name for side in sides for name in side.names if name not in names)
    notes = [f"Not compared, not in all with one unit and meaning: {', '.join(alone)}."] if alone else []
    for side, label in zip(sides, labels, strict=True):
        if side.held:
            notes.append(f"{label} is held to what bodies can have: its free fit is compared.")
        single_block = [name for name in names if np.isinf(side.se[side.names.index(name)])]
        if single_block:
            notes.append(
                f"One stretch of a log alone tells {', '.join(single_block)} of {label}: it counts for nothing there."
            )
    return tuple(notes)
