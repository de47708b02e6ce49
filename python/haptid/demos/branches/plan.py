"""Branches of one device: the plan, the experiments of each, the published tables and figures."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import Field

from haptid._internal.arrays import Array
from haptid.demos.plan import Demo, Part
from haptid.demos.tables import Table, read_table
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import sweep

Pair = tuple[float, float]


class Branch(Part):
    """One branch: experiments, and the published table."""

    key: str
    title: str
    experiment: str = Field(description="whose log identifies")
    unseen: str = Field(description="another motion, for the cross test")
    friction: str = Field(description="each joint in turn at constant velocities")
    table: str


class Stretch(Part):
    """What is taken of the logs, s, and how many samples make a row."""

    identify: Pair
    unseen: Pair
    decimation: int
    friction_edge: float = Field(description="left out at both ends of the friction test, s")
    friction_cutoff_hz: float


class Drawn(Part):
    """A published figure of torques: which branch and motor, on the log that identifies or on the unseen one."""

    file: str
    title: str
    branch: str
    motor: str
    unseen: bool
    seconds: float


class Sweep(Part):
    """A published sweep of one joint, others fixed, and the masses read from its axes."""

    key: str
    title: str
    label: str
    joint: str
    degrees: Pair
    turned: float = Field(0.0, description="position of the joint less the plotted angle, degrees")
    pose: dict[str, float] = Field(description="of the other active joints, degrees")
    poses: int
    published: tuple[Pair, Pair, Pair] = Field(description="ranges of the masses, largest first, kg")

    @property
    def plotted(self) -> Array:
        """Angles of the axis, (poses,), degrees."""
        return np.linspace(*self.degrees, self.poses)

    def along(self, model: DynamicModel) -> Array:
        """Poses, (active, poses), rad."""
        names = [model.device.joint_names[j] for j in model.device.active]
        start = [np.radians(self.pose.get(name, 0.0)) for name in names]
        return sweep(start, names.index(self.joint), np.radians(self.plotted + self.turned))


class Statement(Part):
    """A printed figure of a sweep's largest mass."""

    sweep: str
    what: Literal["greatest", "least", "variation"]
    published: float = Field(description="kg")


class Posture(Part):
    """A pose at which everything at the handle is told."""

    degrees: dict[str, float]
    speeds: tuple[float, ...] = Field(description="of the handle, for the force that the linear form neglects, m/s")
    stiffness: dict[str, float] = Field(description="of the motors' joints, assumed, N m/rad")
    limits: dict[str, float] = Field(description="torque of the motors, assumed, N m")

    def at(self, model: DynamicModel) -> Array:
        """(active, 1), rad."""
        names = [model.device.joint_names[j] for j in model.device.active]
        return np.radians([[self.degrees[name]] for name in names])


class Compensating(Part):
    """Compensation on the bench: a hand shakes the handle along its largest mass, without the law and with it.

    Friction is off in that trial, so that what the hand feels is mass alone.
    """

    branch: str
    sweep: str
    degrees: tuple[float, ...] = Field(description="of the sweep's joint")
    share: float
    shaken_hz: float
    newtons: float
    seconds: float
    settled: float = Field(description="left out at the beginning, s")
    hand_stiffness: float = Field(description="of a hand that holds the handle, assumed, N/m")
    hand_damping: float = Field(description="of the same, N s/m")


class Branches(Demo):
    """A demonstration with branches of one device."""

    kind: Literal["branches"]
    stretch: Stretch
    branches: tuple[Branch, ...]
    drawn: tuple[Drawn, ...]
    sweeps: tuple[Sweep, ...]
    statements: tuple[Statement, ...]
    posture: Posture
    compensation: Compensating

    @cached_property
    def tables(self) -> dict[str, Table]:
        """Published parameters by branch: columns "cad", "identified" and "relative"."""
        return {branch.key: read_table(self.folder / branch.table) for branch in self.branches}

    def branch(self, key: str) -> Branch:
        """One of the branches."""
        return next(branch for branch in self.branches if branch.key == key)

    def sweep(self, key: str) -> Sweep:
        """One of the sweeps."""
        return next(sweep for sweep in self.sweeps if sweep.key == key)
