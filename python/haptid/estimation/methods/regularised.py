"""Regularised least squares: ridge regression (`Ridge`) and entropic divergence from prior bodies (`Entropic`)."""

from __future__ import annotations

from dataclasses import field
from typing import ClassVar

import clarabel
import numpy as np

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.device import INERTIAL
from haptid.dynamics.model import DynamicModel
from haptid.errors import IncompleteDeviceError, setting_error
from haptid.estimation.feasibility.cone import UPPER, Cone
from haptid.estimation.feasibility.conic_program import TIGHT, ConeCondition, cones_of, solved
from haptid.estimation.feasibility.feasible import FIT_PENALTY, FeasibleParameters, roomy
from haptid.estimation.least_squares import Knowledge, Solution, solve
from haptid.estimation.method import (
    Fit,
    Method,
    Wrapper,
    expect_positive,
    expect_weighting,
    expect_whole,
)
from haptid.estimation.methods.constrained import Constrained, costs
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation

# Ridge strengths to choose from where none is given: the prior's weight times 10^-4 to 10^4.
RIDGE_STRENGTHS: tuple[float, ...] = tuple(10.0 ** (k / 2) for k in range(-8, 9))
# Entropic strengths to choose from where none is given, and the number of folds of the cross-validation.
ENTROPIC_STRENGTHS: tuple[float, ...] = tuple(10.0 ** (1.5 * k) for k in range(-2, 5))
FOLDS = 5
# Tolerance of the solver where strengths are compared.
COARSE = 1e-8
# Least entropic strength that double precision distinguishes from none.
WEAKEST = 1e-6


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
        """One over the sd of each motor's residual in the fit with the prior, of strength 1 at most, (motors,).

        A stronger prior does not change the noise: weights that fell with its misfit would hand the estimate to it.

        Raises:
            IncompleteDeviceError: the device has no prior values.
            IdentifiabilityError: a motor's torque is zero throughout.
        """
        return self._weighted(observation, self.prior(observation.model))

    def knowledge(self, observation: Observation) -> Knowledge:
        """The prior, with standard deviations scaled by the strength.

        Raises:
            IncompleteDeviceError: the device has no prior values.
        """
        prior = self.prior(observation.model)
        if self.strength is not None:
            return strengthened(prior, self.strength)
        weights = self._weighted(observation, prior)
        tried = [strengthened(prior, strength) for strength in RIDGE_STRENGTHS]
        errors = [prediction_error(observation, weights, known) for known in tried]
        return tried[int(np.argmin(errors))]

    def _weighted(self, observation: Observation, prior: Knowledge) -> Array:
        weighting = WLS(self.passes)
        known = strengthened(prior, min(self.strength or 1.0, 1.0))
        weights = np.array(
            [1.0 if motor.free else 1.0 / max(motor.norm, np.finfo(float).tiny) for motor in observation.motors]
        )
        for _ in range(self.passes):
            beta = solve(observation, weights, (), known).beta
            weights = np.array([weighting.weight(motor, beta) for motor in observation.motors])
        return weights

    def prior(self, model: DynamicModel) -> Knowledge:
        """The prior values of the base parameters.

        Raises:
            IncompleteDeviceError: the device has none.
        """
        if not has_prior(model):
            raise _no_prior(model.device.name)
        known = [(k, p) for k, p in enumerate(model.base_prior) if p is not None and (p[1] or p[0])]
        values = np.array([value for _, (value, _) in known])
        std = np.array([std or self.share * abs(value) for _, (value, std) in known])
        return Knowledge(np.eye(len(model.base))[[k for k, _ in known]], values, std)


def has_prior(model: DynamicModel) -> bool:
    """Whether a base parameter has a prior value to regularise towards."""
    return any(p is not None and (p[1] or p[0]) for p in model.base_prior)


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
        T = motor.r_factors[motor.rows > 0] * weight
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
            raise setting_error("strength", self.strength, wanted, "Entropic")
        expect_weighting("Entropic", self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, entropic regularisation towards prior bodies"

    def constrain(self, observation: Observation, free: Solution) -> Constrained:
        """The regularised estimate, with the unconstrained one.

        Raises:
            IncompleteDeviceError: no link of the device has a prior body.
            PhysicalConsistencyError: the symmetries declared for the device leave no feasible body.
            ConvergenceError: the solver stopped without a solution.
        """
        model = observation.model
        if not prior_links(model):
            raise _no_prior(model.device.name)
        cone = roomy(model, free.beta)
        penalty = EntropicPenalty.of(model, cone)
        scale = 1.0 if self.unit_residual else free.rest / np.sqrt(free.dof)
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
    """The divergence of scaled standard parameters from the prior, minimised together with the rows' residual.

    A conic programme, so that links without a prior may lie on the boundary of the cone, or have masses that torque
    does not bound, where a barrier method stalls. log det P is the largest sum of log Z_ii with

        [P Z; Z' diag(Z)] positive semidefinite, Z lower triangular,

    each log by an exponential cone.

    Source: Ben-Tal and Nemirovski (2001), Lectures on Modern Convex Optimization, section 4.2, for the determinant.

    Attributes:
        cone: the conditions; its centre is the prior where there is one.
        known: which of its blocks have a prior body, (blocks,).
    """

    cone: Cone
    known: tuple[bool, ...]

    @staticmethod
    def of(model: DynamicModel, cone: Cone) -> EntropicPenalty:
        """Of a device and its cone."""
        known = {f"link {name}" for name in prior_links(model)}
        return EntropicPenalty(cone, tuple(block.label in known for block in cone.blocks))

    def minimiser(self, R: Array, z: Array, strength: float, tolerance: float = TIGHT) -> Array:
        """The x that minimises |R A x - z|^2 / 2 + strength D, (n,).

        Args:
            R, z: of the rows, (p, p) and (p,), in units of the residual's standard deviation.
            strength: of the regularisation.
            tolerance: of the solver.

        Raises:
            ConvergenceError: the solver stopped without a solution.
        """
        cone, (p, n) = self.cone, self.cone.A.shape
        x = cone.start(np.asarray(np.linalg.lstsq(R, z, rcond=None)[0]))
        links = [block for block, known in zip(cone.blocks, self.known, strict=True) if known]
        first, per = n + p, len(_LOWER) + _SIDE
        # Variables: change of x; residual over `size`; then Z and the logarithms of each link with a prior.
        size = max(1.0, float(np.sqrt(strength)))
        count = first + per * len(links)
        cost, quadratic = (
            np.zeros(count),
            np.concatenate([np.full(n, FIT_PENALTY), np.ones(p), np.zeros(count - first)]),
        )
        weight = strength / size**2
        rows = [np.hstack([R @ cone.A / size, -np.eye(p), np.zeros((p, count - first))])]
        right, cones = [(z - R @ (cone.A @ x)) / size], [clarabel.ZeroConeT(p)]
        for block in (b for b, known in zip(cone.blocks, self.known, strict=True) if not known):
            rows.append(np.hstack([-block.G, np.zeros((len(block.G), count - n))]))
            right.append(block.G @ x)
            cones += cones_of([ConeCondition(block.G, block.G @ x, block.is_link)])
        for k, block in enumerate(links):
            own = slice(first + k * per, first + (k + 1) * per)
            inverse = np.linalg.inv(block.matrix(block.reference(cone.centre, cone.ball)))
            cost[:n] += weight * np.einsum("ij,kji->k", inverse, block.matrices(np.eye(n)))
            cost[own.stop - _SIDE : own.stop] = -weight
            part = np.zeros((len(_DETERMINANT[0]), count))
            part[:, :n], part[:, own] = -_DETERMINANT[0] @ block.G, -_DETERMINANT[1]
            rows.append(part)
            right.append(_DETERMINANT[0] @ block.G @ x)
            cones.append(clarabel.PSDTriangleConeT(2 * _SIDE))
            for i in range(_SIDE):  # (log, 1, Z_ii) in the exponential cone
                part = np.zeros((3, count))
                part[0, own.stop - _SIDE + i] = part[2, own.start + _LOWER.index((i, i))] = -1.0
                rows.append(part)
                right.append(np.array([0.0, 1.0, 0.0]))
                cones.append(clarabel.ExponentialConeT())
        answer = solved(np.diag(quadratic), cost, np.concatenate(rows), np.concatenate(right), cones, tolerance)[0]
        return cone.moved_inside(x + answer[:n])


# Entries of a lower triangular matrix of the size of a pseudo-inertia.
_SIDE = 4
_LOWER = tuple((i, k) for i in range(_SIDE) for k in range(i + 1))


def _determinant() -> tuple[Array, Array]:
    """Maps from a link's cone entries, (36, 10), and from Z and logarithms, (36, 14), to [P Z; Z' diag(Z)]."""
    basis = np.zeros((len(UPPER), _SIDE, _SIDE))
    for row, (i, k) in enumerate(UPPER):
        basis[row, i, k] = basis[row, k, i] = 1.0 if i == k else np.sqrt(0.5)
    of_p, of_z = np.zeros((len(UPPER), 2 * _SIDE, 2 * _SIDE)), np.zeros((len(_LOWER) + _SIDE, 2 * _SIDE, 2 * _SIDE))
    of_p[:, :_SIDE, :_SIDE] = basis
    for row, (i, k) in enumerate(_LOWER):
        of_z[row, i, _SIDE + k] = of_z[row, _SIDE + k, i] = 1.0
        of_z[row, _SIDE + i, _SIDE + i] = float(i == k)
    upper = [(i, k) for k in range(2 * _SIDE) for i in range(k + 1)]
    entry = np.array([1.0 if i == k else np.sqrt(2) for i, k in upper])
    picked = tuple(np.array(upper).T)
    return (entry * of_p[:, *picked]).T, (entry * of_z[:, *picked]).T


_DETERMINANT = _determinant()


def best_strength(observation: Observation, weights: Array, penalty: EntropicPenalty) -> float:
    """The strength of least cross-validation error, over interleaved folds of blocks."""
    index = np.arange(len(observation.blocks))
    errors = np.zeros(len(ENTROPIC_STRENGTHS))
    for fold in range(min(FOLDS, len(index))):
        unseen, training = (observation.pick(index[(index % FOLDS == fold) == flag]) for flag in (True, False))
        T, V = training.stack(weights), unseen.stack(weights)
        for k, strength in enumerate(ENTROPIC_STRENGTHS):
            x = penalty.minimiser(T[:-1, :-1], T[:-1, -1], strength, COARSE)
            errors[k] += float(np.sum((V @ np.append(-penalty.cone.A @ x, 1.0)) ** 2))
    return ENTROPIC_STRENGTHS[int(np.argmin(errors))]
