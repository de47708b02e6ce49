"""Least squares among the parameters that real bodies and passive terms can have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.estimation.feasibility.cone import never_negative
from haptid.estimation.feasibility.feasible import FeasibleParameters, hold, possible
from haptid.estimation.least_squares import Solution
from haptid.estimation.method import Around, Method, expect_weighting
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import MotorRows, Observation


@dataclass(frozen=True)
class PhysicallyConsistent(Around):
    """Weighted least squares, held to parameters that some distribution of mass and passive friction could have.

    beta = A chi, with the pseudo-inertia of every link positive semidefinite, rotor inertia and friction not negative;
    springs, offsets and a user's own columns free (see `FeasibleParameters`). A semidefinite programme on the triangle, of a
    size that does not grow with the log. Weights are made from the free fit. Where the free fit is possible, it is
    the estimate, to the last digit.

    Torque tells beta, not chi: of all chi behind the estimate it carries the one of least log-det divergence from the
    prior, or from a homogeneous ball for every link without one, which is well inside where there is room. Links that
    hold the estimate are on the border; there chi is the nearest to the same centre, by a pull so weak, 1e-10 of the
    torque's weight and taken back in a second pass, that beta does not feel it.

    Intervals are the free fit's (by default), cut where a parameter cannot be negative, and widened to take in the
    estimate. The free interval holds the truth 95 times in 100 and the truth is never cut off, so this one does too;
    resampling the held fit itself would not be valid on the border (Andrews 2000, Econometrica 68(2)). The covariance
    is the free fit's. Where the whole free interval is impossible, the interval is as wide as its half, from zero.

    Sources: Sousa and Cortesao (2014), IJRR 33(6); Wensing, Kim and Slotine (2018), IEEE RA-L 3(1).

    Attributes:
        weighting: how the motors' rows are weighted.
    """

    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("Consistent", self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, physically consistent"

    def hold(self, observation: Observation, free: Solution) -> Constrained:
        """The free fit if it is possible, else the nearest that is, where the weighted torque tells how near.

        Raises:
            NoBodyError: the symmetries declared for the device leave no body.
            UnsolvedError: the solver stopped before it had an answer.
        """
        found = possible(observation.model, free.beta)
        if found.ok:
            return Constrained(found, free.beta, (), costs(observation.motors, free.beta, free.beta))
        nearest, blocks = hold(observation.model, free.beta, free.R)
        active = tuple(dict.fromkeys(reason(block.label, block.is_link) for block in blocks))
        return Constrained(nearest, free.beta, active, costs(observation.motors, free.beta, nearest.beta))


def reason(label: str, is_link: bool) -> str:
    """Why a condition holds the estimate."""
    if is_link:
        return f"{label}: its inertia lies on the border of what a body can have"
    return f"{label} would be negative: held at 0"


@dataclass(frozen=True)
class Cost:
    """What holding costs one motor.

    Attributes:
        label: "motor 1".
        free, held: 100 norm(y - y_hat) / norm(y) of the free fit and of the estimate, per cent.
    """

    label: str
    free: float
    held: float


def costs(motors: Sequence[MotorRows], free: Array, held: Array) -> tuple[Cost, ...]:
    """Relative residuals by motor of two sets of base parameters, each (p,)."""

    def relative(motor: MotorRows, beta: Array) -> float:
        return 100 * motor.residual(beta) / motor.norm if motor.norm > 0 else 0.0

    return tuple(Cost(motor.label, relative(motor, free), relative(motor, held)) for motor in motors)


@dataclass(frozen=True, eq=False)
class Constrained:
    """An estimate held to what is possible, beside the free one.

    Attributes:
        possible: the base parameters, and bodies that have them.
        free: base parameters of the free fit, (p,), SI.
        active: a sentence for every link and term that holds the estimate.
        costs: relative residual of the free and of the held fit, by motor.
        pulled: whether it was pulled towards prior bodies too, so that it is not the best fit of what is possible.
    """

    possible: FeasibleParameters
    free: Array
    active: tuple[str, ...]
    costs: tuple[Cost, ...]
    pulled: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "free", read_only(self.free))

    @property
    def beta(self) -> Array:
        """The held base parameters, (p,), SI."""
        return self.possible.beta

    def interval(self, half: Array) -> Array:
        """The free interval cut where a parameter cannot be negative, and widened to the estimate, (p, 2).

        Args:
            half: half-widths of the free interval, (p,).
        """
        low, high = self.free - half, self.free + half
        bounded = never_negative(self.possible.model)
        high = np.where(bounded & (high < 0), half, high)
        low = np.where(bounded, np.maximum(low, 0.0), low)
        beta = self.possible.beta
        return np.column_stack([np.minimum(low, beta), np.maximum(high, beta)])

    def constrained_outside_ci(self, half: Array) -> tuple[str, ...]:
        """Names of the parameters held outside of their free interval, whose half-widths are given, (p,)."""
        moved = np.abs(self.possible.beta - self.free) > half
        return tuple(name for name, far in zip(self.possible.model.base.names, moved, strict=True) if far)

    def notes(self, half: Array) -> tuple[str, ...]:
        """Sentences a user should read: what holds the estimate, what that costs, whether it is too much."""
        if not self.active:
            return ()
        figures = "; ".join(f"{cost.label} {cost.free:.3g} % to {cost.held:.3g} %" for cost in self.costs)
        made = [f"{sentence}." for sentence in self.active]
        made.append(f"Relative error of the free fit, and held to what is possible: {figures}.")
        constrained_outside_ci = self.constrained_outside_ci(half)
        if constrained_outside_ci:
            made.append(
                f"{', '.join(constrained_outside_ci)}: held outside of the interval of the free fit. Noise alone does not explain "
                f"this: look for a lag of the velocity, or for friction that the device file does not have. Holding "
                f"the estimate does not repair it."
            )
        return tuple(made)
