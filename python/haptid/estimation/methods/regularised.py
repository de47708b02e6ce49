"""Regularised least squares: ridge regression (`Ridge`) and entropic divergence from prior bodies (`Entropic`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array, positive
from haptid.device import INERTIAL
from haptid.dynamics.model import DynamicModel
from haptid.errors import IncompleteDeviceError
from haptid.estimation.feasibility.cone import Cone, ConeBlock
from haptid.estimation.feasibility.conic_program import unsolved
from haptid.estimation.feasibility.feasible import FeasibleParameters, roomy
from haptid.estimation.least_squares import Knowledge, Solution, solve
from haptid.estimation.method import (
    Fit,
    Method,
    Wrapper,
    expect_positive,
    expect_weighting,
    expect_whole,
    setting_error,
)
from haptid.estimation.methods.constrained import Constrained, costs
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation

# Ridge strengths to choose from where none is given: the prior's weight times 10^-4 to 10^4.
RIDGE_STRENGTHS = tuple(10.0 ** (k / 2) for k in range(-8, 9))
# Entropic strengths to choose from where none is given, and the number of folds of the cross-validation.
ENTROPIC_STRENGTHS = tuple(10.0**k for k in range(-3, 7))
FOLDS = 5
# Least entropic strength that double precision distinguishes from none.
WEAKEST = 1e-6
# Strength of the barrier on links without a prior: moves nothing by a thousandth of its standard error.
BARRIER = 1e-3
# Newton's method: largest number of steps, decrement at convergence, and the share of the predicted decrease required.
_MOST_STEPS, _CENTRED, ARMIJO = 300, 1e-8, 0.1


@dataclass(frozen=True)
class Ridge:
    """Weighted least squares with a Gaussian prior: ridge regression towards the prior values of the device file.

    Every base parameter with a prior adds one row: its value, in units of its prior standard deviation, times the
    square root of `strength`. With strength 1 it is the Bayesian estimate for white residuals. Where no strength is
    given, it is chosen by leave-one-block-out cross-validation. Parameters without a prior, or with a prior of zero
    without a standard deviation, are not regularised.

    Intervals take the prior's value as drawn with its standard deviation: where the prior error is larger, they do not
    have the nominal coverage.

    Sources: Hoerl and Kennard (1970), Technometrics 12(1); Stone (1974), JRSS B 36, for the choice of the strength.

    Attributes:
        share: standard deviation of a prior value without one in the device file, relative to the value.
        strength: of the regularisation; None for cross-validation.
        passes: how often the weights are computed from the residuals of the last fit.
    """

    name: ClassVar[str] = "ridge towards the prior"
    share: float = 0.3
    strength: float | None = None
    passes: int = 2

    def __post_init__(self) -> None:
        expect_positive("Ridge", "share", self.share)
        if self.strength is not None:
            expect_positive("Ridge", "strength", self.strength, ", or None")
        expect_whole("Ridge", "passes", self.passes, 1)

    unit_residual: ClassVar[bool] = True

    def weights(self, observation: Observation) -> Array:
        """One over the standard deviation of each motor's residual in the fit with the prior, (motors,).

        Raises:
            IncompleteDeviceError: the device has no prior values.
            IdentifiabilityError: a motor's torque is zero throughout.
        """
        return self._weighted(observation, self._prior(observation))

    def knowledge(self, observation: Observation) -> Knowledge:
        """The prior, with standard deviations scaled by the strength.

        Raises:
            IncompleteDeviceError: the device has no prior values.
        """
        prior = self._prior(observation)
        if self.strength is not None:
            return strengthened(prior, self.strength)
        weights = self._weighted(observation, prior)
        tried = [strengthened(prior, strength) for strength in RIDGE_STRENGTHS]
        errors = [prediction_error(observation, weights, known) for known in tried]
        return tried[int(np.argmin(errors))]

    def _weighted(self, observation: Observation, prior: Knowledge) -> Array:
        weighting, known = WLS(self.passes), strengthened(prior, self.strength or 1.0)
        weights = np.array([1.0 / max(motor.norm, np.finfo(float).tiny) for motor in observation.motors])
        for _ in range(self.passes):
            beta = solve(observation, weights, (), known).beta
            weights = np.array([weighting.weight(motor, beta) for motor in observation.motors])
        return weights

    def _prior(self, observation: Observation) -> Knowledge:
        model = observation.model
        known = [(k, p) for k, p in enumerate(model.base_prior) if p is not None and (p[1] or p[0])]
        if not known:
            raise _no_prior(model.device.name)
        values = np.array([value for _, (value, _) in known])
        std = np.array([std or self.share * abs(value) for _, (value, std) in known])
        return Knowledge(np.eye(len(model.base))[[k for k, _ in known]], values, std)


def _no_prior(device: str) -> IncompleteDeviceError:
    """The error for a device without the prior that a method needs."""
    return IncompleteDeviceError(
        f"no base parameter of {device!r} has a prior value other than zero to regularise towards.",
        where=device,
        advice="Give bodies or values in the device file, for all the parameters of a group, or use WLS().",
    )


def strengthened(prior: Knowledge, strength: float) -> Knowledge:
    """The prior with its weight multiplied."""
    return Knowledge(prior.A, prior.b, prior.std / np.sqrt(strength))


def prediction_error(observation: Observation, weights: Array, known: Knowledge) -> float:
    """Leave-one-block-out cross-validation: sum of squared weighted prediction errors."""
    solution = solve(observation, weights, (), known)
    moments, first, total = Fit(observation, weights, solution, True).moments, 0, 0.0
    shifts = moments.leave_out_shifts @ solution.root.T
    for motor, weight in zip(observation.motors, weights, strict=True):
        T = motor.triangles[motor.rows > 0] * weight
        beta = (solution.beta - shifts[first : first + len(T)])[:, motor.columns]
        errors = T[:, :, -1] - np.einsum("bij,bj->bi", T[:, :, :-1], beta)
        total, first = total + float((errors**2).sum()), first + len(T)
    return total


@dataclass(frozen=True)
class Entropic(Wrapper):
    """Weighted least squares regularised by the entropic (log-det) divergence from the prior bodies of the device file.

    Minimises half the sum of squares, in units of the residual's variance, plus `strength` times the sum over all
    links with a prior body of the Bregman divergence of -log det between pseudo-inertias P and P0,

        D(P || P0) = tr(P0^-1 P) - log det(P0^-1 P) - 4.

    It does not depend on frames and units, is zero only at the prior, and tends to infinity towards the boundary of
    physical consistency. As the strength tends to zero the estimate tends to that of `PhysicallyConsistent()`. Links
    without a prior body, and friction, are only constrained to be physically consistent.

    Where no strength is given, it is chosen by cross-validation over five folds of blocks. Intervals are those of the
    unconstrained fit, widened to the estimate; see `PhysicallyConsistent`.

    Source: Lee, Wensing and Park (2020), IEEE Transactions on Robotics 36(2), eqs 24 and 33.

    Attributes:
        strength: of the regularisation; None for cross-validation.
        weighting: how the motors' rows are weighted.
    """

    strength: float | None = None
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        if self.strength is not None and not (positive(self.strength) and self.strength >= WEAKEST):
            wanted = f"{WEAKEST:g} or more (`PhysicallyConsistent()` has no regularisation), or None"
            raise setting_error("Entropic", "strength", self.strength, wanted)
        expect_weighting("Entropic", self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, entropic regularisation towards prior bodies"

    def constrain(self, observation: Observation, free: Solution) -> Constrained:
        """The regularised estimate, with the unconstrained one.

        Raises:
            IncompleteDeviceError: no link of the device has a prior body.
            PhysicalConsistencyError: the symmetries declared for the device leave no feasible body.
            ConvergenceError: Newton's method did not converge.
        """
        model = observation.model
        known = [f"link {name}" for name in prior_links(model)]
        if not known:
            raise _no_prior(model.device.name)
        cone = roomy(model, free.beta)
        scale = 1.0 if self.unit_residual else free.rest / np.sqrt(free.dof)
        penalty = EntropicPenalty(cone, tuple(block.label in known for block in cone.blocks))
        strength = self.strength or best_strength(observation, self.weights(observation) / scale, penalty)
        x = penalty.minimiser(free.R / scale, free.beta, strength)
        beta = cone.A @ x
        bodies = FeasibleParameters(model, beta, cone.scale * x, min(1.0, cone.margin(x)), ())
        return Constrained(bodies, free.beta, (), costs(observation.motors, free.beta, beta), pulled=True)


def prior_links(model: DynamicModel) -> list[str]:
    """Names of the links with a prior value for all ten parameters."""
    return [name for name in model.device.joint_names if all(kind + name in model.device.prior for kind in INERTIAL)]


@dataclass(frozen=True, eq=False)
class EntropicPenalty:
    """The divergence of scaled standard parameters from the prior.

    Attributes:
        cone: the conditions; its centre is the prior where there is one.
        known: which of its blocks have a prior body, (blocks,).
    """

    cone: Cone
    known: tuple[bool, ...]

    def minimiser(self, R: Array, beta: Array, strength: float) -> Array:
        """The x that minimises |R (A x - beta)|^2 / 2 + strength D, (n,).

        Raises:
            ConvergenceError: Newton's method did not converge.
        """
        stronger = [s for s in ENTROPIC_STRENGTHS if strength < s <= 1.0]
        return self.path(R, beta, (strength, *stronger))[0]

    def path(self, R: Array, beta: Array, strengths: Sequence[float]) -> list[Array]:
        """The minimisers for ascending strengths, by continuation from the strongest, which is well inside the cone.

        Raises:
            ConvergenceError: Newton's method did not converge.
        """
        x, minimisers = _interior_start(self.cone), []
        for strength in reversed(strengths):
            x = self._newton(R, beta, strength, x)
            minimisers.append(x)
        return minimisers[::-1]

    def _newton(self, R: Array, beta: Array, strength: float, x: Array) -> Array:
        """Newton's method from x inside the cone."""
        blocks = [
            _BlockDivergence.of(block, self.cone, strength if known else BARRIER)
            for block, known in zip(self.cone.blocks, self.known, strict=True)
        ]
        rows = R @ self.cone.A
        for _ in range(_MOST_STEPS):
            gradient, hessian = rows.T @ (rows @ x - R @ beta), rows.T @ rows
            for block in blocks:
                a, B = block.derivatives(x)
                gradient, hessian = gradient + a, hessian + B
            size = np.sqrt(np.diag(hessian))
            step = -np.linalg.solve(hessian / np.outer(size, size), gradient / size) / size
            decrease = -float(gradient @ step)
            if decrease < _CENTRED**2 * max(1.0, strength):
                return x
            x = _line_search(rows, R @ beta, blocks, x, step, decrease)
        raise unsolved("Newton's method did not converge", _MOST_STEPS)


@dataclass(frozen=True, eq=False)
class _BlockDivergence:
    """Strength times the divergence of one block, up to a constant; `inverse` is that of its reference P0."""

    block: ConeBlock
    inverse: Array
    strength: float
    directions: Array

    @staticmethod
    def of(block: ConeBlock, cone: Cone, strength: float) -> _BlockDivergence:
        inverse = np.linalg.inv(block.matrix(block.reference(cone.centre, cone.ball)))
        directions = block.matrices(np.eye(len(cone.scale)))
        return _BlockDivergence(block, np.asarray(inverse, dtype=np.float64), strength, directions)

    def value(self, x: Array) -> float:
        """Strength times tr(P0^-1 P) - log det P; infinite outside of the cone."""
        P = self.block.matrix(x)
        values = np.linalg.eigvalsh(P)
        return self.strength * float(np.sum(self.inverse * P) - np.log(values).sum()) if values[0] > 0 else np.inf

    def derivatives(self, x: Array) -> tuple[Array, Array]:
        """Gradient (n,) and Hessian (n, n) of `value`."""
        inverse = np.linalg.inv(self.block.matrix(x))
        scaled = inverse @ self.directions
        gradient = np.einsum("ij,kji->k", self.inverse - inverse, self.directions)
        return self.strength * gradient, self.strength * np.einsum("aij,bji->ab", scaled, scaled)


def _interior_start(cone: Cone) -> Array:
    """The prior where it is inside the cone, else the prior plus enough of a ball."""
    x, margin = cone.centre, cone.margin(cone.centre)
    least = 1e-3 * cone.margin(cone.ball)
    return np.asarray(x if margin > least else x + (least - margin) / cone.margin(cone.ball) * 2 * cone.ball)


def _line_search(
    rows: Array, target: Array, blocks: Sequence[_BlockDivergence], x: Array, step: Array, decrease: float
) -> Array:
    """Backtracking: the largest halving of a step that stays inside the cone and satisfies Armijo's condition."""

    def value(y: Array) -> float:
        return 0.5 * float(np.sum((rows @ y - target) ** 2)) + sum(block.value(y) for block in blocks)

    here, share = value(x), 1.0
    while share > np.finfo(float).eps:
        there = value(x + share * step)
        # Near the minimum the decrease is below the rounding error of the sum of squares.
        if there <= here - ARMIJO * share * decrease or (share == 1.0 and there <= here + 1e-12 * abs(here)):
            break
        share /= 2
    return np.asarray(x + share * step)


def best_strength(observation: Observation, weights: Array, penalty: EntropicPenalty) -> float:
    """The strength of least cross-validation error, over interleaved folds of blocks."""
    index = np.arange(len(observation.blocks))
    errors = np.zeros(len(ENTROPIC_STRENGTHS))
    for fold in range(min(FOLDS, len(index))):
        unseen, seen = (observation.pick(index[(index % FOLDS == fold) == flag]) for flag in (True, False))
        T, V = seen.stack(weights), unseen.stack(weights)
        beta: Array = np.asarray(np.linalg.lstsq(T[:-1, :-1], T[:-1, -1], rcond=None)[0], dtype=np.float64)
        for k, x in enumerate(penalty.path(T[:-1, :-1], beta, ENTROPIC_STRENGTHS)):
            errors[k] += float(np.sum((V @ np.append(-penalty.cone.A @ x, 1.0)) ** 2))
    return ENTROPIC_STRENGTHS[int(np.argmin(errors))]
