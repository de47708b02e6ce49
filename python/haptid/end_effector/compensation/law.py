"""Inertia, gravity and friction compensation: a feedforward controller from the identified model.

The motors' torque is

    tau = share dp/dt + weight * gravity torque + friction * friction torque - damping J' J qd,   p = A(q) qd,

with dp/dt from the momentum through one low-pass filter: positions are differentiated once, and no acceleration is
needed. The apparent mass is then (1 - share) M where the model is correct, below the bandwidth of the filters.

A constant share keeps the ratio of masses between poses. For a constant apparent mass m0 the share depends on the pose,

    share(q) = 1 - m0 / m(q), at least 0 and at most the share that is set,

m the largest principal mass at the handle: the apparent mass is m0 wherever neither limit is reached. Coriolis and
centrifugal forces are scaled with the mass, although they are then not those of a constant mass.

Activity. Late feedback of acceleration is negative damping: with a lag T the hand feels - share m w^2 T at the
frequency w. `damping`, an isotropic damper at the handle through the velocity filter, outweighs it in the band of a
hand's motion. `loop` gives the impedance at the handle, the verdict on passivity and the stability with a hand, exactly
for sampling, filters and delay; `design.py` searches for settings that a hand can hold.

Stability. All lags are one delay T to first order (`Compensation.lag`). For a mode with inertia a, of which the hand's
own part h is not compensated, with stiffness k and damping b (of the hand and of the joints), the characteristic
equation is

    share a T s^3 + (a + h - share a) s^2 + b s + k = 0,

stable where (a + h - share a) b > share a T k (Routh), that is

    share < (1 + h / a) / (1 + T k / b).

The same holds for several joints at a pose, each quantity being a quadratic form of the mode: the bound with the
least h / a and the largest k / b is sufficient. The momentum torque vanishes at rest, so a share that depends on the
pose has the same bound at each pose: m0 > (1 - bound(q)) m(q). A free handle, k = 0, leaves share < 1 (less by as much
as the model overestimates the mass). Dynamics beyond these lags, such as a handle on a flexible structure, is not
included.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, expect, freeze, positive
from haptid._internal.late import dataclass
from haptid.device.terms.friction import LoadDependentFriction
from haptid.dynamics.inverse import core_momentum, core_torque, inverse_dynamics, mass_matrix, raw_parameters, rigid
from haptid.dynamics.kinematics import handle_motion, handle_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.end_effector.characterisation.apparent_mass import apparent_mass
from haptid.end_effector.characterisation.friction import coulomb_level, viscous_matrix
from haptid.end_effector.characterisation.model import GivenParameters, IdentifiedModel
from haptid.end_effector.compensation.sampled import Feedback, SampledLoop, filtered_difference
from haptid.errors import setting_error
from haptid.observation.reversals import smoothed_friction

# From time since the start, s, and measured positions of the active joints, (active,), to torques of the motors'
# coordinates, (motors,), N m or N.
_Step = Callable[[float, Array], Array]
# Step of the central difference of static torques, rad or m.
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class Compensation:
    """Compensation of inertia, gravity and friction from a model.

    Attributes:
        identified: an estimate, or given parameters.
        share: of the inertia that is compensated, 0 to below 1; the largest share where `towards` is given.
        weight: share of gravity, springs and offsets that is compensated, 0 to 1.
        friction: share of friction that is compensated, 0 to 1; stay below the least friction expected.
        slow: speed scale of dry friction, tanh(rate / slow): none is compensated at rest, rad/s or m/s.
        velocity_cutoff_hz: of the first-order filter on position differences.
        momentum_cutoff_hz: of the filter on the rate of momentum.
        damping: of the isotropic damper that is added at the handle, N s/m.
        towards: apparent mass (largest principal mass) to reach at every pose, kg; None for a constant share.
    """

    identified: IdentifiedModel
    share: float = 0.5
    weight: float = 1.0
    friction: float = 0.0
    slow: float = 0.05
    velocity_cutoff_hz: float = 100.0
    momentum_cutoff_hz: float = 60.0
    damping: float = 0.0
    towards: float | None = None

    def __post_init__(self) -> None:
        for name in ("share", "weight", "friction"):
            if not 0 <= getattr(self, name) <= 1 or (name == "share" and self.share == 1):
                raise setting_error(name, getattr(self, name), f"0 to {'below ' * (name == 'share')}1")
        for name in ("slow", "velocity_cutoff_hz", "momentum_cutoff_hz"):
            if not positive(getattr(self, name)):
                raise setting_error(name, getattr(self, name), "a finite number above 0")
        if not 0 <= self.damping < np.inf:
            raise setting_error("damping", self.damping, "a finite number from 0")
        if self.damping:
            handle_of(self.identified.model)
        for term in self.identified.model.terms if self.friction else ():
            if isinstance(term.shape, LoadDependentFriction):
                wanted = f"0: term {term.name} depends on accelerations, which the controller does not have"
                raise setting_error("friction", self.friction, wanted)
        if self.towards is not None:
            handle_of(self.identified.model)
            if not positive(self.towards):
                raise setting_error("towards", self.towards, "a mass above 0 kg, or None")

    def share_at(self, qa: Array) -> Array:
        """Share of the inertia that is compensated at poses, (poses,).

        The largest share near singular poses, where some mass is unbounded.

        Args:
            qa: positions of the active joints, (active, poses), rad or m.
        """
        if self.towards is None:
            return freeze(np.full(qa.shape[1], self.share))
        mass = apparent_mass(GivenParameters(self.identified.model, self.identified.beta), qa).mass.values[:, 0]
        share = 1 - self.towards / np.where(np.isfinite(mass), mass, np.inf)
        return freeze(np.clip(share, 0.0, self.share))

    @property
    def friction_taken(self) -> float:
        """Share of dry friction that a hand does not feel."""
        return self.friction

    def begin(self, dt: float) -> _Step:
        """The controller, starting from rest, to be called once every control period.

        Args:
            dt: control period, s.
        """
        return _Controller(self, dt).step

    def loop(self, qa: Array, dt: float, delay: float = 0.0) -> SampledLoop:
        """Device and law at a pose, linear about rest, by the model itself.

        Friction compensation has its slope at rest, where it is steepest; dry friction is left out.

        Args:
            qa: positions of the active joints, (active,), rad or m.
            dt, delay: as in `lag`.
        """
        model, beta, q = self.identified.model, self.identified.beta, np.asarray(qa, dtype=float)[:, None]
        J = handle_motion(model, q).row_jacobian[0, :3]
        A, B, K = mass_matrix(model, beta, q)[0], viscous_matrix(model, beta, q)[0], static_stiffness(model, beta, q)
        velocity, rate = (
            filtered_difference(self.velocity_cutoff_hz, dt),
            filtered_difference(self.momentum_cutoff_hz, dt),
        )
        # Dry friction of coordinates, compensated by tanh(rate / slow).
        steep = B + np.diag(coulomb_level(model, beta, q)[:, 0]) / self.slow
        parts = [
            Feedback(
                -self.share_at(q)[0] * A,
                tuple(np.convolve(velocity[0], rate[0])),
                tuple(np.convolve(velocity[1], rate[1])),
            ),
            Feedback(self.damping * J.T @ J - self.friction * steep, tuple(velocity[0]), tuple(velocity[1])),
            Feedback(-self.weight * K, (1.0,)),
        ]
        return SampledLoop(A, B, K, J, tuple(part for part in parts if part.matrix.any()), dt, delay)

    def lag(self, dt: float, delay: float = 0.0) -> float:
        """Total lag T of two differences, two filters, the amplifiers and the zero-order hold, s.

        Args:
            dt: control period, s.
            delay: from reading positions to the torque, s.
        """
        filters = sum(dt * pole / (1 - pole) for pole in self.keeps(dt))
        return 3 * dt / 2 + filters + delay

    def keeps(self, dt: float) -> tuple[float, float]:
        """Poles of the discrete velocity and momentum filters."""
        cutoffs = (self.velocity_cutoff_hz, self.momentum_cutoff_hz)
        return (float(np.exp(-2 * np.pi * cutoffs[0] * dt)), float(np.exp(-2 * np.pi * cutoffs[1] * dt)))

    def passed(self, frequency_hz: float, dt: float, delay: float = 0.0) -> complex:
        """Frequency response of the lags: the apparent mass at a frequency is (1 - share * this) M.

        Args:
            frequency_hz: of the motion.
            dt, delay: as in `lag`.
        """
        shift = np.exp(-2j * np.pi * frequency_hz * dt)
        filters = np.prod([(1 - pole) / (1 - pole * shift) for pole in self.keeps(dt)])
        delayed = np.exp(-2j * np.pi * frequency_hz * (3 * dt / 2 + delay))
        # Two differences and a hold: each a delay of half a period and a sinc.
        return complex(filters * delayed * np.sinc(frequency_hz * dt) ** 3)


def stable_share(inertia: Array, damping: Array, stiffness: Array, lag: float, hand: Array | None = None) -> float:
    """Stability bound on the compensated share of inertia at a pose: (1 + h / a) / (1 + T k / b), worst mode.

    Args:
        inertia: of the device, (n, n), kg m^2.
        damping: of hand and joints, (n, n), N m s/rad.
        stiffness: of hand and joints, (n, n), N m/rad.
        lag: of the controller, `Compensation.lag`, s.
        hand: inertia in addition to the model's, the hand's or a payload's, (n, n); None for none.

    Returns:
        The bound; above 1 where the hand's own inertia would allow more, which a share never needs.
    """
    inertia, damping, stiffness = (np.asarray(x, dtype=float) for x in (inertia, damping, stiffness))
    hand = np.zeros_like(inertia) if hand is None else np.asarray(hand, dtype=float)
    for name, x in (("damping", damping), ("stiffness", stiffness), ("hand", hand)):
        expect(name, x.shape, inertia.shape)
    least = float(linalg.eigh(hand, inertia, eigvals_only=True)[0])
    if not stiffness.any():
        return 1 + least
    if np.linalg.eigvalsh(damping)[0] <= 0:
        return 0.0
    stiffest = float(linalg.eigh(stiffness, damping, eigvals_only=True)[-1])
    return (1 + least) / (1 + lag * max(stiffest, 0.0))


def friction_parameters(model: DynamicModel, raw: Array) -> Array:
    """Those of the core's parameters that are friction, others zero, (r,)."""
    resists = [False] * (10 * len(model.device.joints)) + [term.resists for term in model.terms]
    return np.where(resists, raw, 0.0)


def static_stiffness(model: DynamicModel, beta: Array, q: Array) -> Array:
    """Derivative of gravity and springs by the coordinates at a pose, (active, active): symmetric, as of an energy."""
    n = len(q)
    near = q + _STEP * np.linalg.inv(model.device.row_map)[:, [*range(n), *range(n)]] * np.repeat([1, -1], n)
    tau = inverse_dynamics(model, beta, near, np.zeros_like(near), np.zeros_like(near))
    slope = (tau[:, :n] - tau[:, n:]) / (2 * _STEP)
    return np.asarray((slope + slope.T) / 2)


class _Controller:
    """The controller's state between control periods."""

    def __init__(self, settings: Compensation, dt: float) -> None:
        model = settings.identified.model
        self.settings, self.model, self.dt = settings, model, dt
        self.velocity_pole, self.momentum_pole = settings.keeps(dt)
        raw = raw_parameters(model, settings.identified.beta)
        self.bodies = rigid(model, raw)
        self.friction = friction_parameters(model, raw)
        self.soft = smoothed_friction(model, settings.slow)
        self.to_joints = np.linalg.inv(model.device.row_map)
        self.last: Array | None = None
        self.velocity = np.zeros((len(model.device.active), 1))
        self.momentum = np.zeros((len(model.device.active), 1))

    def step(self, _t: float, qa: Array) -> Array:
        """Torque of the motors' coordinates, (motors,), N m or N."""
        settings, c = self.settings, self.model.device.row_map @ np.asarray(qa, dtype=float)[:, None]
        if self.last is not None:
            difference = (c - self.last) / self.dt
            self.velocity = self.velocity_pole * self.velocity + (1 - self.velocity_pole) * difference
        self.last = c
        p, _ = core_momentum(self.model, self.bodies, c, self.velocity)
        rate = (1 - self.momentum_pole) / self.dt * (p - self.momentum)
        self.momentum = self.momentum + self.dt * rate
        share = settings.share_at(self.to_joints @ c)
        tau = share * rate + settings.weight * self._static(c) + settings.friction * self._friction(c)
        if settings.damping:
            J = handle_motion(self.model, self.to_joints @ c).row_jacobian[0, :3]
            tau -= settings.damping * J.T @ (J @ self.velocity)
        shares = self.model.device.law.shares(self.model.device.drive_jacobian(c))
        return freeze(((shares[0] if shares.ndim == 3 else shares) @ tau)[self.model.device.driven, 0])

    def _static(self, c: Array) -> Array:
        """Static torque, (active, 1): gravity, springs, offsets."""
        qa = self.to_joints @ c
        still = np.zeros_like(qa)
        return inverse_dynamics(self.model, self.settings.identified.beta, qa, still, still)

    def _friction(self, c: Array) -> Array:
        """Friction at this velocity, (active, 1), no dry friction at rest."""
        still = np.zeros_like(c)
        own = external(self.soft, c, self.velocity, still)
        return core_torque(self.soft, self.friction, c, self.velocity, still, own)
