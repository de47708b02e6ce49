"""What methods share that simulate the closed loop: settings, start, and passes until the estimate stays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from haptid._values import Array, positive, whole
from haptid.device import Device
from haptid.errors import MasslessError, MethodSettingError, NoControllerError, SimulationLostError
from haptid.estimators.estimate import Estimate, estimate
from haptid.estimators.method import Method
from haptid.estimators.wls import WLS
from haptid.observation import Observation
from haptid.rows import Rows
from haptid.signals import position_map
from haptid.simulation import PID, Course, DirectModel, Stretches, closed_loop, sets_of, smooth
from haptid.treatment import Motion, treat

# A pass that makes the model run away is halved so many times.
HALVINGS = 6


class Restated(Protocol):
    """What a pass needs of a method."""

    most: int
    tolerance: float

    @property
    def inner(self) -> Method:
        """How restated rows are fitted."""

    def restate(self, observation: Observation, smoothed: Device, beta: Array) -> Observation:
        """Rows whose least squares are the next estimate, from the model simulated with beta, (p,)."""


@dataclass(frozen=True)
class Simulating:
    """Settings of a method that simulates the device under the controller that moved it.

    Attributes:
        controller: PD or PID with its reference.
        inner: how the rows that the simulation gives are fitted: `WLS()`, or `Consistent()` for what bodies can have.
        start: the method that gives the first parameters to simulate with.
        most: passes at most.
        tolerance: a pass that moves no parameter by more deviations than this is the last.
        friction: dry friction turns over within this share of a joint's root mean square speed.
        stretch, settle: length of what is simulated in one go, and of its running in, s.
    """

    controller: PID | None = None
    inner: Method = field(default_factory=WLS)
    start: Method = field(default_factory=WLS)
    most: int = 10
    tolerance: float = 0.05
    friction: float = 0.005
    stretch: float = 0.5
    settle: float = 0.5

    def __post_init__(self) -> None:
        if not (whole(self.most) and self.most >= 1):
            raise MethodSettingError(self.name, "most", self.most, "a whole number, 1 or more")
        for name in ("tolerance", "friction", "stretch", "settle"):
            if not positive(getattr(self, name)):
                raise MethodSettingError(self.name, name, getattr(self, name), "a finite number above zero")

    @property
    def name(self) -> str:
        return type(self).__name__

    @property
    def law(self) -> PID:
        """The controller.

        Raises:
            NoControllerError: there is none.
        """
        if self.controller is None:
            raise NoControllerError(type(self).__name__)
        return self.controller

    def estimate(self, observation: Observation) -> Estimate:
        """Simulate, restate the rows, fit; again until the estimate stays.

        Raises:
            NoControllerError: there is no controller.
            SimulationLostError, MasslessError: the model cannot be simulated from the first parameters.
        """
        law = self.law
        law.figures("kp", observation.device)  # a controller of another device is an error before any work
        return passes(self, observation, estimate(observation, self.start).beta, self.friction)

    def courses(self, observation: Observation, smoothed: Device, beta: Array) -> list[Course]:
        """What the model does along every motion."""
        model = DirectModel(smoothed, sets_of(observation.device, beta))
        found = []
        for place, motion in enumerate(observation.motions):
            steps = closed_loop(model, self.law, motion, place, self.stretches(motion))
            found.append(steps.course(motion))
        return found

    def stretches(self, motion: Motion) -> Stretches:
        """Of one motion."""
        return Stretches.of(len(motion), round(self.stretch / motion.dt), round(self.settle / motion.dt))

    def restate(self, observation: Observation, smoothed: Device, beta: Array) -> Observation:
        """Rows whose least squares are the next estimate; every method has its own."""
        raise NotImplementedError


def passes(method: Restated, observation: Observation, beta: Array, friction: float) -> Estimate:
    """Fit restated rows until the estimate stays.

    Args:
        method: how rows are restated.
        observation: the rows as they are.
        beta: base parameters to begin with, (p,).
        friction: share of the speed within which dry friction turns over.
    """
    smoothed = smooth(observation.device, observation.motions, friction)
    rows = method.restate(observation, smoothed, beta)
    moved = np.inf
    for count in range(1, method.most + 1):
        found = estimate(rows, method.inner)
        moved = float((np.abs(found.beta - beta) / np.maximum(found.sd, np.finfo(float).tiny)).max())
        if moved <= method.tolerance or count == method.most:
            break
        beta, rows = _next(method, observation, smoothed, beta, found.beta)
    settled = moved <= method.tolerance
    note = f"Simulated and fitted in {count} passes; the last moved no parameter by more than {moved:.2g} deviations"
    note += "." if settled else f" (limit {method.tolerance:g}): more passes, or a better start, are needed."
    status = found.status if settled else "weak"
    return replace(found, observation=observation, method=method, status=status, notes=(*found.notes, note))


def _next(
    method: Restated, observation: Observation, smoothed: Device, before: Array, found: Array
) -> tuple[Array, Observation]:
    """The next parameters and their rows; where the model runs away, nearer to those before."""
    for _ in range(HALVINGS):
        try:
            return found, method.restate(observation, smoothed, found)
        except (SimulationLostError, MasslessError):
            found = 0.5 * (before + found)
    return found, method.restate(observation, smoothed, found)


def treated_as(device: Device, course: Course) -> Motion:
    """The simulated motion, treated as the measured one was; its torque is the measured one."""
    motion = course.motion
    to_channels = np.linalg.inv(position_map(device, motion)(np.eye(motion.q.shape[1])))
    q, qd, qdd = (np.ascontiguousarray((to_channels @ x).T) for x in (course.c, course.cd, course.cdd))
    if motion.log is not None:
        return treat(replace(motion.log, position=q), motion.treatment)
    return replace(motion, q=q, rates=None if motion.rates is None else (qd, qdd))


def along(observation: Observation, motions: list[Motion]) -> Observation:
    """The observation with its rows made from other motions, one for each of its own, with the same samples."""
    names = {_name(old): _name(new) for old, new in zip(observation.motions, motions, strict=True)}
    blocks = tuple(replace(block, log=names[block.log]) for block in observation.blocks)
    return Rows(replace(observation, motions=tuple(motions), blocks=blocks)).folded(lambda stretch: stretch)


def _name(motion: Motion) -> str:
    """As blocks have it."""
    return motion.log.sha256 if motion.log else f"motion {id(motion):x}"
