"""A device in several mountings: the plan, the mountings' experiments and the published tables."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from haptid.demos.plan import Demo, Part
from haptid.demos.tables import Table, read_table
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.workspace import Box, Workspace, workspace
from haptid.motion.filters import Causal, HighPass
from haptid.motion.treatment import Treatment

Triple = Annotated[tuple[float, float, float], Field()]


class Halves(Part):
    """Times that bound the two halves of every log, s: the first identifies, the second validates."""

    start: float
    middle: float
    stop: float

    @property
    def fit(self) -> tuple[float, float]:
        """The half that identifies, s."""
        return self.start, self.middle

    @property
    def unseen(self) -> tuple[float, float]:
        """The half that validates, s."""
        return self.middle, self.stop


class Published(Part):
    """The paper's treatment: momentum rows through a causal low-pass."""

    cutoff_hz: float
    decimation: int
    lags: tuple[float, ...] = Field(description="of the velocity's high-pass, s")
    reversal_speed: float = Field(description="rows whose filter sees a slower motion are left out, rad/s or m/s")

    def treatment(self, dt: float, lag: float | None = None) -> Treatment:
        """The treatment of a command that is held for a sampling period `dt`, s.

        Args:
            dt: sampling period, s.
            lag: of the high-pass that makes the velocity, s; None where the velocity is known.
        """
        return Treatment(
            cutoff_hz=None,
            velocity=None if lag is None else HighPass(1 / (2 * np.pi * lag)),
            accelerations="momentum",
            parallel_cutoff_hz=self.cutoff_hz,
            parallel_shape=Causal(),
            decimation=self.decimation,
            reversal_speed=self.reversal_speed,
            torque_delay_s=dt / 2,
        )


class Mounting(Part):
    """One way in which the device is mounted; the experiment holds what is different."""

    key: str
    title: str
    experiment: str


class Pair(Part):
    """Two mountings that are compared; `flipped` are the targets that alone should differ, by their sign."""

    first: str
    second: str
    flipped: tuple[str, ...] = ()


class Limits(Part):
    """Corners of a box for the handle, m."""

    low: Triple
    high: Triple


class Place(Part):
    """A workspace: the device file's limits, some of them replaced."""

    name: str
    title: str
    degrees: dict[str, tuple[float, float]] = Field(default_factory=dict)
    box: Limits | None = None

    def of(self, model: DynamicModel) -> Workspace:
        """The workspace of a device."""
        limits = {joint: np.radians(pair).tolist() for joint, pair in self.degrees.items()}
        return workspace(model, limits, None if self.box is None else Box(self.box.low, self.box.high))


class Hand(Part):
    """A log in which a hand pushes, in one of the mountings."""

    mounting: str
    experiment: str
    start: float
    stop: float
    axis: int
    cutoff_hz: float
    decimation: int

    def treatment(self, dt: float) -> Treatment:
        """Zero-phase, wide enough for a hand; no row is left out."""
        return Treatment(cutoff_hz=self.cutoff_hz, decimation=self.decimation, torque_delay_s=dt / 2)


class Tool(Part):
    """A log with a tool at the handle, in one of the mountings."""

    mounting: str
    experiment: str


class Mountings(Demo):
    """A demonstration with one device in several mountings.

    The targets of its device must tell all base parameters, as published sets of parameters do.
    """

    kind: Literal["mountings"]
    bodies: str
    table1: str
    table2: str
    stretch: Halves
    published: Published
    mountings: tuple[Mounting, ...]
    comparisons: tuple[Pair, ...]
    workspaces: tuple[Place, ...]
    hand: Hand
    tool: Tool

    @cached_property
    def parameters(self) -> Table:
        """Published parameters, by target and mounting, in units of command."""
        return read_table(self.folder / self.table1)

    @cached_property
    def errors(self) -> Table:
        """Published errors, per cent, by motor and mounting."""
        return read_table(self.folder / self.table2)

    def mounting(self, key: str) -> Mounting:
        """One of the mountings."""
        return next(mounting for mounting in self.mountings if mounting.key == key)
