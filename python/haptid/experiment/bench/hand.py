"""Felt mass, damping, stiffness, friction and weight at the handle, measured on the bench along a line.

A stiff hand moves the handle to and fro. Its force along the line is

    mass * acceleration + damping * velocity + friction * sign(velocity) + weight + stiffness * displacement,

fitted by least squares after force and columns have passed the same low-pass filter. Without it a controller's encoder
vibration enters the fit, and at the vibration's frequency the ratio of force and acceleration is that of the hand and
not of the device. Two sine frequencies distinguish mass from stiffness; a single one takes the stiffness as given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation.velocity_forces import velocity_product_acceleration
from haptid.end_effector.compensation.hands import HandModel
from haptid.errors import ExperimentError
from haptid.experiment.bench.setup import Controller, Hand, Recording, Setup, TorqueLaw
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory
from haptid.uncertainty.quantities import Quantities

# Samples slower than this share of the maximum speed are left out: friction is not fully developed there.
_FAST = 0.5
# Cutoff of the fit's filter, in multiples of the highest frequency of the stroke.
_BAND = 4.0
# Frequency above which a force is felt as vibration, Hz.
VIBRATION_HZ = 50.0
# A hand that guides: stiff, so that the handle stays on the line.
GUIDE = HandModel(0.2, 60.0, 3000.0, 60.0, 5000.0)
_NAMES = ("mass", "damping", "friction", "weight", "stiffness", "power")
_UNITS = ("kg", "N s/m", "N", "N", "N/m", "W")


@dataclass(frozen=True, eq=False)
class HandleImpedance:
    """Mechanical impedance at the handle along a line.

    Attributes:
        frequency_hz: of the stroke.
        quantities: mass (Khatib's effective mass), damping, dry friction, weight in the middle of the line, stiffness,
            and the mean power that the hand gets, with intervals by leaving out one period after the other (jackknife);
            a stiffness that was given has no error.
        roughness: rms of the motors' force above VIBRATION_HZ, N.
    """

    frequency_hz: float
    quantities: Quantities
    roughness: float

    def _value(self, name: str) -> float:
        return float(self.quantities.values[_NAMES.index(name)])

    @property
    def mass(self) -> float:
        """Apparent mass, kg."""
        return self._value("mass")

    @property
    def damping(self) -> float:
        """Viscous damping, N s/m."""
        return self._value("damping")

    @property
    def friction(self) -> float:
        """Dry friction, N."""
        return self._value("friction")

    @property
    def weight(self) -> float:
        """Static force in the middle of the line, N."""
        return self._value("weight")

    @property
    def stiffness(self) -> float:
        """Change of the static force along the line, N/m."""
        return self._value("stiffness")

    @property
    def power(self) -> float:
        """Mean power that the hand gets, W; negative where it gives."""
        return self._value("power")


@dataclass(frozen=True)
class Stroke:
    """Motion of the hand along a line: a sine plus its third harmonic.

    Attributes:
        amplitude: of the first sine, m.
        frequency_hz: of the first sine.
        seconds: duration; the first period is left out of the fit.
        third: amplitude of the third harmonic, share of the first; with 0 mass and stiffness are one, see
            `measure_impedance`.
        hand: that guides the handle.
    """

    amplitude: float = 0.015
    frequency_hz: float = 2.0
    seconds: float = 3.0
    third: float = 0.25
    hand: HandModel = GUIDE


def measure_impedance(
    setup: Setup,
    pose: Array,
    direction: Array,
    law: TorqueLaw | None = None,
    stroke: Stroke | None = None,
    stiffness: float = 0.0,
) -> HandleImpedance:
    """Guide the handle back and forth along a line, and fit the hand force.

    Args:
        setup: the device; the law replaces its controller.
        pose: of the active joints in the middle of the line, (active,), rad or m.
        direction: of the line in the base frame, (3,), unit vector.
        law: control law of the motors during the motion; None for none.
        stroke: motion of the hand; the default one where None.
        stiffness: taken as given where the stroke has no third harmonic, N/m.

    Raises:
        ExperimentError: a stroke of less than two periods.
        SimulationError: one class for each cause.
    """
    stroke = stroke or Stroke()
    if stroke.seconds * stroke.frequency_hz < 2 - 1e-9:
        raise ExperimentError(
            f"the stroke has {stroke.seconds * stroke.frequency_hz:g} periods; the first one is left out of the fit.",
            where="seconds",
            found=stroke.seconds,
            limit=2 / stroke.frequency_hz,
            advice="Give it a duration of two periods or more.",
        )
    return impedance_of(setup, guided(setup, pose, direction, law, stroke), pose, direction, stroke, stiffness)


def impedance_of(
    setup: Setup, made: Recording, pose: Array, direction: Array, stroke: Stroke, stiffness: float = 0.0
) -> HandleImpedance:
    """The impedance from a recording of `guided`; arguments as of `measure_impedance`."""
    force, v, a, displacement = along_line(setup, made, pose, direction)
    columns = np.column_stack([a, v, np.sign(v), np.ones(len(v)), displacement])
    known = 0.0 if stroke.third else stiffness
    values = _filtered(setup.dt, stroke, np.column_stack([force - known * displacement, columns]))
    period = round(1 / (stroke.frequency_hz * setup.dt))
    kept = slice(period, len(v) // period * period)
    power = -np.einsum("ni,ni->n", made.hand, _velocity(setup, made))[kept]
    return HandleImpedance(
        stroke.frequency_hz,
        _fitted(values[kept], np.abs(v[kept]), power, period, None if stroke.third else stiffness),
        _roughness(setup, made, direction, period),
    )


def impedance_curve(
    setup: Setup,
    pose: Array,
    direction: Array,
    frequencies_hz: Sequence[float],
    law: TorqueLaw | None = None,
    speed: float = 0.2,
    periods: int = 5,
    stiffness: float = 0.0,
) -> tuple[HandleImpedance, ...]:
    """Felt mass, damping, friction and power over frequency, at a given stiffness.

    Args:
        setup, pose, direction, law: as of `measure_impedance`.
        frequencies_hz: of the strokes.
        speed: amplitude of the speed of the hand's place, m/s.
        periods: of each stroke, the first one is left out.
        stiffness: N/m; none is left where a law carries the weight.
    """
    strokes = [Stroke(speed / (2 * np.pi * f), f, periods / f, 0.0) for f in frequencies_hz]
    return tuple(measure_impedance(setup, pose, direction, law, stroke, stiffness) for stroke in strokes)


def guided(setup: Setup, pose: Array, direction: Array, law: TorqueLaw | None, stroke: Stroke) -> Recording:
    """The device under a law alone while a hand moves its handle."""
    x, y, z = np.asarray(direction, dtype=float).tolist()
    hand = Hand(stroke.hand, (x, y, z), stroke.amplitude, stroke.frequency_hz, stroke.third)
    off = Controller((0.0,), (0.0,), rate_hz=setup.controller.rate_hz, tracking_limit=np.inf)
    q = np.tile(np.asarray(pose, dtype=float), (round(stroke.seconds / setup.dt), 1))
    released = replace(setup, controller=off, law=law, hand=(), held=hand)
    return simulate(released, Trajectory(setup.dt, q, 0 * q, 0 * q), np.random.default_rng(0))


def along_line(setup: Setup, made: Recording, pose: Array, direction: Array) -> tuple[Array, Array, Array, Array]:
    """Force of the hand, velocity, acceleration and displacement of the handle along the line, (samples,) each."""
    model, active = setup.model, list(setup.model.device.active)
    qa, qda, qdda = (x[:, active].T for x in (made.q, made.qd, made.qdd))
    moved, middle = handle_motion(model, qa), handle_motion(model, np.asarray(pose, dtype=float)[:, None])
    J = moved.jacobian[:, :3]
    v = np.einsum("nij,jn->ni", J, qda) @ direction
    a = (np.einsum("nij,jn->ni", J, qdda) + velocity_product_acceleration(model, qa, qda)[:, :3]) @ direction
    return made.hand @ direction, v, a, (moved.position - middle.position) @ direction


def _velocity(setup: Setup, made: Recording) -> Array:
    """Velocity of the handle, (samples, 3), m/s."""
    active = list(setup.model.device.active)
    J = handle_motion(setup.model, made.q[:, active].T).jacobian[:, :3]
    return np.asarray(np.einsum("nij,nj->ni", J, made.qd[:, active]))


def _filtered(dt: float, stroke: Stroke, columns: Array) -> Array:
    """Columns through the fit's filter, forwards and backwards."""
    from scipy import signal  # slow to import, and few simulations have a hand

    highest = stroke.frequency_hz * (3 if stroke.third else 1)
    sections = signal.butter(2, min(_BAND * highest, 0.4 / dt), fs=1 / dt, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, columns, axis=0))


def _fitted(values: Array, speed: Array, power: Array, period: int, stiffness: float | None) -> Quantities:
    """Least squares over all periods, and the jackknife over them; values are force and columns, (samples, 6)."""
    fast, block = speed > _FAST * speed.max(), np.arange(len(values)) // period
    inner = slice(1, 6 if stiffness is None else 5)

    def solved(kept: np.ndarray) -> Array:
        used = kept & fast
        found = np.linalg.lstsq(values[used, inner], values[used, 0], rcond=None)[0]
        return np.array([*found, *(() if stiffness is None else (stiffness,)), power[kept].mean()])

    count = int(block[-1]) + 1
    covariance, unbounded = np.zeros((6, 6)), tuple(range(6))
    if count > 1:
        each = np.array([solved(block != k) for k in range(count)])
        away = each - each.mean(axis=0)
        covariance, unbounded = (count - 1) / count * away.T @ away, ()
    dof = np.full(6, max(count - 1, 1))
    return Quantities(_NAMES, _UNITS, solved(np.ones(len(values), dtype=bool)), covariance, dof, unbounded)


def _roughness(setup: Setup, made: Recording, direction: Array, begin: int) -> float:
    """Rms of the motors' force along the line above VIBRATION_HZ, N."""
    from scipy import signal

    device, active = setup.model.device, list(setup.model.device.active)
    qa = made.q[begin:, active].T
    on_joints = device.row_map.T @ device.row_torque(device.row_map @ qa, made.torque[begin:].T)
    J = handle_motion(setup.model, qa).jacobian[:, :3]
    force = (np.linalg.pinv(J.mT) @ on_joints.T[:, :, None])[:, :, 0] @ direction
    sections = signal.butter(2, VIBRATION_HZ, "high", fs=1 / setup.dt, output="sos")
    return float(np.sqrt(np.mean(signal.sosfiltfilt(sections, force) ** 2)))
