"""A law of control that takes part of a device's own mass, weight and friction off the hand.

The motors' torque is

    tau = share dp/dt + weight * gravity torque + friction * friction torque,   p = A(q) qd,

with dp/dt from the momentum through one low-pass filter: positions are differentiated once, and no acceleration is
needed. The hand then feels (1 - share) M where the model is right, below the frequency of the filters.

One share leaves the ratio of masses from pose to pose as it is. Towards a mass m0, the share depends on the pose,

    share(q) = 1 - m0 / m(q), at least 0 and at most the share that is set,

m the largest principal mass at the handle: the hand feels m0 wherever neither limit is met. Forces that grow with the
square of speed are scaled with the mass, no matter that they are not those of a body whose mass is the same everywhere.

Stability. All lags are one delay T in the first order (`Compensation.lag`). For a motion with inertia a, of which the
hand's own part h is not compensated, held with stiffness k and damping b (of the hand and of the joints), the loop is

    share a T s^3 + (a + h - share a) s^2 + b s + k = 0,

stable where (a + h - share a) b > share a T k (Routh), that is

    share < (1 + h / a) / (1 + T k / b).

The same holds of any number of joints at a pose, each quantity being a quadratic form of the mode: the bound with the
least h / a and the largest k / b is enough. Torque of momentum vanishes at rest, so a share that depends on the pose is
bound by the same, pose by pose: m0 > (1 - bound(q)) m(q). A free handle, k = 0, leaves share < 1 (and with a model
that has too much mass, less by that much). Dynamics beyond these lags, such as a handle on a soft structure, is not in
it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, expect, freeze, positive
from haptid.device.terms.term import LoadDependentFriction
from haptid.dynamics.inverse import core_momentum, core_torque, inverse_dynamics, raw_parameters, rigid
from haptid.dynamics.kinematics import handle_of
from haptid.dynamics.regressor import external
from haptid.end_effector.characterisation.apparent_mass import apparent_mass
from haptid.end_effector.characterisation.model import GivenParameters, IdentifiedModel
from haptid.errors import CompensationSettingError
from haptid.observation.reversals import softened

# From the time since the start, s, and measured positions of the active joints, (active,), to torques of the motors'
# coordinates, (motors,), N m or N.
Step = Callable[[float, Array], Array]


@dataclass(frozen=True, eq=False)
class Compensation:
    """Compensation of mass, weight and friction from a model.

    Attributes:
        identified: an estimate, or given parameters.
        share: of the mass that is taken off, 0 to below 1; the most of it where `towards` is given.
        weight: share of gravity, springs and offsets that motors carry, 0 to 1.
        friction: share of friction that motors overcome, 0 to 1; stay below what is surely there.
        slow: speed below which dry friction is taken off in part only, tanh(rate / slow): at rest none, so that nothing
            is pushed that the hand does not push, rad/s or m/s.
        velocity_cutoff_hz: of the first-order filter on differences of the position.
        momentum_cutoff_hz: of the filter on the change of momentum.
        towards: largest principal mass that is to be left at every pose, kg; None for the same share everywhere.
    """

    identified: IdentifiedModel
    share: float = 0.5
    weight: float = 1.0
    friction: float = 0.0
    slow: float = 0.05
    velocity_cutoff_hz: float = 100.0
    momentum_cutoff_hz: float = 60.0
    towards: float | None = None

    def __post_init__(self) -> None:
        for name in ("share", "weight", "friction"):
            if not 0 <= getattr(self, name) <= 1 or (name == "share" and self.share == 1):
                raise CompensationSettingError(name, getattr(self, name), f"0 to {'below ' * (name == 'share')}1")
        for name in ("slow", "velocity_cutoff_hz", "momentum_cutoff_hz"):
            if not positive(getattr(self, name)):
                raise CompensationSettingError(name, getattr(self, name), "a finite number above 0")
        for term in self.identified.model.terms if self.friction else ():
            if isinstance(term.shape, LoadDependentFriction):
                wanted = f"0: term {term.name} needs accelerations, which a law does not have"
                raise CompensationSettingError("friction", self.friction, wanted)
        if self.towards is not None:
            handle_of(self.identified.model)
            if not positive(self.towards):
                raise CompensationSettingError("towards", self.towards, "a mass above 0 kg, or None")

    def share_at(self, qa: Array) -> Array:
        """Share of the mass that is taken off at poses, (poses,).

        Near a singular pose some mass is beyond measure: there it is the most.

        Args:
            qa: positions of the active joints, (active, poses), rad or m.
        """
        if self.towards is None:
            return freeze(np.full(qa.shape[1], self.share))
        mass = apparent_mass(GivenParameters(self.identified.model, self.identified.beta), qa).mass.value[:, 0]
        wanted = 1 - self.towards / np.where(np.isfinite(mass), mass, np.inf)
        return freeze(np.clip(wanted, 0.0, self.share))

    def begin(self, dt: float) -> Step:
        """The law from rest, called once every control period.

        Args:
            dt: control period, s.
        """
        return _Law(self, dt).step

    def lag(self, dt: float, delay: float = 0.0) -> float:
        """T: lags of two differences, two filters, the amplifiers, and torque that is held for a period, s.

        Args:
            dt: control period, s.
            delay: from reading positions to the torque, s.
        """
        filters = sum(dt * keep / (1 - keep) for keep in self.keeps(dt))
        return 3 * dt / 2 + filters + delay

    def keeps(self, dt: float) -> tuple[float, float]:
        """What the filters of velocity and momentum keep of themselves from one period to the next."""
        cutoffs = (self.velocity_cutoff_hz, self.momentum_cutoff_hz)
        return (float(np.exp(-2 * np.pi * cutoffs[0] * dt)), float(np.exp(-2 * np.pi * cutoffs[1] * dt)))

    def passed(self, frequency_hz: float, dt: float, delay: float = 0.0) -> complex:
        """What the lags leave of a motion's acceleration at a frequency: the hand feels (1 - share * this) M.

        Args:
            frequency_hz: of the motion.
            dt, delay: as in `lag`.
        """
        turn = np.exp(-2j * np.pi * frequency_hz * dt)
        filters = np.prod([(1 - keep) / (1 - keep * turn) for keep in self.keeps(dt)])
        late = np.exp(-2j * np.pi * frequency_hz * (3 * dt / 2 + delay))
        # Two differences and a hold: each half a period late, and flatter by a sinc.
        return complex(filters * late * np.sinc(frequency_hz * dt) ** 3)


def stable_share(inertia: Array, damping: Array, stiffness: Array, lag: float, hand: Array | None = None) -> float:
    """Share of mass below which compensation is stable at a pose: (1 + h / a) / (1 + T k / b), worst motion.

    Args:
        inertia: of the device, (n, n), kg m^2.
        damping: of hand and joints, (n, n), N m s/rad.
        stiffness: of hand and joints, (n, n), N m/rad.
        lag: of the law, `Compensation.lag`, s.
        hand: inertia beside the model's, the hand's or a payload's, (n, n); None for none.

    Returns:
        The bound. Above 1 it says that the hand's own inertia would hold more, which a share never needs.
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


class _Law:
    """The law at work: what it remembers from one period to the next."""

    def __init__(self, settings: Compensation, dt: float) -> None:
        model = settings.identified.model
        self.settings, self.model, self.dt = settings, model, dt
        self.keep_velocity, self.keep_momentum = settings.keeps(dt)
        raw = raw_parameters(model, settings.identified.beta)
        self.bodies = rigid(model, raw)
        resists = [False] * (10 * len(model.device.joints)) + [term.resists for term in model.terms]
        self.rubbing = np.where(resists, raw, 0.0)
        self.soft = softened(model, settings.slow)
        self.to_joints = np.linalg.inv(model.device.row_map)
        self.to_motors = np.linalg.inv(model.device.drive_rates).T[[drive.motorised for drive in model.device.drives]]
        self.last: Array | None = None
        self.velocity = np.zeros((len(model.device.active), 1))
        self.late = np.zeros((len(model.device.active), 1))

    def step(self, _t: float, qa: Array) -> Array:
        """Torque of the motors' coordinates, (motors,), N m or N."""
        settings, c = self.settings, self.model.device.row_map @ np.asarray(qa, dtype=float)[:, None]
        if self.last is not None:
            difference = (c - self.last) / self.dt
            self.velocity = self.keep_velocity * self.velocity + (1 - self.keep_velocity) * difference
        self.last = c
        p, _ = core_momentum(self.model, self.bodies, c, self.velocity)
        change = (1 - self.keep_momentum) / self.dt * (p - self.late)
        self.late = self.late + self.dt * change
        share = settings.share_at(self.to_joints @ c)
        tau = share * change + settings.weight * self._resting(c) + settings.friction * self._rubbing(c)
        return freeze((self.to_motors @ tau)[:, 0])

    def _resting(self, c: Array) -> Array:
        """Torque that holds the device still, (active, 1): gravity, springs, offsets."""
        qa = self.to_joints @ c
        still = np.zeros_like(qa)
        return inverse_dynamics(self.model, self.settings.identified.beta, qa, still, still)

    def _rubbing(self, c: Array) -> Array:
        """Friction of this velocity, (active, 1), none of it dry at rest."""
        still = np.zeros_like(c)
        own = external(self.soft, c, self.velocity, still)
        return core_torque(self.soft, self.rubbing, c, self.velocity, still, own)
