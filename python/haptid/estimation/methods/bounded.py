"""Least squares with base parameters held between limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.errors import MethodSettingError
from haptid.estimation.feasibility.conic_program import Condition, minimise
from haptid.estimation.least_squares import Solution
from haptid.estimation.method import Around, Method, expect_weighting
from haptid.estimation.methods.wls import WLS
from haptid.estimation.methods.zeroed import indices
from haptid.observation.observation import Observation

# A parameter this near a limit, as a share of its deviation in the fit, is held by it.
TOUCHING = 1e-6


@dataclass(frozen=True)
class Bounds(Around):
    """Another method, with some base parameters held between limits.

    A quadratic programme on the triangle. Intervals are the free fit's, cut at the limits and widened to the estimate:
    the free interval holds the truth 95 times in 100, and limits that are true never cut it off.

    Source: Lawson and Hanson (1974), Solving Least Squares Problems, chapter 23.

    Attributes:
        limits: least and largest value of some base parameters by name, SI; None where there is no such limit.
        weighting: how rows are weighted.
    """

    limits: Mapping[str, tuple[float | None, float | None]]
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("Bounded", self.weighting)
        object.__setattr__(self, "limits", dict(self.limits))
        for name, (low, high) in self.limits.items():
            if low is not None and high is not None and not low < high:
                raise MethodSettingError("Bounded", f"limits of {name}", (low, high), "a lower one below the upper one")

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, bounded"

    def hold(self, observation: Observation, free: Solution) -> BoundedSolution:
        """The free fit if it is within the limits, else the nearest that is, where the weighted torque tells how near.

        Raises:
            BaseNameError: the device has no base parameter of that name.
            UnsolvedError: the solver stopped before it had an answer.
        """
        names = observation.base.names
        indices(names, tuple(self.limits))
        low, high = (np.array([end(self.limits, name, side) for name in names]) for side in (0, 1))
        if ((low <= free.beta) & (free.beta <= high)).all():
            return BoundedSolution(names, free.beta, free.beta, low, high)
        return BoundedSolution(names, nearest_within(free, low, high), free.beta, low, high)


def end(limits: Mapping[str, tuple[float | None, float | None]], name: str, side: int) -> float:
    """One limit of a parameter; infinite where there is none."""
    value = limits[name][side] if name in limits else None
    return (-np.inf, np.inf)[side] if value is None else float(value)


def nearest_within(free: Solution, low: Array, high: Array) -> Array:
    """The b that minimises |R (b - beta)| between limits, (p,)."""
    # In units of each parameter's deviation, from the free fit: numbers near one.
    size = np.linalg.norm(free.root, axis=1)
    scaled = free.R * size
    x, _ = minimise(scaled.T @ scaled, np.zeros(len(size)), conditions(free.beta, size, low, high))
    made = np.clip(free.beta + size * x, low, high)
    made = np.where(np.abs(made - low) < TOUCHING * size, low, made)
    return np.asarray(np.where(np.abs(made - high) < TOUCHING * size, high, made))


def conditions(beta: Array, size: Array, low: Array, high: Array) -> list[Condition]:
    """low <= beta + size x <= high, row by row in units of size."""
    unit = np.eye(len(beta))
    lower, upper = np.isfinite(low), np.isfinite(high)
    ends = [((beta - low) / size)[lower], ((high - beta) / size)[upper]]
    return [Condition(F, f) for F, f in zip((unit[lower], -unit[upper]), ends, strict=True) if len(f)]


@dataclass(frozen=True, eq=False)
class BoundedSolution:
    """An estimate held between limits, beside the free one.

    Attributes:
        names: of the base parameters, (p,).
        beta, free: the estimate and the free fit, (p,), SI.
        low, high: limits, infinite where there is none, (p,).
    """

    names: tuple[str, ...]
    beta: Array
    free: Array
    low: Array
    high: Array

    def __post_init__(self) -> None:
        for name in ("beta", "free", "low", "high"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def active(self) -> tuple[str, ...]:
        """A sentence for every limit that holds the estimate."""
        moved = self.beta != self.free
        at = moved & ((self.beta == self.low) | (self.beta == self.high))
        return tuple(f"{self.names[k]} is held at its limit {self.beta[k]:.6g}" for k in np.flatnonzero(at))

    def interval(self, half: Array) -> Array:
        """The free interval cut at the limits, and widened to the estimate, (p, 2).

        Args:
            half: half-widths of the free interval, (p,).
        """
        ends = np.clip(np.column_stack([self.free - half, self.free + half]), self.low[:, None], self.high[:, None])
        return np.column_stack([np.minimum(ends[:, 0], self.beta), np.maximum(ends[:, 1], self.beta)])

    def constrained_outside_ci(self, half: Array) -> tuple[str, ...]:
        """Names of the parameters held outside of their free interval, whose half-widths are given, (p,)."""
        far = np.abs(self.beta - self.free) > half
        return tuple(name for name, out in zip(self.names, far, strict=True) if out)

    def notes(self, half: Array) -> tuple[str, ...]:
        """Sentences a user should read: what holds the estimate, and whether it is too much."""
        made = [f"{sentence}." for sentence in self.active]
        if constrained_outside_ci := self.constrained_outside_ci(half):
            made.append(
                f"{', '.join(constrained_outside_ci)}: held outside of the interval of the free fit. Noise alone does not explain "
                f"this: look at the limits, and for a term that the device file does not have."
            )
        return tuple(made)
