"""Selection of a friction model from a friction curve: Coulomb, viscous, direction-dependent, Stribeck.

Models are compared by AICc, the AIC corrected for small samples (Hurvich and Tsai 1989; Burnham and Anderson 2002,
section 2.4): n ln(S / n) + 2 K + 2 K (K + 1) / (n - K - 1), with S the sum of squares of the n standardised residuals
and K parameters including the residual variance. A larger model must be lower by 2 to be chosen.

AICc alone chooses a larger model in one of twenty tests of a joint without such friction: a model larger than Coulomb
and viscous friction has to be significant by an F test as well, at 0.01 over all joints and such models (Holm). Models
for which there are too few points are not tested, and not counted.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.experiment.friction_test.curve import FrictionCurve, JointFriction
from haptid.uncertainty.distributions import f_tail
from haptid.uncertainty.multiple_testing import holm_adjusted
from haptid.uncertainty.quantities import Quantities

# Level of the tests that Coulomb and viscous friction is enough, over all of them together.
LARGER = 0.01
# Decrease of AICc that a model with more parameters requires.
_GAIN = 2.0
# Lower bounds of a point's standard error: relative to the median one, and relative to the largest torque.
TRUSTED = 0.3
_EXACT = 1e-6
# Grid points of the Stribeck velocity, from half the slowest to half the fastest speed.
_POINTS = 60
# Unit of the parameters per unit of velocity: of FV in N m s/rad, with the unit of torque before it.
PER_VELOCITY = {"N m": " s/rad", "N": " s/m"}


@dataclass(frozen=True)
class FrictionModel:
    """A friction model, linear in its parameters except for the Stribeck velocity VS, if it has one.

    Attributes:
        name: in words.
        parameters: names of its linear parameters, in order.
        regressor: at velocities (n,) and a Stribeck velocity, a column for each parameter, (n,) each.
        scaled: whether it has a Stribeck velocity VS.
    """

    name: str
    parameters: tuple[str, ...]
    regressor: Callable[[Array, float], tuple[Array, ...]]
    scaled: bool = False

    def columns(self, v: Array, scale: float) -> Array:
        """Regressor at velocities (n,) and Stribeck velocity `scale`, (n, k)."""
        return np.column_stack(self.regressor(v, scale))


_COULOMB = FrictionModel("Coulomb", ("FC", "OFF"), lambda v, _: (np.sign(v), np.ones_like(v)))
_VISCOUS = FrictionModel("Coulomb and viscous", ("FC", "FV", "OFF"), lambda v, _: (np.sign(v), v, np.ones_like(v)))
# Direction-dependent Coulomb friction is equivalent to an offset.
_BY_DIRECTION = FrictionModel(
    "different by direction",
    ("FC", "FV+", "FV-", "OFF"),
    lambda v, _: (np.sign(v), np.maximum(v, 0), np.minimum(v, 0), np.ones_like(v)),
)
# (FC + FS exp(-(v / VS)^2)) sgn v + FV v + OFF (Armstrong-Helouvry et al. 1994, Automatica 30(7)).
_STRIBECK = FrictionModel(
    "Stribeck",
    ("FC", "FV", "FS", "OFF"),
    lambda v, scale: (np.sign(v), v, np.sign(v) * np.exp(-((v / scale) ** 2)), np.ones_like(v)),
    scaled=True,
)
MODELS = (_COULOMB, _VISCOUS, _BY_DIRECTION, _STRIBECK)
_SMALL = (_COULOMB.name, _VISCOUS.name)


@dataclass(frozen=True)
class FrictionFit:
    """A friction model fitted to a curve.

    Attributes:
        friction_model: its name.
        parameters: its linear parameters; standard errors from those of the points or from their scatter about the
            fit, whichever is larger.
        VS: its Stribeck velocity, rad/s or m/s; None where it has none.
        aicc: infinite where there are too few points.
        error: 100 norm(f - f_hat) / norm(f), per cent.
        squares: sum of squares of the standardised residuals.
        free: points less parameters.
    """

    friction_model: str
    parameters: Quantities
    VS: float | None
    aicc: float
    error: float
    squares: float
    free: int

    @property
    def values(self) -> dict[str, float]:
        """Its parameters by name, VS included, SI."""
        linear = dict(zip(self.parameters.names, self.parameters.values.tolist(), strict=True))
        return linear if self.VS is None else linear | {"VS": self.VS}

    def conf_int(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Confidence intervals of the linear parameters by name."""
        ends = self.parameters.conf_int(level).tolist()
        return {name: (low, high) for name, (low, high) in zip(self.parameters.names, ends, strict=True)}


@dataclass(frozen=True)
class JointChoice:
    """The friction models of one joint, and the one chosen.

    Attributes:
        label: "motor 1".
        fits: of all models, in order of the number of parameters.
        p: of each, p-value of the F test that Coulomb and viscous friction is enough, by Holm over all joints and
            larger models; None for those that are not larger, or have too few points to be tested.
        chosen: the model to use.
    """

    label: str
    fits: tuple[FrictionFit, ...]
    p: tuple[float | None, ...]
    chosen: FrictionFit

    @property
    def enough(self) -> bool:
        """Whether viscous and Coulomb friction are sufficient."""
        return self.chosen.friction_model in _SMALL

    @property
    def sentence(self) -> str:
        """The choice, with differences of AICc, p-values and the values."""
        standard = _standard(self.fits)
        larger = [(fit, p) for fit, p in zip(self.fits, self.p, strict=True) if fit.friction_model not in _SMALL]
        each = (
            f"{fit.friction_model} {fit.aicc - standard.aicc:+.1f}, p = {'-' if p is None else format(p, '.2g')}"
            for fit, p in larger
        )
        differences = f"{'; '.join(each)}; limits {-_GAIN:g} and {LARGER:g}"
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.chosen.values.items())
        if not self.enough:
            verdict = f"viscous and Coulomb friction are not sufficient (AICc: {differences})."
        elif all(np.isinf(fit.aicc) for fit, _ in larger):
            verdict = f"too few velocities for a model larger than {self.chosen.friction_model} friction."
        else:
            alone = " Coulomb friction alone is." if self.chosen.friction_model == _COULOMB.name else ""
            verdict = f"viscous and Coulomb friction are sufficient (AICc of larger models: {differences}).{alone}"
        return f"{self.label}: {verdict} {values}."


@dataclass(frozen=True)
class FrictionChoice:
    """The friction model chosen for each joint of a test."""

    joints: tuple[JointChoice, ...]

    @property
    def enough(self) -> bool:
        """Whether viscous and Coulomb friction are sufficient for all joints."""
        return all(joint.enough for joint in self.joints)

    def summary(self) -> str:
        """A sentence for each joint."""
        return "\n".join(joint.sentence for joint in self.joints)


def choose_friction(curve: FrictionCurve) -> FrictionChoice:
    """Fit every friction model to each joint's curve, and choose the smallest sufficient one.

    Models larger than Coulomb and viscous friction only where their F test is significant over all joints.
    """
    every = [tuple(fit(friction_model, joint) for friction_model in MODELS) for joint in curve.joints]
    tested = [(k, one) for k, fits in enumerate(every) for one in fits if _testable(one)]
    adjusted = holm_adjusted(np.array([_enough(_standard(every[k]), one) for k, one in tested]))
    p = {(k, one.friction_model): own for (k, one), own in zip(tested, adjusted.tolist(), strict=True)}
    return FrictionChoice(
        tuple(
            _choice(joint.label, fits, tuple(p.get((k, one.friction_model)) for one in fits))
            for k, (joint, fits) in enumerate(zip(curve.joints, every, strict=True))
        )
    )


def _choice(label: str, fits: tuple[FrictionFit, ...], p: tuple[float | None, ...]) -> JointChoice:
    able = [
        one
        for one, own in zip(fits, p, strict=True)
        if one.friction_model in _SMALL or (own is not None and own < LARGER)
    ]
    least = min(one.aicc for one in able)
    chosen = next(one for one in able if one.aicc <= least + _GAIN)
    return JointChoice(label, fits, p, chosen)


def _standard(fits: tuple[FrictionFit, ...]) -> FrictionFit:
    """Coulomb and viscous friction."""
    return next(one for one in fits if one.friction_model == _VISCOUS.name)


def _testable(fit: FrictionFit) -> bool:
    """Whether a model is larger than Coulomb and viscous friction, and there are points enough to choose it."""
    return fit.friction_model not in _SMALL and bool(np.isfinite(fit.aicc))


def _enough(standard: FrictionFit, larger: FrictionFit) -> float:
    """P-value of the F test that the parameters which a larger model adds are zero."""
    added = standard.free - larger.free
    variance = max(larger.squares / larger.free, 1.0)  # as of `fit`
    return float(f_tail((standard.squares - larger.squares) / added / variance, added, larger.free))


def fit(friction_model: FrictionModel, joint: JointFriction) -> FrictionFit:
    """Weighted least squares of one friction model."""
    v, f = joint.velocity, joint.torque
    se = np.maximum(joint.se, max(TRUSTED * float(np.median(joint.se)), _EXACT * float(np.abs(f).max())))
    scale = _stribeck_velocity(friction_model, v, f, se) if friction_model.scaled else 1.0
    A = friction_model.columns(v, scale) / se[:, None]
    beta = np.asarray(np.linalg.lstsq(A, f / se, rcond=None)[0], dtype=np.float64)
    squares, (n, k) = float(np.sum((f / se - A @ beta) ** 2)), A.shape
    K = k + friction_model.scaled + 1
    dof = max(n - K + 1, 1)
    # Errors of one joint's points are correlated, so that their scatter may be below their standard errors.
    covariance = np.asarray(np.linalg.pinv(A.T @ A) * max(squares / dof, 1.0), dtype=np.float64)
    units = [joint.unit + PER_VELOCITY[joint.unit] * name.startswith("FV") for name in friction_model.parameters]
    correction = 2 * K * (K + 1) / (n - K - 1) if n - K - 1 > 0 else np.inf
    return FrictionFit(
        friction_model=friction_model.name,
        parameters=Quantities(friction_model.parameters, tuple(units), beta, covariance, np.full(k, float(dof))),
        VS=scale if friction_model.scaled else None,
        aicc=n * float(np.log(max(squares / n, _EXACT**2))) + 2 * K + correction,
        error=100 * float(np.linalg.norm(f - friction_model.columns(v, scale) @ beta) / np.linalg.norm(f)),
        squares=squares,
        free=n - K + 1,
    )


def _stribeck_velocity(friction_model: FrictionModel, v: Array, f: Array, se: Array) -> float:
    """The Stribeck velocity of least squared residuals, rad/s or m/s: a grid search, then a bounded line search."""
    from scipy import optimize  # slow to import, and few commands fit a friction test

    def squares(log_scale: float) -> float:
        A = friction_model.columns(v, float(np.exp(log_scale))) / se[:, None]
        residual = f / se - A @ np.linalg.lstsq(A, f / se, rcond=None)[0]
        return float(residual @ residual)

    speeds = np.abs(v)
    grid = np.linspace(np.log(0.5 * speeds.min()), np.log(0.5 * speeds.max()), _POINTS)
    best = int(np.argmin([squares(x) for x in grid]))
    ends = (grid[max(best - 1, 0)], grid[min(best + 1, _POINTS - 1)])
    return float(np.exp(optimize.minimize_scalar(squares, bounds=ends, method="bounded").x))
