"""The set-up of a bench simulation (controller, encoders, amplifiers, hand, sensor) and the recording it gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.compensation.hands import HandModel
from haptid.errors import ExperimentError, IncompleteDeviceError
from haptid.experiment.bench.mjcf import Physics, SimulatedPayload
from haptid.experiment.bench.trajectories import Figures, per_coordinate


@dataclass(frozen=True)
class Controller:
    """PD or PID controller on the motor coordinates, at the joint side.

    Attributes:
        kp, kd, ki: gains, N m/rad, N m s/rad, N m/(rad s); one for all motors or one for each.
        gravity: whether the gravity torque along the planned motion is fed forward.
        dynamics: whether the whole torque of the planned motion is, by the true parameters.
        rate_hz: control rate.
        velocity_cutoff_hz: of the first-order low-pass on the differences of the measured position.
        log_every: control periods of one row of the log; what is between them is not averaged.
        tracking_limit: maximum tracking error, rad or m.
    """

    kp: Figures
    kd: Figures
    ki: Figures = (0.0,)
    gravity: bool = False
    dynamics: bool = False
    rate_hz: float = 1000.0
    velocity_cutoff_hz: float = 100.0
    log_every: int = 1
    tracking_limit: float = 0.3


class TorqueLaw(Protocol):
    """A control law that adds to the PD's torque, such as `haptid.end_effector.compensation.Compensation`."""

    def begin(self, dt: float) -> Callable[[float, Array], Array]:
        """The control step, from rest, for a control period of dt, s.

        It is called once every period with the time, s, and the measured positions of the active joints, (active,),
        rad or m, and returns torques of the motor coordinates, (motors,), N m or N.
        """


@dataclass(frozen=True)
class Encoders:
    """Position encoders: eccentricity, slip and quantisation of the motor coordinates.

    Attributes:
        counts_per_turn: of each motor's encoder after quadrature, or per metre; None where positions are exact.
        gear: encoder turns per turn of the motor coordinate.
        eccentricity: amplitude of an error that is a sine with one period a turn of the encoder, rad or m of the motor
            coordinate.
        slip: of each motor's cable over its capstan, or of its coupling: from then on its encoder reads so much more
            than what the motor moves, rad or m of the motor coordinate.
        slip_at: when, s.
    """

    counts_per_turn: Figures | None = None
    gear: Figures = (1.0,)
    eccentricity: Figures = (0.0,)
    slip: Figures = (0.0,)
    slip_at: float = 0.0

    def step(self, model: DynamicModel) -> Array | None:
        """Resolution of each drive coordinate, (drives,), rad or m; None where positions are exact."""
        if self.counts_per_turn is None:
            return None
        names = [drive.name for drive in model.device.drives]
        return self.turn(model) / per_coordinate("counts_per_turn", self.counts_per_turn, names)

    def turn(self, model: DynamicModel) -> Array:
        """Distance of each drive coordinate in a turn of its encoder, (drives,), rad or m."""
        gear = per_coordinate("gear", self.gear, [drive.name for drive in model.device.drives])
        turns = [1.0 if unit == "N" else 2 * np.pi for unit in model.device.drive_units]
        return np.asarray(turns / np.abs(gear))


@dataclass(frozen=True)
class Amplifiers:
    """Amplifiers: actual torque from commanded torque.

    Attributes:
        gain: actual torque per commanded torque.
        saturation: maximum torque of a motor coordinate, N m or N; None for no limit.
        noise: standard deviation of the torque, white from one control period to the next, N m or N.
        delay: from reading the encoders to the torque, s; a whole number of simulator steps.
        jitter: longest further delay, uniform and new in every control period, s; the same, and no more than a period.
        step: resolution of the commanded torque (of the drive's current), N m or N; 0 for none.
        bandwidth_hz: of the first-order lag from command to torque (the current loop); None for none.
    """

    gain: Figures = (1.0,)
    saturation: Figures | None = None
    noise: Figures = (0.0,)
    delay: float = 0.0
    jitter: float = 0.0
    step: Figures = (0.0,)
    bandwidth_hz: float | None = None


@dataclass(frozen=True)
class Push:
    """Hand force at the handle, in the base frame.

    Attributes:
        force: N, (3,).
        frequency_hz: of a sine; 0 for a constant force.
        start, stop: time interval in which it acts, s.
    """

    force: tuple[float, float, float]
    frequency_hz: float = 0.0
    start: float = 0.0
    stop: float = float("inf")


@dataclass(frozen=True)
class Hand:
    """A hand that holds the handle and moves it along a line, in the base frame; passive where the line is a point.

    Its place moves by direction * amplitude * (sin(w t) + third * sin(3 w t)), faded in over the first period.

    Attributes:
        model: mass, springs and dampers of grasp and arm.
        direction: of the line, (3,), unit vector.
        amplitude: of the sine, m.
        frequency_hz: of the sine.
        third: amplitude of the third harmonic, share of the first.
    """

    model: HandModel
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    amplitude: float = 0.0
    frequency_hz: float = 1.0
    third: float = 0.0

    def place(self, t: Array) -> Array:
        """Displacement of the place at these times, (n, 3), m."""
        phase = 2 * np.pi * self.frequency_hz * t
        rise = np.clip(phase / (2 * np.pi), 0.0, 1.0)
        window = rise**3 * (10 - 15 * rise + 6 * rise**2)
        along = self.amplitude * window * (np.sin(phase) + self.third * np.sin(3 * phase))
        return np.outer(along, self.direction)


@dataclass(frozen=True)
class ForceSensor:
    """Six-axis force/torque sensor at the handle, in the handle frame: the hand's wrench, without the payload.

    Attributes:
        force_noise, moment_noise: standard deviation of a sample, N and N m.
    """

    force_noise: float = 0.0
    moment_noise: float = 0.0


@dataclass(frozen=True)
class TorqueSensors:
    """Torque sensors behind the springs of elastic motors.

    Attributes:
        motors: names of the motors that have one.
        noise, offset: standard deviation of a sample, and zero, N m or N; one for all sensors or one for each.
    """

    motors: tuple[str, ...]
    noise: Figures = (0.0,)
    offset: Figures = (0.0,)


@dataclass(frozen=True, eq=False)
class Setup:
    """A simulated set-up: device, true parameters, controller and instruments.

    Attributes:
        chi: its true free standard parameters, (p,), SI.
        controller, encoders, amplifiers: the control loop.
        physics: settings of the simulator.
        payload: point mass at the handle.
        hand: hand forces at the handle.
        held: a hand that holds the handle; None for a free one.
        sensor: force/torque sensor at the handle.
        torque_sensors: behind springs; None for none.
        law: control law that adds to the controller's torque, None for none; amplifiers saturate the sum.
    """

    model: DynamicModel
    chi: Array
    controller: Controller
    encoders: Encoders = field(default_factory=Encoders)
    amplifiers: Amplifiers = field(default_factory=Amplifiers)
    physics: Physics = field(default_factory=Physics)
    payload: SimulatedPayload | None = None
    hand: tuple[Push, ...] = ()
    held: Hand | None = None
    sensor: ForceSensor | None = None
    torque_sensors: TorqueSensors | None = None
    law: TorqueLaw | None = None

    def __post_init__(self) -> None:
        for what, there in (("hand", bool(self.hand or self.held)), ("force sensor", self.sensor is not None)):
            if there and self.model.device.handle is None:
                raise IncompleteDeviceError(
                    f"the experiment has a {what}, but {self.model.device.name} has no handle.",
                    where=what,
                    advice="Add [handle] to the device file.",
                )
        late = (("the delay", self.amplifiers.delay), ("the jitter", self.amplifiers.jitter))
        for what, seconds in (("the control period", self.dt), *late):
            steps = seconds / self.physics.step
            if abs(steps - round(steps)) > 1e-6 or (what == "the control period" and round(steps) < 1):
                raise ExperimentError(
                    f"{what} is {seconds:g} s, not a whole number of simulator steps of {self.physics.step:g} s.",
                    where=what,
                    found=seconds,
                    limit=self.physics.step,
                    advice="Change one of them, for example to 1 kHz and 1e-4 s.",
                )
        if self.amplifiers.jitter > self.dt * (1 + 1e-9):
            raise ExperimentError(
                f"the jitter is {self.amplifiers.jitter:g} s, longer than the control period of {self.dt:g} s, so that "
                "commands would overtake each other.",
                where="the jitter",
                found=self.amplifiers.jitter,
                limit=self.dt,
                advice="Lower the jitter, or add the constant part of it to the delay.",
            )

    @property
    def dt(self) -> float:
        """Control period, s."""
        return 1.0 / self.controller.rate_hz


@dataclass(frozen=True, eq=False)
class Recording:
    """Measured and true signals of a bench run, sampled at the beginning of control periods.

    Attributes:
        dt: sampling period, s: one control period, or `Controller.log_every` of them.
        target: planned position of the active joints, (n, active), rad or m.
        position: measured by the encoders, of the active joints, (n, active), rad or m.
        velocity: as the controller computes it, of the active joints, (n, active), rad/s or m/s.
        command: in each motor's own unit, (n, motors).
        wrench: force and moment measured at the handle, (n, 6), N and N m; None without a sensor.
        q, qd, qdd: true, of all joints, each (n, joints), SI.
        torque: true, on each motor coordinate, applied from this instant on, (n, motors), N m or N.
        hand: true hand force, in the base frame, (n, 3), N.
        gap: largest loop-closure error, m.
    """

    dt: float
    target: Array
    position: Array
    velocity: Array
    command: Array
    wrench: Array | None
    q: Array
    qd: Array
    qdd: Array
    torque: Array
    hand: Array
    gap: float

    def __len__(self) -> int:
        return len(self.q)

    @property
    def t(self) -> Array:
        """Sample times, (n,), s."""
        return freeze(np.asarray(self.dt * np.arange(len(self)), dtype=float))
