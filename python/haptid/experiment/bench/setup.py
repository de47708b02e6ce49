"""What is on the bench, and what it gives: values around the simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.dynamics.model import DynamicModel
from haptid.errors import NoHandleError, TimingError
from haptid.experiment.bench.mjcf import Payload, Physics
from haptid.experiment.bench.trajectories import Figures, spread


@dataclass(frozen=True)
class Controller:
    """PD or PID on the motors' coordinates, at the joint side.

    Attributes:
        kp, kd, ki: gains, N m/rad, N m s/rad, N m/(rad s); one for all motors or one for each.
        gravity: whether the torque of the planned poses is fed forward.
        rate_hz: control rate, and that of the log.
        velocity_cutoff_hz: of the first-order filter on the differences of the measured position.
        tracking_limit: greatest distance from the planned position, rad or m.
    """

    kp: Figures
    kd: Figures
    ki: Figures = (0.0,)
    gravity: bool = False
    rate_hz: float = 1000.0
    velocity_cutoff_hz: float = 100.0
    tracking_limit: float = 0.3


class TorqueLaw(Protocol):
    """A law of control beside the PD's, such as `haptid.end_effector.compensation.Compensation`."""

    def begin(self, dt: float) -> Callable[[float, Array], Array]:
        """The law from rest, for a control period of dt, s.

        What it returns is called once every period, with the time, s, and the measured positions of the active joints,
        (active,), rad or m, and gives torques of the motors' coordinates, (motors,), N m or N.
        """


@dataclass(frozen=True)
class Encoders:
    """What positions are read with.

    Attributes:
        counts_per_turn: of each motor's encoder after quadrature, or per metre; None where positions are exact.
        gear: turns of the encoder for one of the motor's coordinate.
    """

    counts_per_turn: Figures | None = None
    gear: Figures = (1.0,)

    def step(self, model: DynamicModel) -> Array | None:
        """One count of each drive's coordinate, (active,), rad or m; None where positions are exact."""
        if self.counts_per_turn is None:
            return None
        names = [drive.name for drive in model.device.drives]
        counts = spread("counts_per_turn", self.counts_per_turn, names) * np.abs(spread("gear", self.gear, names))
        whole = [1.0 if _slides(model, drive.row) else 2 * np.pi for drive in model.device.drives]
        return np.asarray(whole / counts)


def _slides(model: DynamicModel, row: Array) -> bool:
    return model.device.joints[model.device.active[int(np.argmax(row != 0))]].prismatic


@dataclass(frozen=True)
class Amplifiers:
    """From the torque that is asked for to the one that acts.

    Attributes:
        gain: torque that acts for one that is asked for.
        saturation: greatest torque of a motor's coordinate, N m or N; None for none.
        noise: standard deviation of the torque from one control period to the next, N m or N.
        delay: from reading the encoders to the torque, s; a whole number of the simulator's steps.
    """

    gain: Figures = (1.0,)
    saturation: Figures | None = None
    noise: Figures = (0.0,)
    delay: float = 0.0


@dataclass(frozen=True)
class Push:
    """A force of the hand at the handle, in the base frame.

    Attributes:
        force: N, (3,).
        frequency_hz: of a sine; 0 for a constant force.
        start, stop: when, s.
    """

    force: tuple[float, float, float]
    frequency_hz: float = 0.0
    start: float = 0.0
    stop: float = float("inf")


@dataclass(frozen=True)
class ForceSensor:
    """Six axes at the handle, in its frame: what the hand applies, without the payload.

    Attributes:
        force_noise, moment_noise: standard deviation of a sample, N and N m.
    """

    force_noise: float = 0.0
    moment_noise: float = 0.0


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything on the bench.

    Attributes:
        model: the dynamic model.
        chi: its true free standard parameters, (p,), SI.
        controller, encoders, amplifiers, physics: around it.
        payload: a mass at the handle.
        hand: forces at the handle.
        sensor: a force sensor there.
        law: torque beside the controller's, None for none; amplifiers limit the sum.
    """

    model: DynamicModel
    chi: Array
    controller: Controller
    encoders: Encoders = field(default_factory=Encoders)
    amplifiers: Amplifiers = field(default_factory=Amplifiers)
    physics: Physics = field(default_factory=Physics)
    payload: Payload | None = None
    hand: tuple[Push, ...] = ()
    sensor: ForceSensor | None = None
    law: TorqueLaw | None = None

    def __post_init__(self) -> None:
        for what, there in (("hand", bool(self.hand)), ("force sensor", self.sensor is not None)):
            if there and self.model.device.handle is None:
                raise NoHandleError(what, self.model.device.name)
        for what, seconds in (("the control period", self.dt), ("the delay", self.amplifiers.delay)):
            steps = seconds / self.physics.step
            if abs(steps - round(steps)) > 1e-6 or (what != "the delay" and round(steps) < 1):
                raise TimingError(what, seconds, self.physics.step)

    @property
    def dt(self) -> float:
        """Control period, s."""
        return 1.0 / self.controller.rate_hz


@dataclass(frozen=True, eq=False)
class Recording:
    """What the instruments gave, and what was true, at the beginning of every control period.

    Attributes:
        dt: control period, s.
        target: planned position of the active joints, (n, active), rad or m.
        position: as the encoders give it, of the active joints, (n, active), rad or m.
        velocity: as the controller computes it, of the active joints, (n, active), rad/s or m/s.
        command: in each motor's own unit, (n, motors).
        wrench: force and moment at the handle as the sensor gives them, (n, 6), N and N m; None without one.
        q, qd, qdd: exact, of all joints, each (n, joints), SI.
        torque: exact, on each motor's coordinate, that acts from this instant, (n, motors), N m or N.
        hand: exact force of the hand, in the base frame, (n, 3), N.
        gap: greatest opening of a loop, m.
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
