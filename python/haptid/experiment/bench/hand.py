"""What a hand feels of a device on the bench: the hand guides the handle to and fro along a line, and measures.

The hand is a spring and a damper, which the bench's controller plays: its torques, taken to the handle, are the force
that the hand exerts. Along the line that force is mass * acceleration + damping * velocity + friction * sign(velocity)
+ weight + slope * way, whose five figures are fitted by least squares. Two sines tell mass and slope apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation.velocity_forces import drift
from haptid.experiment.bench.setup import Setup, TorqueLaw
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory

# Samples slower than this share of the greatest speed are left out: there friction is not its full size.
FAST = 0.5
# A hand feels what is faster as a vibration, Hz.
VIBRATION_HZ = 50.0


@dataclass(frozen=True)
class Felt:
    """What the hand feels along a line.

    Attributes:
        mass: kg.
        damping: N s/m.
        friction: dry, N.
        weight: force that holds the handle in the middle of the line, N.
        slope: by which the weight grows along the line, N/m.
        roughness: of the law's own force, what is faster than a hand can follow, rms, N.
    """

    mass: float
    damping: float
    friction: float
    weight: float
    slope: float
    roughness: float


@dataclass(frozen=True)
class Stroke:
    """A motion of the hand along a line: a sine, and one of thrice its frequency and a quarter of its amplitude.

    Attributes:
        amplitude: of the first sine, m.
        frequency_hz: of it.
        seconds: how long; the first period is left out.
    """

    amplitude: float = 0.03
    frequency_hz: float = 1.0
    seconds: float = 4.0


def feel(
    setup: Setup, pose: Array, direction: Array, law: TorqueLaw | None = None, stroke: Stroke | None = None
) -> Felt:
    """Guide the handle to and fro along a line, and fit what the hand must do for it.

    Args:
        setup: the device, and the hand as its controller.
        pose: of the active joints, in the middle of the line, (active,), rad or m.
        direction: of the line in the base frame, (3,), of length one.
        law: what the motors do meanwhile.
        stroke: how the hand moves; the default one where None.

    Raises:
        ExperimentError, SimulationError: one class for each cause.
    """
    stroke = stroke or Stroke()
    given = _Told(law) if law is not None else None
    trajectory = _line(setup, pose, direction, stroke)
    made = simulate(replace(setup, law=given), trajectory, np.random.default_rng(0))
    begin = round(1 / (stroke.frequency_hz * setup.dt))
    own = np.array(given.told) if given is not None else np.zeros_like(made.torque)
    model, active = setup.model, list(setup.model.device.active)
    qa, qda, qdda = (x[begin:, active].T for x in (made.q, made.qd, made.qdd))
    moved, middle = handle_motion(model, qa), handle_motion(model, np.asarray(pose, dtype=float)[:, None])
    J = moved.jacobian[:, :3]
    v = np.einsum("nij,jn->ni", J, qda) @ direction
    a = (np.einsum("nij,jn->ni", J, qdda) + drift(model, qa, qda)[:, :3]) @ direction
    way = (moved.position - middle.position) @ direction
    fast = np.abs(v) > FAST * np.abs(v).max()
    columns = np.column_stack([a, v, np.sign(v), np.ones(len(v)), way])[fast]
    force = _along(setup, J, (made.torque - own)[begin:], direction)
    fitted = np.linalg.lstsq(columns, force[fast], rcond=None)[0]
    rough = signal.sosfiltfilt(_high(setup.dt), _along(setup, J, own[begin:], direction))
    return Felt(*map(float, (*fitted, np.sqrt(np.mean(rough**2)))))


def _along(setup: Setup, J: Array, torque: Array, direction: Array) -> Array:
    """Force at the handle along a line that motors' torques make, (samples,), N."""
    model = setup.model
    driven = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
    force = np.linalg.pinv(J.mT) @ (torque @ model.device.coupling[driven])[:, :, None]
    return np.asarray(force[:, :, 0] @ direction)


def _high(dt: float) -> Array:
    """Second-order sections of a high-pass."""
    return np.asarray(signal.butter(2, VIBRATION_HZ, "high", fs=1 / dt, output="sos"))


def _line(setup: Setup, pose: Array, direction: Array, stroke: Stroke) -> Trajectory:
    """A sine of the handle along a line, from rest; the joints by the Jacobian in its middle."""
    t = setup.dt * np.arange(round(stroke.seconds / setup.dt))
    omega = 2 * np.pi * stroke.frequency_hz
    J = handle_motion(setup.model, np.asarray(pose, dtype=float)[:, None]).jacobian[0, :3]
    along = np.linalg.pinv(J) @ direction * stroke.amplitude
    # Grows from nothing in the first period: no jump at the start.
    rise = np.clip(omega * t / (2 * np.pi), 0.0, 1.0)
    size = rise**3 * (10 - 15 * rise + 6 * rise**2)
    s = size * (np.sin(omega * t) + 0.25 * np.sin(3 * omega * t))
    se = np.gradient(s, setup.dt)
    return Trajectory(
        setup.dt, pose + np.outer(s, along), np.outer(se, along), np.outer(np.gradient(se, setup.dt), along)
    )


class _Told:
    """A law that keeps what it gave."""

    def __init__(self, law: TorqueLaw) -> None:
        self.law, self.told = law, list[Array]()

    def begin(self, dt: float) -> Callable[[float, Array], Array]:
        step = self.law.begin(dt)

        def kept(t: float, qa: Array) -> Array:
            self.told.append(step(t, qa))
            return self.told[-1]

        return kept
