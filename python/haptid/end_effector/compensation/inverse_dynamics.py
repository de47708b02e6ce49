"""Inverse-dynamics control (computed torque) about a planned motion, as a law that can be judged in a hand.

    tau = M(q) (qdd_d + 2 zeta w (qd_d - v) + w^2 (q_d - q)) + c(q, v) + g(q) + share friction(qd_d),

v the measured velocity behind a filter, which the planned velocity passes too so that its lag cancels (Siciliano,
Sciavicco, Villani and Oriolo 2009, Robotics, section 8.5.2). Friction is fed forward by the planned velocity, so it
closes no loop. Where the model is correct the error obeys e'' + 2 zeta w e' + w^2 e = J' F / M: the hand feels the mass
unchanged with a damper 2 zeta w M and a spring w^2 M.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from haptid._internal.arrays import Array, freeze, positive
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import core_torque, mass_matrix, raw_parameters
from haptid.dynamics.kinematics import handle_motion, handle_of
from haptid.dynamics.regressor import external
from haptid.end_effector.characterisation.friction import viscous_matrix
from haptid.end_effector.characterisation.model import IdentifiedModel
from haptid.end_effector.compensation.law import friction_parameters, static_stiffness
from haptid.end_effector.compensation.sampled import Feedback, SampledLoop, filtered_difference
from haptid.errors import setting_error
from haptid.observation.reversals import smoothed_friction

# From time to planned positions, velocities and accelerations of the active joints, (active,) each.
_Plan = Callable[[float], tuple[Array, Array, Array]]


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """Inverse-dynamics control from a model.

    Attributes:
        identified: an estimate, or given parameters.
        natural_hz: natural frequency w / 2 pi of the tracking error.
        damping_ratio: zeta of the tracking error.
        velocity_cutoff_hz: of the first-order filter on position differences.
        friction: share of friction that is fed forward by the planned velocity, 0 to 1.
        slow: speed scale of dry friction, tanh(rate / slow), rad/s or m/s.
        plan: the planned motion; None holds the first position that is measured.
    """

    identified: IdentifiedModel
    natural_hz: float = 5.0
    damping_ratio: float = 1.0
    velocity_cutoff_hz: float = 100.0
    friction: float = 0.0
    slow: float = 0.05
    plan: _Plan | None = None

    def __post_init__(self) -> None:
        handle_of(self.identified.model)
        for name in ("natural_hz", "damping_ratio", "velocity_cutoff_hz", "slow"):
            if not positive(getattr(self, name)):
                raise setting_error(name, getattr(self, name), "a finite number above 0")
        if not 0 <= self.friction <= 1:
            raise setting_error("friction", self.friction, "0 to 1")

    @property
    def friction_taken(self) -> float:
        """Share of dry friction that a hand does not feel: none, since friction follows the plan."""
        return 0.0

    @property
    def gains(self) -> tuple[float, float]:
        """w^2 and 2 zeta w, 1/s^2 and 1/s."""
        w = 2 * np.pi * self.natural_hz
        return w**2, 2 * self.damping_ratio * w

    def loop(self, qa: Array, dt: float, delay: float = 0.0) -> SampledLoop:
        """Device and law at rest at a planned pose, linear, by the model itself; dry friction is left out.

        Args:
            qa: positions of the active joints, (active,), rad or m.
            dt: control period, s.
            delay: from reading positions to the torque, s.
        """
        model, beta, q = self.identified.model, self.identified.beta, np.asarray(qa, dtype=float)[:, None]
        A, K = mass_matrix(model, beta, q)[0], static_stiffness(model, beta, q)
        stiff, damped = self.gains
        top, bottom = filtered_difference(self.velocity_cutoff_hz, dt)
        parts = (Feedback(stiff * A - K, (1.0,)), Feedback(damped * A, tuple(top), tuple(bottom)))
        J = handle_motion(model, q).row_jacobian[0, :3]
        return SampledLoop(A, viscous_matrix(model, beta, q)[0], K, J, parts, dt, delay)

    def begin(self, dt: float) -> Callable[[float, Array], Array]:
        """The controller, starting from rest, to be called once every control period.

        Args:
            dt: control period, s.
        """
        return _Controller(self, dt).step


class _Controller:
    """The controller's state between control periods, in the coordinates of the torque rows."""

    def __init__(self, settings: InverseDynamics, dt: float) -> None:
        model = settings.identified.model
        self.settings, self.model, self.dt = settings, model, dt
        self.pole = float(np.exp(-2 * np.pi * settings.velocity_cutoff_hz * dt))
        raw = raw_parameters(model, settings.identified.beta)
        self.friction = friction_parameters(model, raw)
        self.rest = raw - self.friction
        self.soft = smoothed_friction(model, settings.slow)
        self.held: Array | None = None
        self.last: Array | None = None
        self.velocity = np.zeros((len(model.device.active), 2))

    def step(self, t: float, qa: Array) -> Array:
        """Torque of the motors' coordinates, (motors,), N m or N."""
        settings, device = self.settings, self.model.device
        q = np.asarray(qa, dtype=float)
        self.held = q if self.held is None else self.held
        planned = settings.plan(t) if settings.plan else (self.held, 0 * q, 0 * q)
        target, rate, acceleration = (device.row_map @ np.asarray(x, dtype=float)[:, None] for x in planned)
        c = device.row_map @ q[:, None]
        both = np.hstack([c, target])
        if self.last is not None:
            self.velocity = self.pole * self.velocity + (1 - self.pole) / self.dt * (both - self.last)
        self.last = both
        stiff, damped = settings.gains
        measured = self.velocity[:, :1]
        wanted = acceleration + damped * (self.velocity[:, 1:] - measured) + stiff * (target - c)
        tau = core_torque(self.model, self.rest, c, measured, wanted, external(self.model, c, measured, wanted))
        own = external(self.soft, c, rate, 0 * rate)
        tau = tau + settings.friction * core_torque(self.soft, self.friction, c, rate, 0 * rate, own)
        shares = device.law.shares(device.drive_jacobian(c))
        return freeze(((shares[0] if shares.ndim == 3 else shares) @ tau)[device.driven, 0])
