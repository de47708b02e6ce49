"""Plan of a demonstration with branches of one device."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import Field

from haptid._internal.arrays import Array
from haptid.demos.plan import Demo, Part, Table, read_table
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import sweep

_Pair = tuple[float, float]


class Branch(Part):
    """One branch: KEY is its experiment that identifies, KEY_unseen and KEY_friction are the other two."""

    key: str
    title: str
    table: str = Field(description="file of the published table")

    @property
    def unseen(self) -> str:
        """Experiment with another motion, for the cross-validation."""
        return f"{self.key}_unseen"

    @property
    def friction(self) -> str:
        """Experiment of the friction test: each joint in turn at constant velocities."""
        return f"{self.key}_friction"


class Stretch(Part):
    """Used times of the logs, s, and treatment."""

    identify: _Pair
    unseen: _Pair
    decimation: int
    friction_edge: float = Field(description="left out at both ends of the friction test, s")
    friction_cutoff_hz: float


class Drawn(Part):
    """A published figure of torques, on the log that identifies or on the unseen one."""

    title: str
    branch: str
    motor: str
    unseen: bool
    seconds: float


class Sweep(Part):
    """A published sweep of one joint with the others fixed, and the ranges of masses read from its axes."""

    key: str
    title: str
    label: str
    joint: str
    degrees: _Pair
    turned: float = Field(0.0, description="position of the joint minus the plotted angle, degrees")
    pose: dict[str, float] = Field(description="of the other active joints, degrees")
    poses: int
    published: tuple[_Pair, _Pair, _Pair] = Field(description="ranges of the masses, largest first, kg")

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
    """A printed number on a sweep's largest mass."""

    sweep: str
    what: Literal["greatest", "least", "variation"]
    published: float = Field(description="kg")


class Posture(Part):
    """A pose at which the end-effector is characterised."""

    degrees: dict[str, float]
    speeds: tuple[float, ...] = Field(description="of the handle, for the neglected velocity forces, m/s")
    stiffness: dict[str, float] = Field(description="of the motors' joints, assumed, N m/rad")
    limits: dict[str, float] = Field(description="torque of the motors, assumed, N m")

    def at(self, model: DynamicModel) -> Array:
        """(active, 1), rad."""
        names = [model.device.joint_names[j] for j in model.device.active]
        return np.radians([[self.degrees[name]] for name in names])


class Compensating(Part):
    """Mass compensation: the search for settings, and a hand on the bench; dry friction is on."""

    branch: str
    sweep: str
    degrees: tuple[float, ...] = Field(description="of the sweep's joint")
    reduction: float = Field(description="wanted, of the felt mass")
    felt_hz: float = Field(description="frequency at which mass and damping are judged")
    velocity_cutoffs_hz: tuple[float, ...]
    momentum_cutoffs_hz: tuple[float, ...]
    shares: tuple[float, ...] = Field(description="of the mass, that are searched")
    frequencies_hz: tuple[float, ...] = Field(description="of the strokes on the bench")
    speed: float = Field(description="of the hand on the bench, m/s")
    seconds: float = Field(description="of the trials with hands")


class Interface(Part):
    """Both branches on one handle: KEY is the experiment that identifies, `unseen` the one that validates."""

    device: str
    key: str
    unseen: str
    identify: _Pair = Field(description="used times of the log, s")
    validate_: _Pair = Field(alias="validate", description="the same of the other log")
    posture: dict[str, float] = Field(description="of the active joints, degrees")
    limits: dict[str, float] = Field(description="torque of the motors, assumed, N m")
    map_poses: int = Field(description="random poses of the workspace, for the maps of the handle")


class CeaDemo(Demo):
    """Branches of one device, and the device that they make."""

    kind: Literal["cea_branches"]
    stretch: Stretch
    branches: tuple[Branch, ...]
    drawn: tuple[Drawn, ...]
    sweeps: tuple[Sweep, ...]
    statements: tuple[Statement, ...]
    posture: Posture
    compensation: Compensating
    interface: Interface | None = None

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
