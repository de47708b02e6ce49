"""The bench at work: controller, encoders and amplifiers around the device in MuJoCo, one control period after another.

What the log has and what is true are recorded side by side: the log has what an instrument gives, the exact states are
the simulator's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import inverse_dynamics
from haptid.errors import (
    LimitHitError,
    LoopBrokenError,
    MujocoMissingError,
    TrackingLostError,
    UnstableError,
)
from haptid.experiment.bench.limits import check_trajectory
from haptid.experiment.bench.mjcf import HANDLE, closed, cut_sites, depth_first, mjcf
from haptid.experiment.bench.setup import Push, Recording, Setup
from haptid.experiment.bench.trajectories import Trajectory, spread

# A joint faster than this has run away, rad/s or m/s.
FASTEST = 1e3
# A loop that is open by more is broken, m.
WIDEST_GAP = 1e-6
# Progress is told so many times.
TOLD = 50
Tell = Callable[[float], None]


def load_mujoco() -> ModuleType:
    """MuJoCo, loaded when needed.

    Raises:
        MujocoMissingError: it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MujocoMissingError from error
    found: ModuleType = mujoco
    return found


def simulate(setup: Setup, trajectory: Trajectory, rng: np.random.Generator, tell: Tell | None = None) -> Recording:
    """Run the planned motion on the bench.

    Args:
        setup: what is on the bench.
        trajectory: the planned motion, at the control rate.
        rng: for noise.
        tell: called now and then with the share that is done.

    Raises:
        ExperimentError, SimulationError: one class for each cause, with the time and the joint; see `haptid.errors`.
    """
    saturation = _saturation(setup)
    check_trajectory(setup.model, trajectory, setup.chi, saturation)
    mujoco = load_mujoco()
    with _quiet(mujoco):
        rig = _Rig(mujoco, setup, trajectory)
        control = _Control(setup, trajectory, saturation)
        return _run(setup, trajectory, rig, control, rng, tell or (lambda _: None))


def _saturation(setup: Setup) -> Array | None:
    """Greatest torque of each drive's coordinate, (active,), N m or N; no limit where there is no motor."""
    model, given = setup.model, setup.amplifiers.saturation
    if given is None:
        return None
    limits = np.full(len(model.device.drives), np.inf)
    driven = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
    limits[driven] = spread("saturation", given, [drive.name for drive in model.device.motors])
    return limits


@contextmanager
def _quiet(mujoco: ModuleType) -> Iterator[None]:
    """Without MuJoCo's own log file: what it would say there is an error here."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


class _Rig:
    """The device in the simulator."""

    def __init__(self, mujoco: ModuleType, setup: Setup, trajectory: Trajectory) -> None:
        model = setup.model
        self.mujoco = mujoco
        self.mj_model: Any = mujoco.MjModel.from_xml_string(mjcf(model, setup.chi, setup.physics, setup.payload))
        self.data: Any = mujoco.MjData(self.mj_model)
        self.order = np.array(depth_first(model))
        self.back = np.argsort(self.order)  # from the device's joints to MuJoCo's
        self.active = self.back[list(model.device.active)]
        self.data.qpos[:] = closed(model, trajectory.q[0])
        qd = model.device.closure.follow(trajectory.q[:1].T).velocity(trajectory.qd[:1].T)
        self.data.qvel[:] = qd[self.order, 0]
        self.motors = len(model.device.motors)
        limits = [model.device.joints[j].position_limits or (-np.inf, np.inf) for j in self.order]
        self.lowest, self.highest = np.array(limits).T
        name = mujoco.mjtObj.mjOBJ_SITE
        pairs = [[mujoco.mj_name2id(self.mj_model, name, s) for s in pair] for pair in cut_sites(model)]
        self.one, self.other = np.array(pairs, dtype=int).reshape(-1, 2).T
        self.handle = mujoco.mj_name2id(self.mj_model, name, HANDLE) if model.device.handle is not None else -1

    def forward(self) -> None:
        """Accelerations and sites at this instant."""
        self.mujoco.mj_forward(self.mj_model, self.data)

    def step(self, count: int) -> None:
        """So many steps of the simulator."""
        self.mujoco.mj_step(self.mj_model, self.data, count)

    def gap(self) -> float:
        """Greatest opening of a pin, m."""
        if not len(self.one):
            return 0.0
        at = self.data.site_xpos
        return float(abs(at[self.one] - at[self.other]).max())

    def push(self, force: Array) -> None:
        """The force of the hand for the next period, in the base frame, (3,), N."""
        data = self.data
        data.qfrc_applied[:] = 0.0
        point, body = data.site_xpos[self.handle], self.mj_model.site_bodyid[self.handle]
        self.mujoco.mj_applyFT(self.mj_model, data, force, np.zeros(3), point, body, data.qfrc_applied)


class _Control:
    """The controller, from positions of the drives' coordinates to torques on them."""

    def __init__(self, setup: Setup, trajectory: Trajectory, saturation: Array | None) -> None:
        model, settings = setup.model, setup.controller
        motors = [drive.name for drive in model.device.motors]
        self.driven = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
        self.kp, self.kd, self.ki = (spread(name, getattr(settings, name), motors) for name in ("kp", "kd", "ki"))
        self.coupling = np.asarray(model.device.coupling)
        self.target, self.speed = trajectory.q @ self.coupling.T, trajectory.qd @ self.coupling.T
        self.forward = np.zeros((len(trajectory), len(motors)))
        if settings.gravity:
            still = np.zeros_like(trajectory.q.T)
            held = inverse_dynamics(model, model.base.of(setup.chi), trajectory.q.T, still, still)
            self.forward[:] = np.linalg.solve(self.coupling.T, model.device.row_map.T @ held)[self.driven].T
        self.limit = np.full(len(motors), np.inf) if saturation is None else saturation[self.driven]
        self.step, self.dt = setup.encoders.step(model), setup.dt
        self.keep = float(np.exp(-2 * np.pi * settings.velocity_cutoff_hz * self.dt))
        self.integral = np.zeros(len(motors))
        self.velocity = self.speed[0].copy()
        self.last: Array | None = None
        self.law = setup.law.begin(setup.dt) if setup.law is not None else None
        self.to_joints = np.linalg.inv(self.coupling)

    def read(self, qa: Array) -> Array:
        """Positions of the drives' coordinates as the encoders give them, and their velocity from them, (active,)."""
        c = self.coupling @ qa
        if self.step is not None:
            c = self.step * np.round(c / self.step)
        if self.last is not None:
            self.velocity = self.keep * self.velocity + (1 - self.keep) / self.dt * (c - self.last)
        self.last = c
        return np.asarray(c)

    def torque(self, k: int, c: Array) -> Array:
        """What the motors are asked for in period k, (motors,), N m or N."""
        error = (self.target[k] - c)[self.driven]
        self.integral += self.dt * self.ki * error
        damping = self.kd * (self.speed[k] - self.velocity)[self.driven]
        asked = self.kp * error + damping + self.integral + self.forward[k]
        if self.law is not None:
            asked = asked + self.law(k * self.dt, self.to_joints @ c)
        return np.asarray(np.clip(asked, -self.limit, self.limit))


class _Tape:
    """What is recorded, one row for each control period."""

    def __init__(self, setup: Setup, trajectory: Trajectory) -> None:
        model, n, motors = setup.model, len(trajectory), len(setup.model.device.motors)
        self.c, self.cd = np.empty((n, len(model.device.drives))), np.empty((n, len(model.device.drives)))
        self.asked, self.acting = np.empty((n, motors)), np.empty((n, motors))
        self.exact = np.empty((3, n, len(model.device.joints)))
        self.hand, self.wrench = hand_force(setup.hand, trajectory.t), np.zeros((n, 6))
        self.gap = 0.0

    def keep(self, k: int, rig: _Rig) -> float:
        """The exact state at the beginning of period k; the opening of the loops then, m."""
        data = rig.data
        self.exact[0, k], self.exact[1, k], self.exact[2, k] = data.qpos, data.qvel, data.qacc
        if rig.handle >= 0:
            self.wrench[k, :3] = data.site_xmat[rig.handle].reshape(3, 3).T @ self.hand[k]
        gap = rig.gap()
        self.gap = max(self.gap, gap)
        return gap

    def recording(self, setup: Setup, trajectory: Trajectory, rig: _Rig, rng: np.random.Generator) -> Recording:
        """In the device's own order, and with the sensor's noise."""
        wrench = None
        if setup.sensor is not None:
            deviation = np.repeat([setup.sensor.force_noise, setup.sensor.moment_noise], 3)
            wrench = self.wrench + deviation * rng.standard_normal(self.wrench.shape)
        joints = np.linalg.inv(setup.model.device.coupling).T
        q, qd, qdd = (np.ascontiguousarray(x[:, rig.back]) for x in self.exact)
        return Recording(
            dt=setup.dt,
            target=trajectory.q,
            position=self.c @ joints,
            velocity=self.cd @ joints,
            command=self.asked / [drive.gear * drive.gain for drive in setup.model.device.motors],
            wrench=wrench,
            q=q,
            qd=qd,
            qdd=qdd,
            torque=self.acting,
            hand=self.hand,
            gap=self.gap,
        )


def _run(
    setup: Setup, trajectory: Trajectory, rig: _Rig, control: _Control, rng: np.random.Generator, tell: Tell
) -> Recording:
    """All control periods."""
    tape, n, data = _Tape(setup, trajectory), len(trajectory), rig.data
    motors = [drive.name for drive in setup.model.device.motors]
    gain = spread("gain", setup.amplifiers.gain, motors)
    noise = spread("noise", setup.amplifiers.noise, motors) * rng.standard_normal((n, len(motors)))
    per, late = round(setup.dt / setup.physics.step), round(setup.amplifiers.delay / setup.physics.step)
    whole, rest = divmod(late, per)
    for k in range(n):
        tape.c[k] = control.read(data.qpos[rig.active])
        tape.cd[k] = control.velocity
        tape.asked[k] = control.torque(k, tape.c[k])
        now, before = max(k - whole, 0), max(k - whole - 1, 0)
        data.ctrl[: rig.motors] = tape.acting[k] = gain * tape.asked[before if rest else now] + noise[k]
        if setup.hand:
            rig.push(tape.hand[k])
        rig.forward()
        _check_state(setup, rig, trajectory, k, tape.keep(k, rig))
        if rest:
            rig.step(rest)
            data.ctrl[: rig.motors] = gain * tape.asked[now] + noise[k]
        rig.step(per - rest)
        if k % max(1, n // TOLD) == 0:
            tell(k / n)
    tell(1.0)
    return tape.recording(setup, trajectory, rig, rng)


def hand_force(pushes: tuple[Push, ...], t: Array) -> Array:
    """The force of the hand at these times, (n, 3), N."""
    made = np.zeros((len(t), 3))
    for push in pushes:
        wave = np.sin(2 * np.pi * push.frequency_hz * (t - push.start)) if push.frequency_hz else np.ones(len(t))
        made += np.where((t >= push.start) & (t < push.stop), wave, 0.0)[:, None] * np.asarray(push.force)
    return made


def _check_state(setup: Setup, rig: _Rig, trajectory: Trajectory, k: int, gap: float) -> None:
    """Raise what went wrong, if anything."""
    data, model, time = rig.data, setup.model, k * setup.dt
    qd, q = data.qvel, data.qpos
    if not abs(qd).max() < FASTEST:
        worst = int(np.argmax(np.abs(qd)))
        raise UnstableError(time, model.device.joints[int(rig.order[worst])].name, float(qd[worst]), FASTEST)
    if gap > WIDEST_GAP:
        raise LoopBrokenError(time, gap, WIDEST_GAP)
    away = abs(q[rig.active] - trajectory.q[k])
    if away.max() > setup.controller.tracking_limit:
        joint = model.device.joints[model.device.active[int(np.argmax(away))]]
        raise TrackingLostError(time, joint.name, float(away.max()), setup.controller.tracking_limit)
    if ((q < rig.lowest) | (q > rig.highest)).any():
        worst = int(np.argmax(np.maximum(rig.lowest - q, q - rig.highest)))
        limits = float(rig.lowest[worst]), float(rig.highest[worst])
        raise LimitHitError(time, model.device.joints[int(rig.order[worst])].name, float(q[worst]), limits)
