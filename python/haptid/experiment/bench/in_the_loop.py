"""What exported code does for a device, measured on the bench: weight, friction, tracking and the force of the hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array
from haptid.dynamics.kinematics import handle_motion
from haptid.experiment.bench.compiled_code import Compiled
from haptid.experiment.bench.controllers import Assistance, Tracking
from haptid.experiment.bench.hand import Felt, Stroke, feel
from haptid.experiment.bench.setup import Controller, Push, Recording, Setup
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import Trajectory

# Gain of the observer, rad/s, and after how long it has settled, s.
GAIN, SETTLED = 40.0, 0.3
# A tap on the handle: how long, and how long it is watched, s.
TAP, WATCHED = 0.03, 2.0
AXES = np.eye(3)


@dataclass(frozen=True)
class Rehearsal:
    """What was measured; see `rehearse`.

    Attributes:
        bare: what the hand feels along the axes of the base at every pose, the motors still.
        assisted: the same with gravity and friction compensation.
        tracking_pd, tracking_model: of the handle on the planned motion, PD alone and with the model's torque, rms, m.
        force_bare, force_model: error of the hand's force from motor torques alone and with the model, rms, N.
        restless: greatest speed of an active joint in the last half second after a tap, rad/s or m/s.
    """

    bare: tuple[Felt, ...]
    assisted: tuple[Felt, ...]
    tracking_pd: float
    tracking_model: float
    force_bare: float
    force_model: float
    restless: float

    @property
    def weight_left(self) -> float:
        """Share of the weight that gravity compensation leaves, over all poses and axes."""
        return _size(felt.weight for felt in self.assisted) / _size(felt.weight for felt in self.bare)

    @property
    def friction_taken(self) -> float:
        """Share of the dry friction that friction compensation takes off, over all poses and axes."""
        return 1 - _size(felt.friction for felt in self.assisted) / _size(felt.friction for felt in self.bare)

    @property
    def roughness(self) -> float:
        """Vibration that friction compensation makes, beside the dry friction, over all poses and axes."""
        return _size(felt.roughness for felt in self.assisted) / _size(felt.friction for felt in self.bare)

    @property
    def better_tracking(self) -> float:
        """Times that the model makes the error of tracking smaller."""
        return self.tracking_pd / self.tracking_model

    @property
    def better_force(self) -> float:
        """Times that the model makes the error of the hand's force smaller."""
        return self.force_bare / self.force_model


def _size(values: object) -> float:
    return float(np.linalg.norm(list(values)))  # type: ignore[call-overload]


def rehearse(
    setup: Setup,
    code: Compiled,
    trajectory: Trajectory,
    poses: Sequence[Array],
    push: tuple[float, float, float] = (0.6, 0.4, -0.5),
    friction: float = 0.9,
    tap: float = 0.05,
    stroke: Stroke | None = None,
) -> Rehearsal:
    """Let exported code control a device on the bench, once every control period, and measure what it does.

    Args:
        setup: the device; its controller is the hand that feels, and the PD that tracks.
        code: of a model of the device.
        trajectory: to be tracked, at the control rate.
        poses: where the hand feels, each (active,), rad or m.
        push: amplitude of the hand's force while its estimate is watched, in the base frame, N.
        friction: share of friction that is compensated.
        tap: on the released handle, along all axes, N.
        stroke: how the hand moves to feel; the default one where None.

    Raises:
        ExperimentError, SimulationError: one class for each cause.
    """
    assistance = Assistance(setup.model, code, friction=friction)
    lines = [(pose, axis) for pose in poses for axis in AXES]
    force_bare, force_model = _force_errors(setup, code, trajectory, push)
    return Rehearsal(
        bare=tuple(feel(setup, pose, axis, stroke=stroke) for pose, axis in lines),
        assisted=tuple(feel(setup, pose, axis, assistance, stroke) for pose, axis in lines),
        tracking_pd=_tracking_error(setup, code, trajectory, 0.0),
        tracking_model=_tracking_error(setup, code, trajectory, 1.0),
        force_bare=force_bare,
        force_model=force_model,
        restless=_restless(setup, assistance, poses[0], tap),
    )


def _released(setup: Setup, tracking_limit: float) -> Controller:
    """No controller but the law."""
    return replace(setup.controller, kp=(0.0,), kd=(0.0,), ki=(0.0,), gravity=False, tracking_limit=tracking_limit)


def _tracked(setup: Setup, trajectory: Trajectory, law: Tracking, hand: tuple[Push, ...] = ()) -> Recording:
    controller = _released(setup, setup.controller.tracking_limit)
    return simulate(replace(setup, controller=controller, law=law, hand=hand), trajectory, np.random.default_rng(0))


def _law(setup: Setup, code: Compiled, trajectory: Trajectory, share: float) -> Tracking:
    return Tracking(setup.model, code, trajectory, setup.controller.kp, setup.controller.kd, share, gain=GAIN)


def _tracking_error(setup: Setup, code: Compiled, trajectory: Trajectory, share: float) -> float:
    """Of the handle, rms, m."""
    made = _tracked(setup, trajectory, _law(setup, code, trajectory, share))
    active = list(setup.model.device.active)
    was, wanted = (handle_motion(setup.model, q.T).position for q in (made.q[:, active], trajectory.q))
    return float(np.sqrt(((was - wanted) ** 2).sum(axis=1).mean()))


def _force_errors(
    setup: Setup, code: Compiled, trajectory: Trajectory, push: tuple[float, float, float]
) -> tuple[float, float]:
    """Of the hand's force without and with the model, rms, N: both, and the force, through the observer's low-pass."""
    seconds = len(trajectory) * setup.dt
    hand = (Push(push, frequency_hz=1.3, start=0.25 * seconds, stop=0.85 * seconds),)
    seen: list[Array] = []
    law = replace(_law(setup, code, trajectory, 1.0), tell=seen.append)
    made = _tracked(setup, trajectory, law, hand)
    keep = np.exp(-GAIN * setup.dt)
    model = setup.model
    motors = made.command * np.array([drive.gear * drive.gain for drive in model.device.motors])
    driven = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
    bare = signal.lfilter([1 - keep], [1, -keep], -motors @ model.device.drive_rates[driven], axis=0)
    wanted = signal.lfilter([1 - keep], [1, -keep], made.hand, axis=0)
    during = (made.t > hand[0].start + SETTLED) & (made.t < hand[0].stop)
    q = made.position @ model.device.row_map.T

    def error(torque: Array) -> float:
        force = np.array([code("handle_force", *each)["force"] for each in zip(q[during], torque[during], strict=True)])
        return float(np.sqrt(((force - wanted[during]) ** 2).sum(axis=1).mean()))

    return error(bare), error(np.array(seen))


def _restless(setup: Setup, assistance: Assistance, pose: Array, tap: float) -> float:
    """Greatest speed long after a tap on the handle, which nothing but the assistance holds, rad/s or m/s."""
    q = np.tile(np.asarray(pose, dtype=float), (round(WATCHED / setup.dt), 1))
    still = Trajectory(setup.dt, q, np.zeros_like(q), np.zeros_like(q))
    hand = (Push((tap, tap, tap), stop=TAP),)
    released = replace(setup, controller=_released(setup, float("inf")), law=assistance, hand=hand)
    made = simulate(released, still, np.random.default_rng(0))
    return float(np.abs(made.qd[-round(0.5 / setup.dt) :, list(setup.model.device.active)]).max())
