"""Exported code in the control loop of the bench: compensation, tracking and hand-force estimation, evaluated."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.kinematics import handle_motion
from haptid.experiment.bench.compiled_code import Compiled
from haptid.experiment.bench.controllers import Assistance, Tracking
from haptid.experiment.bench.hand import HandleImpedance, Stroke, measure_impedance
from haptid.experiment.bench.setup import Controller, Push, Recording, Setup
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory

# Gain of the momentum observer, rad/s, and its settling time, s.
_GAIN, SETTLING_TIME = 40.0, 0.3
# Duration of a tap on the handle, and of the free response after it, s.
TAP, FREE_RESPONSE = 0.03, 2.0
_AXES = np.eye(3)


@dataclass(frozen=True)
class InTheLoopResult:
    """Measured performance of exported code; see `simulate_in_the_loop`.

    Attributes:
        bare: impedance at the handle along the base axes at every pose, without compensation.
        assisted: the same with gravity and friction compensation.
        tracking_pd, tracking_model: tracking error of the handle, PD alone and with the model's feedforward, rms, m.
        force_bare, force_model: error of the hand force from motor torques alone and with the model, rms, N.
        restless: maximum speed of an active joint in the last half second after a tap, rad/s or m/s.
    """

    bare: tuple[HandleImpedance, ...]
    assisted: tuple[HandleImpedance, ...]
    tracking_pd: float
    tracking_model: float
    force_bare: float
    force_model: float
    restless: float

    @property
    def weight_left(self) -> float:
        """Weight that remains under gravity compensation, relative to that without, over all poses and axes."""
        return _norm(at.weight for at in self.assisted) / _norm(impedance.weight for impedance in self.bare)

    @property
    def friction_taken(self) -> float:
        """Share of the dry friction that is compensated, over all poses and axes."""
        return 1 - _norm(at.friction for at in self.assisted) / _norm(impedance.friction for impedance in self.bare)

    @property
    def roughness(self) -> float:
        """Vibration caused by friction compensation, relative to the dry friction, over all poses and axes."""
        return _norm(at.roughness for at in self.assisted) / _norm(impedance.friction for impedance in self.bare)

    @property
    def better_tracking(self) -> float:
        """Factor by which the model reduces the tracking error."""
        return self.tracking_pd / self.tracking_model

    @property
    def better_force(self) -> float:
        """Factor by which the model reduces the error of the hand force."""
        return self.force_bare / self.force_model


def _norm(values: Iterable[float]) -> float:
    return float(np.linalg.norm(list(values)))


def simulate_in_the_loop(
    setup: Setup,
    code: Compiled,
    trajectory: Trajectory,
    poses: Sequence[Array],
    push: tuple[float, float, float] = (0.6, 0.4, -0.5),
    friction: float = 0.9,
    tap: float = 0.05,
    stroke: Stroke | None = None,
) -> InTheLoopResult:
    """Run exported code as the controller of a device on the bench, and measure its performance.

    Args:
        setup: the device; its controller is the hand that measures, and the PD that tracks.
        code: of a model of the device.
        trajectory: to be tracked, at the control rate.
        poses: where the impedance at the handle is measured, each (active,), rad or m.
        push: amplitude of the hand force while it is estimated, in the base frame, N.
        friction: share of friction that is compensated.
        tap: force on the released handle, along all axes, N.
        stroke: motion of the hand that measures; the default one where None.

    Raises:
        ExperimentError, SimulationError: one class for each cause.
    """
    assistance = Assistance(setup.model, code, friction=friction)
    lines = [(pose, axis) for pose in poses for axis in _AXES]
    force_bare, force_model = _force_errors(setup, code, trajectory, push)
    return InTheLoopResult(
        bare=tuple(measure_impedance(setup, pose, axis, stroke=stroke) for pose, axis in lines),
        assisted=tuple(measure_impedance(setup, pose, axis, assistance, stroke) for pose, axis in lines),
        tracking_pd=_tracking_error(setup, code, trajectory, 0.0),
        tracking_model=_tracking_error(setup, code, trajectory, 1.0),
        force_bare=force_bare,
        force_model=force_model,
        restless=_restless(setup, assistance, poses[0], tap),
    )


def _released(setup: Setup, tracking_limit: float) -> Controller:
    """The controller with zero gains: only the control law acts."""
    off = {"gravity": False, "dynamics": False}
    return replace(setup.controller, kp=(0.0,), kd=(0.0,), ki=(0.0,), tracking_limit=tracking_limit, **off)


def _tracked(setup: Setup, trajectory: Trajectory, law: Tracking, hand: tuple[Push, ...] = ()) -> Recording:
    controller = _released(setup, setup.controller.tracking_limit)
    return simulate(replace(setup, controller=controller, law=law, hand=hand), trajectory, np.random.default_rng(0))


def _law(setup: Setup, code: Compiled, trajectory: Trajectory, share: float) -> Tracking:
    return Tracking(setup.model, code, trajectory, setup.controller.kp, setup.controller.kd, share, gain=_GAIN)


def _tracking_error(setup: Setup, code: Compiled, trajectory: Trajectory, share: float) -> float:
    """Tracking error of the handle, rms, m."""
    made = _tracked(setup, trajectory, _law(setup, code, trajectory, share))
    active = list(setup.model.device.active)
    actual, planned = (handle_motion(setup.model, q.T).position for q in (made.q[:, active], trajectory.q))
    return float(np.sqrt(((actual - planned) ** 2).sum(axis=1).mean()))


def _force_errors(
    setup: Setup, code: Compiled, trajectory: Trajectory, push: tuple[float, float, float]
) -> tuple[float, float]:
    """Errors of the hand force without and with the model, rms, N; the truth passes the observer's low-pass too."""
    seconds = len(trajectory) * setup.dt
    hand = (Push(push, frequency_hz=1.3, start=0.25 * seconds, stop=0.85 * seconds),)
    observed: list[Array] = []
    law = replace(_law(setup, code, trajectory, 1.0), report=observed.append)
    from scipy import signal  # slow to import, and few simulations have code in the loop

    made = _tracked(setup, trajectory, law, hand)
    keep = np.exp(-_GAIN * setup.dt)
    model = setup.model
    motors = made.command * np.array([drive.gear_ratio * drive.torque_constant for drive in model.device.motors])
    q = made.position @ model.device.row_map.T
    on_rows = model.device.row_torque(np.ascontiguousarray(q.T), np.ascontiguousarray(motors.T)).T
    bare = signal.lfilter([1 - keep], [1, -keep], -on_rows, axis=0)
    true = signal.lfilter([1 - keep], [1, -keep], made.hand, axis=0)
    during = (made.t > hand[0].start + SETTLING_TIME) & (made.t < hand[0].stop)

    def error(torque: Array) -> float:
        force = np.array([code("handle_force", *each)["force"] for each in zip(q[during], torque[during], strict=True)])
        return float(np.sqrt(((force - true[during]) ** 2).sum(axis=1).mean()))

    return error(bare), error(np.array(observed))


def _restless(setup: Setup, assistance: Assistance, pose: Array, tap: float) -> float:
    """Maximum speed at the end of the free response to a tap on the handle, rad/s or m/s."""
    q = np.tile(np.asarray(pose, dtype=float), (round(FREE_RESPONSE / setup.dt), 1))
    still = Trajectory(setup.dt, q, np.zeros_like(q), np.zeros_like(q))
    hand = (Push((tap, tap, tap), stop=TAP),)
    released = replace(setup, controller=_released(setup, float("inf")), law=assistance, hand=hand)
    made = simulate(released, still, np.random.default_rng(0))
    return float(np.abs(made.qd[-round(0.5 / setup.dt) :, list(setup.model.device.active)]).max())
