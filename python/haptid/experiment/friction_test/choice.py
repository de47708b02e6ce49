"""Which friction model a friction test asks for: Coulomb, viscous, Stribeck, different by direction.

Models are compared by AIC with the correction for small samples (Hurvich and Tsai 1989; Burnham and Anderson 2002,
section 2.4): n ln(S / n) + 2 K + 2 K (K + 1) / (n - K - 1), with S the sum of squares of the n residuals in their
own deviations, and K parameters, the residual's variance among them. A larger model must be lower by 2 to be chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import optimize, stats

from haptid._internal.arrays import Array
from haptid.experiment.friction_test.curve import FrictionCurve, JointFriction

# A model with more parameters must lower AICc by this much.
GAIN = 2.0
# No point is trusted much more than the median one, nor better than this share of the largest torque.
TRUSTED = 0.3
EXACT = 1e-6
# Stribeck velocities are sought on so many points from half the slowest to half the fastest speed.
POINTS = 60


class FrictionModel(Protocol):
    """A friction model, linear in its parameters but for one scale of velocity at most."""

    @property
    def name(self) -> str:
        """In words."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its linear parameters, in order."""

    @property
    def scaled(self) -> bool:
        """Whether it has a scale of velocity, VS."""

    def columns(self, v: Array, scale: float) -> Array:
        """Torque of unit parameters at velocities (n,), (n, k)."""


@dataclass(frozen=True)
class Coulomb:
    """FC sgn v + OFF."""

    name: str = "Coulomb"
    parameters: tuple[str, ...] = ("FC", "OFF")
    scaled: bool = False

    def columns(self, v: Array, scale: float) -> Array:
        """(n, 2)."""
        del scale
        return np.column_stack([np.sign(v), np.ones_like(v)])


@dataclass(frozen=True)
class CoulombViscous:
    """FC sgn v + FV v + OFF."""

    name: str = "Coulomb and viscous"
    parameters: tuple[str, ...] = ("FC", "FV", "OFF")
    scaled: bool = False

    def columns(self, v: Array, scale: float) -> Array:
        """(n, 3)."""
        del scale
        return np.column_stack([np.sign(v), v, np.ones_like(v)])


@dataclass(frozen=True)
class ByDirection:
    """FC sgn v + FV+ v or FV- v + OFF: Coulomb friction that differs by direction is an offset."""

    name: str = "different by direction"
    parameters: tuple[str, ...] = ("FC", "FV+", "FV-", "OFF")
    scaled: bool = False

    def columns(self, v: Array, scale: float) -> Array:
        """(n, 4)."""
        del scale
        return np.column_stack([np.sign(v), np.maximum(v, 0), np.minimum(v, 0), np.ones_like(v)])


@dataclass(frozen=True)
class Stribeck:
    """(FC + FS exp(-(v / VS)^2)) sgn v + FV v + OFF (Armstrong-Helouvry et al. 1994, Automatica 30(7))."""

    name: str = "Stribeck"
    parameters: tuple[str, ...] = ("FC", "FV", "FS", "OFF")
    scaled: bool = True

    def columns(self, v: Array, scale: float) -> Array:
        """(n, 4)."""
        sign = np.sign(v)
        return np.column_stack([sign, v, sign * np.exp(-((v / scale) ** 2)), np.ones_like(v)])


MODELS: tuple[FrictionModel, ...] = (Coulomb(), CoulombViscous(), ByDirection(), Stribeck())
ENOUGH = "Coulomb and viscous"


@dataclass(frozen=True)
class FrictionFit:
    """A model fitted to a curve.

    Attributes:
        friction_model: its name.
        values: of its parameters by name, SI; VS too.
        intervals: 95 % of each linear parameter by name, from the points' deviations or their scatter about the
            fit, whichever is larger.
        aicc: infinite where there are too few points to tell.
        error: 100 norm(f - f_hat) / norm(f), per cent.
    """

    friction_model: str
    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    aicc: float
    error: float


@dataclass(frozen=True)
class JointChoice:
    """Models of one joint's friction, and the one to use.

    Attributes:
        label: "motor 1".
        fits: of all models, from few parameters to many.
        chosen: the one to use.
    """

    label: str
    fits: tuple[FrictionFit, ...]
    chosen: FrictionFit

    @property
    def enough(self) -> bool:
        """Whether viscous and Coulomb friction are enough."""
        return self.chosen.friction_model in (MODELS[0].name, ENOUGH)

    @property
    def sentence(self) -> str:
        """The verdict, and what it rests on."""
        plain = next(fit for fit in self.fits if fit.friction_model == ENOUGH)
        larger = [fit for fit in self.fits if fit.friction_model not in (MODELS[0].name, ENOUGH)]
        figures = ", ".join(f"{fit.friction_model} {fit.aicc - plain.aicc:+.1f}" for fit in larger)
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.chosen.values.items())
        if not self.enough:
            return f"{self.label}: viscous and Coulomb friction are not enough (AICc: {figures}). {values}."
        if all(np.isinf(fit.aicc) for fit in larger):
            return (
                f"{self.label}: too few velocities to tell more than {self.chosen.friction_model} friction. {values}."
            )
        alone = " Coulomb friction alone is." if self.chosen.friction_model == MODELS[0].name else ""
        return f"{self.label}: viscous and Coulomb friction are enough (AICc of more: {figures}).{alone} {values}."


@dataclass(frozen=True)
class FrictionChoice:
    """The friction model that each joint of a test asks for."""

    joints: tuple[JointChoice, ...]

    @property
    def enough(self) -> bool:
        """Whether viscous and Coulomb friction are enough for all joints."""
        return all(joint.enough for joint in self.joints)

    def summary(self) -> str:
        """A sentence for each joint."""
        return "\n".join(joint.sentence for joint in self.joints)


def choose_friction(curve: FrictionCurve) -> FrictionChoice:
    """Fit every model to each joint's curve, and say which is enough."""
    return FrictionChoice(tuple(_choice(joint) for joint in curve.joints))


def _choice(joint: JointFriction) -> JointChoice:
    fits = tuple(fit(friction_model, joint) for friction_model in MODELS)
    least = min(one.aicc for one in fits)
    chosen = next(one for one in fits if one.aicc <= least + GAIN)
    return JointChoice(joint.label, fits, chosen)


def fit(friction_model: FrictionModel, joint: JointFriction) -> FrictionFit:
    """Weighted least squares of one model."""
    v, f = joint.velocity, joint.torque
    deviation = np.maximum(joint.se, max(TRUSTED * float(np.median(joint.se)), EXACT * float(np.abs(f).max())))
    scale = _scale(friction_model, v, f, deviation) if friction_model.scaled else 1.0
    A = friction_model.columns(v, scale) / deviation[:, None]
    beta = np.linalg.lstsq(A, f / deviation, rcond=None)[0]
    rest, (n, k) = float(np.sum((f / deviation - A @ beta) ** 2)), A.shape
    K = k + friction_model.scaled + 1
    enough = n - K - 1 > 0
    # Points of one joint err together, so that their scatter may be less than their own deviations.
    spread = np.sqrt(np.diag(np.linalg.pinv(A.T @ A)) * max(rest / max(n - K + 1, 1), 1.0))
    half = stats.t.ppf(0.975, max(n - K + 1, 1)) * spread
    values = dict(zip(friction_model.parameters, beta.tolist(), strict=True)) | (
        {"VS": scale} if friction_model.scaled else {}
    )
    ends = zip(friction_model.parameters, (beta - half).tolist(), (beta + half).tolist(), strict=True)
    missed = np.linalg.norm(f - friction_model.columns(v, scale) @ beta)
    return FrictionFit(
        friction_model=friction_model.name,
        values=values,
        intervals={name: (low, high) for name, low, high in ends},
        aicc=n * float(np.log(max(rest / n, EXACT**2))) + 2 * K + 2 * K * (K + 1) / (n - K - 1) if enough else np.inf,
        error=100 * float(missed / np.linalg.norm(f)),
    )


def _scale(friction_model: FrictionModel, v: Array, f: Array, deviation: Array) -> float:
    """The scale of velocity that fits best, rad/s or m/s."""

    def rest(log_scale: float) -> float:
        A = friction_model.columns(v, float(np.exp(log_scale))) / deviation[:, None]
        missed = f / deviation - A @ np.linalg.lstsq(A, f / deviation, rcond=None)[0]
        return float(missed @ missed)

    speeds = np.abs(v)
    grid = np.linspace(np.log(0.5 * speeds.min()), np.log(0.5 * speeds.max()), POINTS)
    best = int(np.argmin([rest(x) for x in grid]))
    ends = (grid[max(best - 1, 0)], grid[min(best + 1, POINTS - 1)])
    return float(np.exp(optimize.minimize_scalar(rest, bounds=ends, method="bounded").x))
