"""Planned motions: within limits and clear of collisions, and the optimised ones with their quality."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.trajectories import Trajectory, TrajectoryKind, plan
from haptid.experiment.collision import Clearance
from haptid.experiment.excitation.criteria import Quality
from haptid.experiment.excitation.limits import MotionBounds

# Step at which a motion is checked for collisions, and its duration told, s.
CHECK_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """A motion within limits.

    Attributes:
        kind: of motion; the bench plans it.
        seed: of its phases.
        bounds: its limits.
        clearance: least distance of collision shapes along the whole motion; None without shapes.
    """

    model: DynamicModel
    kind: TrajectoryKind
    seed: int
    bounds: MotionBounds
    clearance: Clearance | None

    def trajectory(self, dt: float) -> Trajectory:
        """The motion in steps of dt, s: the same that the bench plans from its experiment file."""
        return plan(self.kind, self.model, dt, phases(self.seed))

    @cached_property
    def seconds(self) -> float:
        """Duration, s."""
        made = self.trajectory(CHECK_STEP)
        return (len(made) - 1) * made.dt


@dataclass(frozen=True, eq=False)
class Excitation(PlannedMotion):
    """An optimised exciting motion with its quality.

    Attributes:
        before: quality of the first feasible motion of the search.
        after: quality of the motion found.
        tried: number of motions evaluated.
        noise: standard deviation of a row of each motor, (motors,), N m or N.
        history: number of motions evaluated, and least cost of the criterion, at each improvement.
    """

    before: Quality
    after: Quality
    tried: int
    noise: Array
    history: tuple[tuple[int, float], ...] = ()

    @cached_property
    def predicted(self) -> dict[str, float]:
        """Predicted relative standard error of each parameter by name, per cent of its value, for white noise."""
        return dict(zip(self.after.names, self.after.relative_se.tolist(), strict=True))

    def summary(self) -> str:
        """As text: condition number before and after, and the predicted standard errors."""
        lines = [f"{len(self.after.names)} parameters, {self.tried} motions evaluated"]
        for when, found in (("before", self.before), ("after", self.after)):
            lines.append(f"  {when:6s} condition {found.raw:.4g} raw, {found.scaled:.4g} with unit columns")
        if self.clearance is not None:
            lines.append(f"  {self.clearance}")
        lines.append(f"  predicted standard errors, {self.after.rows} rows with white noise:")
        units = [self.after.observation.base.units[k] for k in self.after.columns]
        for name, se, unit, percent in zip(self.after.names, self.after.se, units, self.after.relative_se, strict=True):
            share = f" ({percent:.3g} %)" if np.isfinite(percent) else ""
            lines.append(f"    {name:8s} {se:9.3g} {unit}{share}")
        return "\n".join(lines)


def phases(seed: int) -> np.random.Generator:
    """The random stream of phases that the bench uses for an experiment of this seed."""
    return np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
