"""Plan of a demonstration with one device in several mountings."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import Field

from haptid.demos.plan import Demo, Part, Table, read_table
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.workspace import Box, Workspace, workspace
from haptid.motion.filters import Causal, HighPass
from haptid.motion.treatment import Treatment

_Triple = tuple[float, float, float]


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
    """The paper's treatment: rows of the momentum equation through a causal low-pass filter L(s)."""

    cutoff_hz: float
    decimation: int
    lags: tuple[float, ...] = Field(description="of the velocity's high-pass, s")
    reversal_speed: float = Field(description="rows whose filter sees a slower motion are left out, rad/s or m/s")

    def treatment(self, dt: float, lag: float | None = None) -> Treatment:
        """The treatment of a log whose command is constant over each sampling period.

        Args:
            dt: sampling period, s.
            lag: of the high-pass that makes the velocity, s; None where the velocity is known.
        """
        return Treatment(
            cutoff_hz=None,
            velocity=None if lag is None else HighPass(1 / (2 * np.pi * lag)),
            formulation="momentum",
            parallel_cutoff_hz=self.cutoff_hz,
            parallel_shape=Causal(),
            decimation=self.decimation,
            reversal_speed=self.reversal_speed,
            torque_delay_s=dt / 2,
        )


class Pair(Part):
    """Two mountings to compare; `flipped` are the targets of which only the sign should differ."""

    first: str
    second: str
    flipped: tuple[str, ...] = ()


class _Place(Part):
    """A workspace: the joint limits of the device file, some of them replaced, and a box for the handle, m."""

    name: str
    title: str
    degrees: dict[str, tuple[float, float]] = Field(default_factory=dict)
    box: tuple[_Triple, _Triple] | None = None

    def of(self, model: DynamicModel) -> Workspace:
        """The workspace of a device."""
        limits = {joint: np.radians(pair).tolist() for joint, pair in self.degrees.items()}
        return workspace(model, limits, None if self.box is None else Box(*self.box))


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
        """Zero-phase, with a pass band wide enough for a hand; no row is left out."""
        return Treatment(cutoff_hz=self.cutoff_hz, decimation=self.decimation, torque_delay_s=dt / 2)


class Tool(Part):
    """A log with a tool at the handle, in one of the mountings."""

    mounting: str
    experiment: str


class PhantomDemo(Demo):
    """One device in several mountings; the targets of its device file must determine all base parameters."""

    kind: Literal["phantom_configurations"]
    bodies: str
    stretch: Halves
    published: Published
    mountings: dict[str, str] = Field(description="titles, by experiment")
    comparisons: tuple[Pair, ...]
    workspaces: tuple[_Place, ...]
    hand: Hand
    tool: Tool

    @cached_property
    def parameters(self) -> Table:
        """Table I: published parameters by target and mounting, in units of command."""
        return read_table(self.folder / "table1.csv")

    @cached_property
    def errors(self) -> Table:
        """Table II: published errors by motor and mounting, per cent."""
        return read_table(self.folder / "table2.csv")
