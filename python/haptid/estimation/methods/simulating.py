"""What methods share that simulate the closed loop: settings, start, and passes until the estimate stays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace

import numpy as np

from haptid._internal.arrays import Array, positive, whole
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.dynamics.model import DynamicModel
from haptid.errors import (
    MethodSettingError,
    NoControllerError,
    SimulationError,
    UnsettledError,
)
from haptid.estimation.estimate import estimate
from haptid.estimation.method import Around, Method, expect_weighting, rows_of
from haptid.estimation.methods.wls import WLS
from haptid.motion.channels import position_map
from haptid.motion.treatment import Motion, treat
from haptid.observation.observation import Observation
from haptid.observation.rows import Rows
from haptid.simulation import PID, Course, Stretches, closed_loop, smooth

# After so many passes each goes half its way: some would otherwise go to and fro between two places.
WHOLE = 5
# A pass that makes the model run away is halved so many times.
HALVINGS = 6


@dataclass(frozen=True, kw_only=True)
class Simulating(Around, ABC):
    """A method that simulates the model, restates the rows with what it did, and fits these, until it stays.

    Attributes:
        weighting: how the rows that the simulation gives are weighted.
        start: the method that gives the first parameters to simulate with.
        most: passes at most.
        tolerance: a pass that moves no parameter by more deviations than this is the last.
        friction: dry friction turns over within this share of a joint's root mean square speed: what it lacks near
            standstill biases dry and viscous friction, and a narrower one takes more steps.
        stretch, settle: length of what is simulated in one go, and of its running in, s.
    """

    weighting: Method = field(default_factory=WLS)
    start: Method = field(default_factory=WLS)
    most: int = 10
    tolerance: float = 0.1
    friction: float = 1e-3
    stretch: float = 0.5
    settle: float = 0.5

    def __post_init__(self) -> None:
        expect_weighting(self.name, self.weighting)
        if not (whole(self.most) and self.most >= 1):
            raise MethodSettingError(self.name, "most", self.most, "a whole number, 1 or more")
        for name in ("tolerance", "friction", "stretch", "settle"):
            if not positive(getattr(self, name)):
                raise MethodSettingError(self.name, name, getattr(self, name), "a finite number above zero")

    @property
    def name(self) -> str:
        return type(self).__name__

    def rows(self, observation: Observation) -> Observation:
        """Rows whose weighted least squares are the estimate: simulated, restated and fitted until it stays.

        Raises:
            NoControllerError, ControllerError: a closed loop without controller, or with that of another device.
            SimulationLostError, MasslessError: the model cannot be simulated from the first parameters.
            UnsettledError: the estimate still moves after `most` passes.
        """
        self.check(observation)
        beta, found = None, estimate(observation, self.start)
        smoothed = smooth(observation.model, observation.motions, self.friction)
        for number in range(self.most):
            goal = found.beta if beta is None or number < WHOLE else 0.5 * (beta + found.beta)
            beta, rows = self._next(observation, smoothed, beta, goal)
            rows = rows_of(self.weighting, rows)
            found = estimate(rows, self.weighting)
            moved = np.abs(found.beta - beta) / np.maximum(found.se, np.finfo(float).tiny)
            if moved.max() <= self.tolerance:
                return rows
        worst = int(np.argmax(moved))
        raise UnsettledError(self.name, self.most, observation.base.names[worst], float(moved[worst]), self.tolerance)

    def _next(
        self, observation: Observation, smoothed: DynamicModel, before: Array | None, found: Array
    ) -> tuple[Array, Observation]:
        """Parameters to simulate with, and rows; where the model runs away, nearer to those before."""
        for _ in range(HALVINGS):
            try:
                return found, self.restate(observation, smoothed, found)
            except SimulationError:
                if before is None:
                    raise
                found = 0.5 * (before + found)
        return found, self.restate(observation, smoothed, found)

    def check(self, observation: Observation) -> None:
        """Raise what is missing before any work."""

    def stretches(self, motion: Motion) -> Stretches:
        """Of one motion."""
        return Stretches.of(len(motion), round(self.stretch / motion.dt), round(self.settle / motion.dt))

    @abstractmethod
    def restate(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows whose least squares are the next estimate; every method has its own."""


@dataclass(frozen=True)
class ClosedLoop(Simulating):
    """One that simulates the device under the controller that moved it.

    Attributes:
        controller: PD or PID with its reference.
    """

    controller: PID | None = None

    @property
    def law(self) -> PID:
        """The controller.

        Raises:
            NoControllerError: there is none.
        """
        if self.controller is None:
            raise NoControllerError(type(self).__name__)
        return self.controller

    def check(self, observation: Observation) -> None:
        """Raise what is missing before any work.

        Raises:
            NoControllerError: there is no controller.
            ControllerError: it is one of another device.
        """
        self.law.figures("kp", observation.model)

    def courses(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> list[Course]:
        """What the model does along every motion."""
        forward = ForwardDynamics(smoothed, sets_of(observation.model, beta))
        found = []
        for place, motion in enumerate(observation.motions):
            steps = closed_loop(forward, self.law, motion, place, self.stretches(motion))
            found.append(steps.course(motion))
        return found


def treated_as(model: DynamicModel, course: Course) -> Motion:
    """The simulated motion, treated as the measured one was; its torque is the measured one."""
    motion = course.motion
    to_channels = np.linalg.inv(position_map(model.device, motion)(np.eye(motion.q.shape[1])))
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
