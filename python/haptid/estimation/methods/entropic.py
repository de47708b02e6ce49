"""Least squares pulled towards prior bodies by entropic divergence: the pull of nature's own metric of inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array, positive
from haptid.device import INERTIAL
from haptid.dynamics.model import DynamicModel
from haptid.errors import MethodSettingError, NoPriorError, UnsolvedError
from haptid.estimation.feasibility.cone import Block, Cone
from haptid.estimation.feasibility.feasible import FeasibleParameters, roomy
from haptid.estimation.least_squares import Solution
from haptid.estimation.method import Around, Method, expect_weighting
from haptid.estimation.methods.consistent import Constrained, costs
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation

# Strengths that are tried where none is given, and in how many folds.
STRENGTHS = tuple(10.0**k for k in range(-3, 7))
FOLDS = 5
# A weaker pull cannot be told from none in double precision.
WEAKEST = 1e-6
# Pull on what has no prior: too weak to move anything by a thousandth of its deviation, enough to stay inside.
INSIDE = 1e-3
# Newton's steps, the decrement at which they end, and how much of its promise a step must keep.
MOST_STEPS, CENTRED, KEPT = 300, 1e-8, 0.1


@dataclass(frozen=True)
class Entropic(Around):
    """Weighted least squares, pulled towards the prior bodies of the device file, and held to possible ones.

    The sum of squares, in units of the residual's variance, halved, plus `strength` times the sum over all links with
    a prior body of the Bregman divergence of log det between pseudo-inertias P and P0,

        D(P || P0) = tr(P0^-1 P) - log det(P0^-1 P) - 4,

    is least. It does not depend on the frames and units in which bodies are told, is zero only at the prior, and
    grows without end towards the border of what bodies can have. As the strength goes to zero the estimate goes to
    that of `PhysicallyConsistent()`. Links without a prior body, and friction, are only held to what is possible.

    Where no strength is given, it is the one whose estimates from four fifths of the blocks predict the torque of the
    others best. Intervals are the free fit's, widened to take in the estimate; see `PhysicallyConsistent`.

    Source: Lee, Wensing and Park (2020), IEEE Transactions on Robotics 36(2), eqs 24 and 33.

    Attributes:
        strength: of the pull; None for the one that predicts best.
        weighting: how the motors' rows are weighted.
    """

    strength: float | None = None
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        if self.strength is not None and not (positive(self.strength) and self.strength >= WEAKEST):
            wanted = f"{WEAKEST:g} or more (`PhysicallyConsistent()` has no pull at all), or None"
            raise MethodSettingError("Entropic", "strength", self.strength, wanted)
        expect_weighting("Entropic", self.weighting)

    @property
    def name(self) -> str:
        return f"{self.weighting.name}, entropic pull towards prior bodies"

    def hold(self, observation: Observation, free: Solution) -> Constrained:
        """The pulled estimate beside the free one.

        Raises:
            NoPriorError: no link of the device has a prior body.
            NoBodyError: the symmetries declared for the device leave no body.
            UnsolvedError: Newton's method stopped before it had an answer.
        """
        model = observation.model
        pulled = [f"link {name}" for name in prior_links(model)]
        if not pulled:
            raise NoPriorError(model.device.name)
        conditions = roomy(model, free.beta)
        scale = 1.0 if self.unit_residual else free.rest / np.sqrt(free.dof)
        pull = Pull(conditions, tuple(block.label in pulled for block in conditions.blocks))
        strength = self.strength or best(observation, self.weights(observation) / scale, pull)
        x = pull.least(free.R / scale, free.beta, strength)
        beta = conditions.A @ x
        bodies = FeasibleParameters(model, beta, conditions.scale * x, min(1.0, conditions.margin(x)), ())
        return Constrained(bodies, free.beta, (), costs(observation.motors, free.beta, beta), pulled=True)


def prior_links(model: DynamicModel) -> list[str]:
    """Names of the links all of whose ten parameters are known beforehand."""
    return [name for name in model.device.joint_names if all(kind + name in model.device.prior for kind in INERTIAL)]


@dataclass(frozen=True, eq=False)
class Pull:
    """The divergence of scaled standard parameters from the prior.

    Attributes:
        cone: the conditions; its centre is the prior where there is one.
        known: which of its blocks have a prior body, (blocks,).
    """

    cone: Cone
    known: tuple[bool, ...]

    def least(self, R: Array, beta: Array, strength: float) -> Array:
        """The x of least |R (A x - beta)|^2 / 2 + strength D, (n,).

        Raises:
            UnsolvedError: it did not come to rest.
        """
        stronger = [s for s in STRENGTHS if strength < s <= 1.0]
        return self.path(R, beta, (strength, *stronger))[0]

    def path(self, R: Array, beta: Array, strengths: Sequence[float]) -> list[Array]:
        """The same of several strengths, from weak to strong; the weak are come to from the strong, which are inside.

        Raises:
            UnsolvedError: one did not come to rest.
        """
        x, made = _start(self.cone), []
        for strength in reversed(strengths):
            x = self._rest(R, beta, strength, x)
            made.append(x)
        return made[::-1]

    def _rest(self, R: Array, beta: Array, strength: float, x: Array) -> Array:
        """Newton's method from x inside the cone."""
        blocks = [_Pulled.of(block, self.cone, strength if own else INSIDE) for block, own in self._blocks]
        rows = R @ self.cone.A
        for _ in range(MOST_STEPS):
            slope, curve = rows.T @ (rows @ x - R @ beta), rows.T @ rows
            for block in blocks:
                a, B = block.derivatives(x)
                slope, curve = slope + a, curve + B
            size = np.sqrt(np.diag(curve))
            move = -np.linalg.solve(curve / np.outer(size, size), slope / size) / size
            promise = -float(slope @ move)
            if promise < CENTRED**2 * max(1.0, strength):
                return x
            x = _stepped(rows, R @ beta, blocks, x, move, promise)
        raise UnsolvedError("not at rest", MOST_STEPS)

    @property
    def _blocks(self) -> list[tuple[Block, bool]]:
        return list(zip(self.cone.blocks, self.known, strict=True))


@dataclass(frozen=True, eq=False)
class _Pulled:
    """A block, what it is pulled to and how strongly."""

    block: Block
    pull: Array
    strength: float
    directions: Array

    @staticmethod
    def of(block: Block, cone: Cone, strength: float) -> _Pulled:
        home = np.linalg.inv(block.matrix(block.home(cone.centre, cone.ball)))
        return _Pulled(block, np.asarray(home, dtype=np.float64), strength, block.matrices(np.eye(len(cone.scale))))

    def value(self, x: Array) -> float:
        """Strength times tr(P0^-1 P) - log det P; infinite outside of the cone."""
        P = self.block.matrix(x)
        sign = np.linalg.eigvalsh(P)
        return self.strength * float(np.sum(self.pull * P) - np.log(sign).sum()) if sign[0] > 0 else np.inf

    def derivatives(self, x: Array) -> tuple[Array, Array]:
        """Slope (n,) and curvature (n, n) of `value`."""
        inverse = np.linalg.inv(self.block.matrix(x))
        bent = inverse @ self.directions
        slope = np.einsum("ij,kji->k", self.pull - inverse, self.directions)
        return self.strength * slope, self.strength * np.einsum("aij,bji->ab", bent, bent)


def _start(cone: Cone) -> Array:
    """The prior where it is inside, else as much of balls with it as brings it there."""
    x, margin = cone.centre, cone.margin(cone.centre)
    least = 1e-3 * cone.margin(cone.ball)
    return np.asarray(x if margin > least else x + (least - margin) / cone.margin(cone.ball) * 2 * cone.ball)


def _stepped(rows: Array, target: Array, blocks: Sequence[_Pulled], x: Array, move: Array, promise: float) -> Array:
    """As much of a step as keeps inside and keeps its promise."""

    def value(y: Array) -> float:
        return 0.5 * float(np.sum((rows @ y - target) ** 2)) + sum(block.value(y) for block in blocks)

    here, share = value(x), 1.0
    while share > np.finfo(float).eps:
        there = value(x + share * move)
        # Near the end the sum of squares hides what is gained in its rounding.
        if there <= here - KEPT * share * promise or (share == 1.0 and there <= here + 1e-12 * abs(here)):
            break
        share /= 2
    return np.asarray(x + share * move)


def best(observation: Observation, weights: Array, pull: Pull) -> float:
    """The strength whose estimates from the other blocks predict each fold's torque best."""
    index = np.arange(len(observation.blocks))
    errors = np.zeros(len(STRENGTHS))
    for fold in range(min(FOLDS, len(index))):
        unseen, seen = (observation.pick(index[(index % FOLDS == fold) == flag]) for flag in (True, False))
        T, V = seen.stack(weights), unseen.stack(weights)
        beta: Array = np.asarray(np.linalg.lstsq(T[:-1, :-1], T[:-1, -1], rcond=None)[0], dtype=np.float64)
        for k, x in enumerate(pull.path(T[:-1, :-1], beta, STRENGTHS)):
            errors[k] += float(np.sum((V @ np.append(-pull.cone.A @ x, 1.0)) ** 2))
    return STRENGTHS[int(np.argmin(errors))]
