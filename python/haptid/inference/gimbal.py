"""Largest effect of an unmeasured passive gimbal at the handle, on the torque of the motors and on the parameters.

Its axes meet at the handle's origin and transmit force and friction, so whatever its orientation it acts like a point
mass there, except for the reaction of its own rotation. That is bounded along the recorded motion by the equation of a
pendulum on an accelerated pivot.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device import Gimbal
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.motion.channels import coordinates
from haptid.motion.motion import Motion

# Samples of each motion that are looked at, from its beginning.
_MOST = 100_000


@dataclass(frozen=True, eq=False)
class GimbalEffect:
    """Largest effect of a gimbal beyond that of a point mass at the handle.

    Attributes:
        gimbal: of the device.
        link: name of the link that carries it.
        motors, share: rms bound of the torque over the rms torque, per cent, (motors,).
        names, parameters: largest change of each base parameter, (p,), SI.
    """

    gimbal: Gimbal
    link: str
    motors: tuple[str, ...]
    share: Array
    names: tuple[str, ...]
    parameters: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "share", "parameters")

    @property
    def sentences(self) -> tuple[str, ...]:
        """The bound in words."""
        own = self.gimbal
        gimbal = f"The gimbal ({own.mass:g} kg, {own.state}, not measured)"
        if own.state == "locked":
            return (
                f"{gimbal} is in the parameters of link {self.link}; locked in another orientation its first moments "
                f"change by up to {own.mass * own.com_radius:.2g} kg m.",
            )
        shares = ", ".join(f"{share:.2g}" for share in self.share)
        return (
            f"{gimbal} acts as a point mass at the handle, in the parameters of link {self.link}. The reaction of its "
            f"own rotation is at most {shares} % of the torque of {', '.join(self.motors)} (rms); `result.json` has "
            "the largest change of each parameter by it, which is not in the intervals.",
        )


def gimbal_effect(estimate: Estimate) -> GimbalEffect | None:
    """The bound along the motions of an estimate; None where the device has no gimbal.

    By Cauchy and Schwarz c'(W'W)^-1 W'e is at most sqrt(c'(W'W)^-1 c) |e|, for rows e of the torque's bound.
    """
    model, observation = estimate.model, estimate.observation
    gimbal, handle = model.device.gimbal, model.device.handle
    if gimbal is None or handle is None:
        return None
    squares = np.mean([np.mean(torque_bound(model, motion) ** 2, axis=1) for motion in observation.motions], axis=0)
    own = [model.device.row_names.index(motor.name) for motor in observation.motors]
    rows = np.array([motor.rows.sum() for motor in observation.motors])
    norms = np.array([motor.size(estimate.beta) for motor in observation.motors])
    displaced = np.sqrt(squares[own] * rows)
    root = estimate.fit.solution.root
    unit = np.sqrt(np.einsum("pk,pk->p", root, root))
    return GimbalEffect(
        gimbal=gimbal,
        link=model.device.joints[handle.link].name if handle.link >= 0 else "base",
        motors=tuple(motor.label for motor in observation.motors),
        share=100 * np.divide(displaced, norms, out=np.full(len(own), np.inf), where=norms > 0),
        names=estimate.names,
        parameters=unit * np.linalg.norm(estimate.weights * displaced),
    )


def torque_bound(model: DynamicModel, motion: Motion) -> Array:
    """Largest torque of every row beyond that of a point mass at the handle, (rows, samples), N m or N."""
    return np.hstack([_torque_bound(model, motion, *part) for part in motion.usable_parts(_MOST)])


def _torque_bound(model: DynamicModel, motion: Motion, start: int, stop: int) -> Array:
    """The same of samples start..stop, without a gap."""
    gimbal = model.device.gimbal
    c, cd, _ = coordinates(model.device, motion, start, stop)
    if gimbal is None or gimbal.state == "locked":
        return np.zeros_like(c)
    moved = handle_motion(model, np.linalg.solve(model.device.row_map, c))
    linear, angular = moved.row_jacobian[:, :3], moved.row_jacobian[:, 3:]
    velocity = np.einsum("nij,jn->in", linear, cd)
    force = reaction_bound(gimbal, np.gradient(velocity, motion.dt, axis=1), model.device.gravity)
    return np.asarray(np.linalg.norm(linear, axis=1).T * force + np.linalg.norm(angular, axis=1).T * gimbal.friction)


def reaction_bound(gimbal: Gimbal, acceleration: Array, gravity: Array) -> Array:
    """Largest force of the gimbal's own rotation on the handle, (samples,), N.

    A body of mass m with its centre of mass at a distance l from a pivot with acceleration a turns with an angular
    acceleration of at most (m l |a - g| + M) / J, of a - g the part across l; the reaction is m l times that, and
    m l omega^2. Within an angle s of hanging, omega^2 is at most 2 s times the largest angular acceleration.

    Args:
        gimbal: hanging or free.
        acceleration: of the handle, (3, samples), m/s^2.
        gravity: in the same frame, (3,), m/s^2.
    """
    moment = gimbal.mass * gimbal.com_radius
    if not moment:
        return np.zeros(acceleration.shape[1])
    effective, g = moment**2 / gimbal.inertia, float(np.linalg.norm(gravity))
    friction = moment / gimbal.inertia * gimbal.friction
    if gimbal.state == "free":
        specific_force = np.linalg.norm(acceleration - gravity[:, None], axis=0)
        return np.asarray(effective * specific_force + moment * gimbal.rate**2 + friction)
    down = gravity / g if g else np.zeros(3)
    vertical = np.abs(down @ acceleration)
    level = np.linalg.norm(acceleration - np.outer(down, down @ acceleration), axis=0)
    swing = min(gimbal.swing, np.pi / 2)
    turning = effective * (level + (g + vertical) * np.sin(swing)) + friction
    return np.asarray(turning + 2 * gimbal.swing * turning.max())
