"""Closed-loop simulation of a set-up in MuJoCo: controller, encoders and amplifiers, one control period after another.

Measured signals and the simulator's exact states are recorded together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.model import DynamicModel
from haptid.errors import MissingDependencyError, SimulationError
from haptid.experiment.bench.amplifiers import AppliedTorque
from haptid.experiment.bench.bodies import has_counterpart
from haptid.experiment.bench.elastic import balanced_start, check_springs, planned_torque
from haptid.experiment.bench.held_forces import HeldForces
from haptid.experiment.bench.limits import check_trajectory
from haptid.experiment.bench.mjcf import HANDLE, closed, cut_sites, depth_first, mjcf
from haptid.experiment.bench.setup import Push, Recording, Setup
from haptid.experiment.bench.trajectories import Trajectory, per_coordinate

# Speed above which the simulation counts as unstable, rad/s or m/s.
_FASTEST = 1e3
# Loop-closure error above which a loop counts as broken, m.
WIDEST_GAP = 1e-6
# Number of progress calls per run.
PROGRESS_CALLS = 50
# Control periods whose states are checked together, after the last of them.
_CHECKED = 64
Progress = Callable[[float], None]


def load_mujoco() -> ModuleType:
    """The MuJoCo module, imported when first needed.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingDependencyError(
            "the virtual bench requires MuJoCo, which is not installed.",
            where="mujoco",
            advice='Install it with `pip install "haptid[bench]"`.',
        ) from error
    found: ModuleType = mujoco
    return found


def simulate(
    setup: Setup, trajectory: Trajectory, rng: np.random.Generator, progress: Progress | None = None
) -> Recording:
    """Simulate a planned motion in closed loop.

    Args:
        setup: device, controller and instruments.
        trajectory: the planned motion, at the control rate.
        rng: for noise.
        progress: called now and then with the share that is done.

    Raises:
        ExperimentError, SimulationError: one class for each cause, with the time and the joint; see `haptid.errors`.
    """
    saturation = _saturation(setup)
    check_trajectory(setup.model, trajectory, setup.chi, saturation)
    check_springs(setup.model, setup.chi, trajectory.q[0], setup.physics.step)
    mujoco = load_mujoco()
    with _quiet(mujoco):
        plant = _Plant(mujoco, setup, trajectory)
        control = _Control(setup, trajectory, saturation)
        return _run(setup, trajectory, plant, control, rng, progress or (lambda _: None))


def _saturation(setup: Setup) -> Array | None:
    """Maximum torque of each drive coordinate, (drives,), N m or N; infinite where there is no motor."""
    model, given = setup.model, setup.amplifiers.saturation
    if given is None:
        return None
    limits = np.full(len(model.device.drives), np.inf)
    limits[model.device.driven] = per_coordinate("saturation", given, [drive.name for drive in model.device.motors])
    return limits


@contextmanager
def _quiet(mujoco: ModuleType) -> Iterator[None]:
    """Suppress MuJoCo's own log file: its warnings are exceptions here."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


class _Plant:
    """The device in MuJoCo."""

    def __init__(self, mujoco: ModuleType, setup: Setup, trajectory: Trajectory) -> None:
        model = setup.model
        self.mujoco = mujoco
        own = _with_counterpart(model, setup.chi)
        hand = None
        if setup.held is not None:
            hand = (setup.held.model, handle_motion(model, trajectory.q[:1].T).position[0])
        self.mj_model: Any = mujoco.MjModel.from_xml_string(mjcf(model, own, setup.physics, setup.payload, hand))
        self.data: Any = mujoco.MjData(self.mj_model)
        self.held, self.pushed = HeldForces(model, setup.chi, setup.physics.step), np.zeros(self.mj_model.nv)
        # Positions, velocities and accelerations of the device; a hand's own come after them.
        n = len(model.device.joints)
        self.qpos, self.qvel, self.qacc = self.data.qpos[:n], self.data.qvel[:n], self.data.qacc[:n]
        self.order = np.array(depth_first(model))
        self.back = np.argsort(self.order)  # device order to MuJoCo order
        self.active = self.back[list(model.device.active)]
        self.qpos[:] = closed(model, balanced_start(model, setup.chi, trajectory.q[0]))
        qd = model.device.closure.follow(trajectory.q[:1].T).velocity(trajectory.qd[:1].T)
        self.qvel[:] = qd[self.order, 0]
        self.motors = len(model.device.motors)
        limits = [model.device.joints[j].position_limits or (-np.inf, np.inf) for j in self.order]
        self.lowest, self.highest = np.array(limits).T
        name = mujoco.mjtObj.mjOBJ_SITE
        pairs = [[mujoco.mj_name2id(self.mj_model, name, s) for s in pair] for pair in cut_sites(model)]
        self.pins = np.array(pairs, dtype=int).reshape(-1, 2)
        self.handle = mujoco.mj_name2id(self.mj_model, name, HANDLE) if model.device.handle is not None else -1

    def forward(self) -> None:
        """Evaluate accelerations and site positions at this instant."""
        if self.held:
            self._hold(0.0)
        self.mujoco.mj_forward(self.mj_model, self.data)

    def step(self, count: int) -> None:
        """Integrate by this number of steps."""
        if not self.held:
            self.mujoco.mj_step(self.mj_model, self.data, count)
            return
        for _ in range(count):
            self._hold(0.5)
            self.mujoco.mj_step(self.mj_model, self.data, 1)

    def _hold(self, ahead: float) -> None:
        """Apply the forces of terms that the simulator lacks, as they are this share of a step later."""
        data = self.data
        force = self.held(data.time, self.qpos[self.back], self.qvel[self.back], ahead)
        data.qfrc_applied[:] = self.pushed
        data.qfrc_applied[: len(self.order)] += force[self.order]

    def gaps(self, sites: Array) -> Array:
        """Largest distance between the two sites of a pin, (n,), m, from the positions of all sites, (n, sites, 3)."""
        one, other = sites[:, self.pins[:, 0]], sites[:, self.pins[:, 1]]
        return np.asarray(abs(one - other).max(axis=(1, 2), initial=0.0))

    def push(self, force: Array) -> None:
        """Apply the hand force for the next period, in the base frame, (3,), N."""
        data = self.data
        data.qfrc_applied[:] = 0.0
        point, body = data.site_xpos[self.handle], self.mj_model.site_bodyid[self.handle]
        self.mujoco.mj_applyFT(self.mj_model, data, force, np.zeros(3), point, body, data.qfrc_applied)
        self.pushed[:] = data.qfrc_applied


def _with_counterpart(model: DynamicModel, chi: Array) -> Array:
    """The parameters, with those of terms that the simulator lacks at zero, (p,)."""
    raw = [10 * len(model.device.joints) + k for k, term in enumerate(model.terms) if not has_counterpart(term)]
    return np.where(model.device.parameters.S[raw].any(axis=0), 0.0, chi)


class _Control:
    """The controller: torques on the drive coordinates from their positions.

    Redundant motors each follow their own planned position. Their proportional, derivative and integral torques pass
    the map B D', so that encoder steps and integrals build up no torques in balance; the preload of the distribution
    law is the only one.
    """

    def __init__(self, setup: Setup, trajectory: Trajectory, saturation: Array | None) -> None:
        model, settings = setup.model, setup.controller
        motors = [drive.name for drive in model.device.motors]
        # All of them as a slice, which is no copy in every period.
        self.driven = slice(None) if len(motors) == len(model.device.drives) else model.device.driven
        self.kp, self.kd, self.ki = (
            per_coordinate(name, getattr(settings, name), motors) for name in ("kp", "kd", "ki")
        )
        rows, followed = model.device.drive_rows, model.device.closure.follow(trajectory.q.T, trajectory.qd.T)
        self.rows, self.active = rows, rows[:, list(model.device.active)]
        self.target, self.speed = followed.q.T @ rows.T, followed.velocity(trajectory.qd.T).T @ rows.T
        self.feedforward = np.zeros((len(trajectory), len(motors)))
        c = model.device.row_map @ trajectory.q.T
        if settings.gravity or settings.dynamics:
            q, *rates = (np.ascontiguousarray(x.T) for x in (trajectory.q, trajectory.qd, trajectory.qdd))
            rates = rates if settings.dynamics else [np.zeros_like(q)] * 2
            tau = inverse_dynamics(model, model.base.of(setup.chi), q, *rates)
            self.feedforward[:] = planned_torque(model.device, c, tau).T
        elif model.device.redundant:
            self.feedforward[:] = model.device.drive_torque(c, np.zeros_like(c)).T
        self.sharing = _sharing(model, c) if model.device.redundant else None
        self.limit = None if saturation is None else saturation[self.driven]
        self.step, self.dt = setup.encoders.step(model), setup.dt
        drives = [drive.name for drive in model.device.drives]
        eccentricity = per_coordinate("eccentricity", setup.encoders.eccentricity, drives)
        self.eccentricity = eccentricity if eccentricity.any() else None
        slip = np.zeros(len(drives))
        slip[self.driven] = per_coordinate("slip", setup.encoders.slip, motors)
        self.slip = slip if slip.any() else None
        self.slips = round(setup.encoders.slip_at / self.dt)
        self.phase = 2 * np.pi / setup.encoders.turn(model)
        self.keep = float(np.exp(-2 * np.pi * settings.velocity_cutoff_hz * self.dt))
        self.integral, self.per_period = np.zeros(len(motors)), self.dt * self.ki
        self.to_active = model.device.active_from_drives
        self.velocity = self.speed[0].copy()
        self.last: Array | None = None
        self.law = setup.law.begin(setup.dt) if setup.law is not None else None

    def read(self, k: int, q: Array) -> Array:
        """Positions of the drives by their encoders in period k, (drives,), from all joints'; updates their filtered
        velocity."""
        c = self.rows @ q
        if self.slip is not None and k >= self.slips:
            c = c + self.slip
        if self.eccentricity is not None:
            c = c + self.eccentricity * np.sin(self.phase * c)
        if self.step is not None:
            c = self.step * np.rint(c / self.step)
        if self.last is not None:
            self.velocity = self.keep * self.velocity + (1 - self.keep) / self.dt * (c - self.last)
        self.last = c
        return np.asarray(c)

    def torque(self, k: int, c: Array) -> Array:
        """Commanded torque of the motors in period k, (motors,), N m or N."""
        error = (self.target[k] - c)[self.driven]
        self.integral += self.per_period * error
        damping = self.kd * (self.speed[k] - self.velocity)[self.driven]
        commanded = self.kp * error + damping + self.integral + self.feedforward[k]
        if self.sharing is not None:
            feedback = commanded - self.feedforward[k]
            commanded = self.sharing[k if len(self.sharing) > 1 else 0] @ feedback + self.feedforward[k]
        if self.law is not None:
            commanded = commanded + self.law(k * self.dt, self.to_active @ c)
        if self.limit is not None:
            commanded = np.maximum(np.minimum(commanded, self.limit), -self.limit)
        return np.asarray(commanded)


def _sharing(model: DynamicModel, c: Array) -> Array:
    """D B': motors' torques without those in balance, (samples or 1, motors, motors)."""
    B, driven = model.device.drive_jacobian(c), model.device.driven
    B = B[None] if B.ndim == 2 else B
    return np.asarray(model.device.law.shares(B)[:, driven] @ np.swapaxes(B[:, driven], 1, 2))


class _Recorder:
    """Recorded signals, one row per control period."""

    def __init__(self, setup: Setup, trajectory: Trajectory, plant: _Plant) -> None:
        model, n, motors = setup.model, len(trajectory), len(setup.model.device.motors)
        self.c, self.cd = np.empty((n, len(model.device.drives))), np.empty((n, len(model.device.drives)))
        self.commanded, self.actual = np.empty((n, motors)), np.empty((n, motors))
        self.exact = np.empty((3, n, len(model.device.joints)))
        self.hand, self.wrench = hand_force(setup.hand, trajectory.t), np.zeros((n, 6))
        self.sites, self.gap, self.sensor = np.empty((n, *plant.data.site_xpos.shape)), 0.0, setup.sensor
        self.state = (plant.qpos, plant.qvel, plant.qacc, plant.data.site_xpos)
        self.held = setup.held

    def keep(self, k: int, plant: _Plant) -> None:
        """Record the exact state at the beginning of period k."""
        self.exact[0, k], self.exact[1, k], self.exact[2, k], self.sites[k] = self.state
        if self.held is not None:
            self.hand[k] += plant.data.actuator_force[-6:-3]
        if self.sensor is not None:
            self.wrench[k, :3] = plant.data.site_xmat[plant.handle].reshape(3, 3).T @ self.hand[k]

    def recording(self, setup: Setup, trajectory: Trajectory, plant: _Plant, rng: np.random.Generator) -> Recording:
        """The recording in the device's joint order, with sensor noise."""
        wrench = None
        if self.sensor is not None:
            std = np.repeat([self.sensor.force_noise, self.sensor.moment_noise], 3)
            wrench = self.wrench + std * rng.standard_normal(self.wrench.shape)
        joints, each = setup.model.device.active_from_drives.T, setup.controller.log_every
        q, qd, qdd = (np.ascontiguousarray(x[::each, plant.back]) for x in self.exact)
        units = [drive.gear_ratio * drive.torque_constant for drive in setup.model.device.motors]
        return Recording(
            dt=each * setup.dt,
            target=trajectory.q[::each],
            position=self.c[::each] @ joints,
            velocity=self.cd[::each] @ joints,
            command=self.commanded[::each] / units,
            wrench=None if wrench is None else wrench[::each],
            q=q,
            qd=qd,
            qdd=qdd,
            torque=self.actual[::each],
            hand=self.hand[::each],
            gap=self.gap,
        )


def _run(
    setup: Setup,
    trajectory: Trajectory,
    plant: _Plant,
    control: _Control,
    rng: np.random.Generator,
    progress: Progress,
) -> Recording:
    """The loop over all control periods."""
    tape, n, data = _Recorder(setup, trajectory, plant), len(trajectory), plant.data
    applied = AppliedTorque(setup, tape.commanded, rng)
    # A control law of the user's own gets no state that is out of bounds.
    together = _CHECKED if setup.law is None else 1
    qpos, ctrl, hand = plant.qpos, data.ctrl[: plant.motors], bool(setup.hand)
    place = None if setup.held is None else setup.held.model.stiffness * setup.held.place(trajectory.t)
    with np.errstate(over="ignore", invalid="ignore"):  # states of a simulation that is unstable, before their check
        for k in range(n):
            tape.c[k] = c = control.read(k, qpos[plant.back])
            tape.cd[k] = control.velocity
            tape.commanded[k] = control.torque(k, c)
            pieces = applied.pieces(k)
            ctrl[:] = tape.actual[k] = applied.now
            if hand:
                plant.push(tape.hand[k])
            if place is not None:
                data.ctrl[-3:] = place[k]
            plant.forward()
            tape.keep(k, plant)
            if (k + 1) % together == 0 or k + 1 == n:
                _check_states(setup, plant, trajectory, tape, slice(k - k % together, k + 1))
            for steps, ctrl[:] in pieces:
                plant.step(steps)
            if k % max(1, n // PROGRESS_CALLS) == 0:
                progress(k / n)
    progress(1.0)
    return tape.recording(setup, trajectory, plant, rng)


def hand_force(pushes: tuple[Push, ...], t: Array) -> Array:
    """Sum of the hand forces at these times, (n, 3), N."""
    made = np.zeros((len(t), 3))
    for push in pushes:
        wave = np.sin(2 * np.pi * push.frequency_hz * (t - push.start)) if push.frequency_hz else np.ones(len(t))
        made += np.where((t >= push.start) & (t < push.stop), wave, 0.0)[:, None] * np.asarray(push.force)
    return made


def _check_states(setup: Setup, plant: _Plant, trajectory: Trajectory, tape: _Recorder, rows: slice) -> None:
    """Raise the error of the first of some periods whose state is out of bounds."""
    q, qd, gaps = tape.exact[0, rows], tape.exact[1, rows], plant.gaps(tape.sites[rows])
    far = abs(q[:, plant.active] - trajectory.q[rows])
    tape.gap = max(tape.gap, float(gaps.max()))
    within = far.max() <= setup.controller.tracking_limit and gaps.max() <= WIDEST_GAP
    if within and abs(qd).max() < _FASTEST and (q >= plant.lowest).all() and (q <= plant.highest).all():
        return
    bad = ~(abs(qd).max(axis=1) < _FASTEST) | (gaps > WIDEST_GAP)
    bad |= far.max(axis=1) > setup.controller.tracking_limit
    bad |= ((q < plant.lowest) | (q > plant.highest)).any(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        _check_state(setup, plant, trajectory, rows.start + k, q[k], qd[k], float(gaps[k]))


def _check_state(setup: Setup, plant: _Plant, trajectory: Trajectory, k: int, q: Array, qd: Array, gap: float) -> None:
    """Raise the error of an unstable joint, a broken loop, a lost target or a joint limit that is hit."""
    model, time = setup.model, k * setup.dt
    if not abs(qd).max() < _FASTEST:
        worst = int(np.argmax(np.abs(qd)))
        name = model.device.joint_names[plant.order[worst]]
        raise SimulationError(
            f"the simulation became unstable at {time:.3f} s: joint {name} moves at {float(qd[worst]):.3g} rad/s or "
            f"m/s; the limit is {_FASTEST:g}.",
            where=(name, time),
            found=float(qd[worst]),
            limit=_FASTEST,
            advice="Lower the controller gains (kd first), or the simulator step.",
        )
    if gap > WIDEST_GAP:
        raise SimulationError(
            f"the loop-closure error was {gap:.2g} m at {time:.3f} s; the limit is {WIDEST_GAP:g} m.",
            where=time,
            found=gap,
            limit=WIDEST_GAP,
            advice="Lower the simulator step, or keep the motion further from singular configurations of the loop.",
        )
    errors = abs(q[plant.active] - trajectory.q[k])
    if errors.max() > setup.controller.tracking_limit:
        joint = model.device.joints[model.device.active[int(np.argmax(errors))]]
        raise SimulationError(
            f"the tracking error of joint {joint.name} was {float(errors.max()):.3g} rad or m at {time:.3f} s; the "
            f"limit is {setup.controller.tracking_limit:g}.",
            where=(joint.name, time),
            found=float(errors.max()),
            limit=setup.controller.tracking_limit,
            advice="Raise kp or the amplifier's saturation, plan a slower motion, or raise `tracking_limit`.",
        )
    if ((q < plant.lowest) | (q > plant.highest)).any():
        worst = int(np.argmax(np.maximum(plant.lowest - q, q - plant.highest)))
        low, high = float(plant.lowest[worst]), float(plant.highest[worst])
        name = model.device.joint_names[plant.order[worst]]
        raise SimulationError(
            f"joint {name} was at {float(q[worst]):.4g} at {time:.3f} s, outside its limits {low:.4g} .. {high:.4g}.",
            where=(name, time),
            found=float(q[worst]),
            limit=(low, high),
            advice="Keep the planned motion further from the limits, or raise the controller gains.",
        )
