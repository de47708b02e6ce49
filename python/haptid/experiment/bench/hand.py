"""Apparent mass, damping, friction and weight at the handle, measured on the bench along a line.

The bench controller acts as the hand, a spring and a damper that guides the handle back and forth; its torques,
transformed to the handle, are the hand force. Along the line that force is mass * acceleration + damping * velocity
+ friction * sign(velocity) + weight + slope * displacement, fitted by least squares. Two sine frequencies make mass and
slope distinguishable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation.velocity_forces import velocity_product_acceleration
from haptid.experiment.bench.setup import Setup, TorqueLaw
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory

# Samples slower than this share of the maximum speed are left out: friction is not fully developed there.
_FAST = 0.5
# Frequency above which a force is felt as vibration, Hz.
VIBRATION_HZ = 50.0


@dataclass(frozen=True)
class HandleImpedance:
    """Mechanical impedance at the handle along a line.

    Attributes:
        mass: apparent mass (Khatib's effective mass), kg.
        damping: N s/m.
        friction: dry friction, N.
        weight: static force in the middle of the line, N.
        slope: change of the weight along the line, N/m.
        roughness: rms of the control law's force above VIBRATION_HZ, N.
    """

    mass: float
    damping: float
    friction: float
    weight: float
    slope: float
    roughness: float


@dataclass(frozen=True)
class Stroke:
    """Motion of the hand along a line: a sine plus its third harmonic with a quarter of the amplitude.

    Attributes:
        amplitude: of the first sine, m.
        frequency_hz: of the first sine.
        seconds: duration; the first period is left out of the fit.
    """

    amplitude: float = 0.03
    frequency_hz: float = 1.0
    seconds: float = 4.0


def measure_impedance(
    setup: Setup, pose: Array, direction: Array, law: TorqueLaw | None = None, stroke: Stroke | None = None
) -> HandleImpedance:
    """Guide the handle back and forth along a line, and fit the hand force.

    Args:
        setup: the device, with the hand as its controller.
        pose: of the active joints in the middle of the line, (active,), rad or m.
        direction: of the line in the base frame, (3,), unit vector.
        law: control law of the motors during the motion; None for none.
        stroke: motion of the hand; the default one where None.

    Raises:
        ExperimentError, SimulationError: one class for each cause.
    """
    from scipy import signal  # slow to import, and few simulations have code in the loop

    stroke = stroke or Stroke()
    given = _Recorded(law) if law is not None else None
    trajectory = _line(setup, pose, direction, stroke)
    made = simulate(replace(setup, law=given), trajectory, np.random.default_rng(0))
    begin = round(1 / (stroke.frequency_hz * setup.dt))
    own = np.array(given.torques) if given is not None else np.zeros_like(made.torque)
    model, active = setup.model, list(setup.model.device.active)
    qa, qda, qdda = (x[begin:, active].T for x in (made.q, made.qd, made.qdd))
    moved, middle = handle_motion(model, qa), handle_motion(model, np.asarray(pose, dtype=float)[:, None])
    J = moved.jacobian[:, :3]
    v = np.einsum("nij,jn->ni", J, qda) @ direction
    a = (np.einsum("nij,jn->ni", J, qdda) + velocity_product_acceleration(model, qa, qda)[:, :3]) @ direction
    displacement = (moved.position - middle.position) @ direction
    fast = np.abs(v) > _FAST * np.abs(v).max()
    columns = np.column_stack([a, v, np.sign(v), np.ones(len(v)), displacement])[fast]
    force = _along(setup, qa, J, (made.torque - own)[begin:], direction)
    fitted = np.linalg.lstsq(columns, force[fast], rcond=None)[0]
    high_pass = signal.butter(2, VIBRATION_HZ, "high", fs=1 / setup.dt, output="sos")
    vibration = signal.sosfiltfilt(high_pass, _along(setup, qa, J, own[begin:], direction))
    return HandleImpedance(*map(float, (*fitted, np.sqrt(np.mean(vibration**2)))))


def _along(setup: Setup, qa: Array, J: Array, torque: Array, direction: Array) -> Array:
    """Force of motor torques at the handle along a line, (samples,), N."""
    device = setup.model.device
    on_joints = device.row_map.T @ device.row_torque(device.row_map @ qa, torque.T)
    force = np.linalg.pinv(J.mT) @ on_joints.T[:, :, None]
    return np.asarray(force[:, :, 0] @ direction)


def _line(setup: Setup, pose: Array, direction: Array, stroke: Stroke) -> Trajectory:
    """Joint trajectory of the stroke, from rest, by the Jacobian in the middle of the line."""
    t = setup.dt * np.arange(round(stroke.seconds / setup.dt))
    omega = 2 * np.pi * stroke.frequency_hz
    J = handle_motion(setup.model, np.asarray(pose, dtype=float)[:, None]).jacobian[0, :3]
    along = np.linalg.pinv(J) @ direction * stroke.amplitude
    # Faded in over the first period, so that there is no step at the start.
    rise = np.clip(omega * t / (2 * np.pi), 0.0, 1.0)
    window = rise**3 * (10 - 15 * rise + 6 * rise**2)
    s = window * (np.sin(omega * t) + 0.25 * np.sin(3 * omega * t))
    ds = np.gradient(s, setup.dt)
    return Trajectory(
        setup.dt, pose + np.outer(s, along), np.outer(ds, along), np.outer(np.gradient(ds, setup.dt), along)
    )


class _Recorded:
    """A control law that records its torques."""

    def __init__(self, law: TorqueLaw) -> None:
        self.law, self.torques = law, list[Array]()

    def begin(self, dt: float) -> Callable[[float, Array], Array]:
        step = self.law.begin(dt)

        def recorded(t: float, qa: Array) -> Array:
            self.torques.append(step(t, qa))
            return self.torques[-1]

        return recorded
