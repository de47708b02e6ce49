"""Regularised least squares: ridge regression (`Ridge`) and entropic divergence from prior bodies (`Entropic`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy import linalg

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
# Newton's method: largest number of steps, decrement at convergence, and share of the predicted decrease required.
_MOST_STEPS, _CENTRED, ARMIJO = 300, 1e-8, 0.1
# Decrement, in units of the residual's standard deviation, below which a halt by rounding is convergence.
_ROUNDED = 1e-3


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
        x = penalty.minimiser(free.R / scale, free.R @ free.beta / scale, strength)
        beta = cone.A @ x
        bodies = FeasibleParameters(model, beta, cone.scale * x, min(1.0, cone.margin(x)), ())
        return Constrained(bodies, free.beta, (), costs(observation.motors, free.beta, beta), pulled=True)


def prior_links(model: DynamicModel) -> list[str]:
    """Names of the links with a prior value for all ten parameters."""
    return [name for name in model.device.joint_names if all(kind + name in model.device.prior for kind in INERTIAL)]


@dataclass(frozen=True, eq=False)
class EntropicPenalty:
    """The divergence of scaled standard parameters from the prior.

    Newton's method in square-root form: with P = L L' the divergence has the gradient E'r and the Hessian E'E, where
    E_k = L^-1 (dP / dx_k) L^-T and r = L' P0^-1 L - 1, so that every step is a least-squares problem and no normal
    equations are formed. The objective over the least weight is self-concordant: steps as long as 1 / (1 + decrement)
    decrease it everywhere in the cone, so the iteration converges from any start inside.

    Source: Nesterov and Nemirovskii (1994), Interior-Point Polynomial Algorithms, section 2.2.

    Attributes:
        cone: the conditions; its centre is the prior where there is one.
        known: which of its blocks have a prior body, (blocks,).
    """

    cone: Cone
    known: tuple[bool, ...]

    @cached_property
    def _groups(self) -> tuple[_Divergence, ...]:
        """Links and terms, each stacked."""
        every = list(zip(self.cone.blocks, self.known, strict=True))
        sorts = ([one for one in every if one[0].is_link is link] for link in (True, False))
        return tuple(_Divergence.of(sort, self.cone) for sort in sorts if sort)

    def minimiser(self, R: Array, z: Array, strength: float) -> Array:
        """The x that minimises |R A x - z|^2 / 2 + strength D, (n,).

        Args:
            R, z: of the rows, (p, p) and (p,), in units of the residual's standard deviation.
            strength: of the regularisation.

        Raises:
            ConvergenceError: rounding stopped Newton's method.
        """
        stronger = [s for s in ENTROPIC_STRENGTHS if strength < s <= 1.0]
        return self.path(R, z, (strength, *stronger))[0]

    def path(self, R: Array, z: Array, strengths: Sequence[float]) -> list[Array]:
        """The minimisers for ascending strengths, by continuation from the strongest, which is well inside the cone.

        Raises:
            ConvergenceError: rounding stopped Newton's method.
        """
        x, minimisers = _interior_start(self.cone), []
        for strength in reversed(strengths):
            x = self._newton(R @ self.cone.A, z, strength, x)
            minimisers.append(x)
        return minimisers[::-1]

    def _newton(self, rows: Array, z: Array, strength: float, x: Array) -> Array:
        """Newton's method from x inside the cone."""
        weights = [np.where(group.known, strength, BARRIER) for group in self._groups]
        least = min((float(w.min()) for w in weights), default=1.0)

        def value(y: Array) -> float:
            parts = (group.value(y, w) for group, w in zip(self._groups, weights, strict=True))
            return 0.5 * float(np.sum((rows @ y - z) ** 2)) + sum(parts)

        here = value(x)
        for _ in range(_MOST_STEPS):
            parts = [group.linearised(x, w) for group, w in zip(self._groups, weights, strict=True)]
            E, r = np.concatenate([rows, *(E for E, _ in parts)]), np.concatenate([rows @ x - z, *(r for _, r in parts)])
            size = np.linalg.norm(E, axis=0)
            size[size == 0] = 1.0
            step = -linalg.lstsq(E / size, r, lapack_driver="gelsy", check_finite=False)[0] / size
            decrement = float(np.linalg.norm(E @ step))
            if decrement < _CENTRED * max(1.0, np.sqrt(strength)):
                return x
            share, damped = 1.0, 1.0 / (1.0 + decrement / np.sqrt(least))
            while not (there := value(x + share * step)) <= here - ARMIJO * share * decrement**2:
                if share <= 0.5 * damped:
                    break
                share = max(share / 2, 0.5 * damped)
            if there >= here:  # the decrease is below the rounding of the objective
                if decrement < _ROUNDED * max(1.0, np.sqrt(strength)):
                    return x
                raise unsolved("Newton's method came to a halt by rounding", _MOST_STEPS)
            x, here = x + share * step, there
        raise unsolved("Newton's method did not converge", _MOST_STEPS)


@dataclass(frozen=True, eq=False)
class _Divergence:
    """tr(P0^-1 P) - log det P of all links, or of all terms, up to a constant.

    Attributes:
        directions: P is their sum with factors x, (blocks, n, size, size).
        inverse: of each block's reference P0, (blocks, size, size).
        known: which blocks have a prior body, (blocks,).
    """

    directions: Array
    inverse: Array
    known: np.ndarray

    @staticmethod
    def of(blocks: Sequence[tuple[ConeBlock, bool]], cone: Cone) -> _Divergence:
        unit = np.eye(len(cone.scale))
        inverse = [np.linalg.inv(block.matrix(block.reference(cone.centre, cone.ball))) for block, _ in blocks]
        return _Divergence(
            np.array([block.matrices(unit) for block, _ in blocks]), np.array(inverse), np.array([k for _, k in blocks])
        )

    def value(self, x: Array, weights: Array) -> float:
        """Sum over the blocks with their weights, (blocks,); infinite outside of the cone."""
        P = np.einsum("bnij,n->bij", self.directions, x)
        values = np.linalg.eigvalsh(P)
        if not (values > 0).all():
            return np.inf
        return float(weights @ (np.einsum("bij,bij->b", self.inverse, P) - np.log(values).sum(axis=1)))

    def linearised(self, x: Array, weights: Array) -> tuple[Array, Array]:
        """E, (entries, n), and r, (entries,): E'r is the gradient and E'E the Hessian of `value`."""
        P = np.einsum("bnij,n->bij", self.directions, x)
        values, vectors = np.linalg.eigh(P)
        root = vectors * np.sqrt(values)[:, None, :]
        inner = (vectors / np.sqrt(values)[:, None, :])[:, None]
        E = np.swapaxes(inner, -1, -2) @ self.directions @ inner
        r = np.swapaxes(root, -1, -2) @ self.inverse @ root - np.eye(P.shape[-1])
        factor = np.sqrt(weights)[:, None, None, None]
        return (factor * E).transpose(0, 2, 3, 1).reshape(-1, len(x)), (factor[:, 0] * r).ravel()


def _interior_start(cone: Cone) -> Array:
    """The prior where it is inside the cone, else the prior plus enough of a ball."""
    x, margin = cone.centre, cone.margin(cone.centre)
    least = 1e-3 * cone.margin(cone.ball)
    return np.asarray(x if margin > least else x + (least - margin) / cone.margin(cone.ball) * 2 * cone.ball)


def best_strength(observation: Observation, weights: Array, penalty: EntropicPenalty) -> float:
    """The strength of least cross-validation error, over interleaved folds of blocks."""
    index = np.arange(len(observation.blocks))
    errors = np.zeros(len(ENTROPIC_STRENGTHS))
    for fold in range(min(FOLDS, len(index))):
        unseen, seen = (observation.pick(index[(index % FOLDS == fold) == flag]) for flag in (True, False))
        T, V = seen.stack(weights), unseen.stack(weights)
        for k, x in enumerate(penalty.path(T[:-1, :-1], T[:-1, -1], ENTROPIC_STRENGTHS)):
            errors[k] += float(np.sum((V @ np.append(-penalty.cone.A @ x, 1.0)) ** 2))
    return ENTROPIC_STRENGTHS[int(np.argmin(errors))]
