"""Gradient of criterion and limit penalties with respect to the state at every sample.

Rows depend on the state of their own sample only, so one adjoint sweep of the core gives the derivatives with respect
to all positions, velocities and accelerations, whatever the number of harmonics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid.device import Followed
from haptid.dynamics.regressor import CoreChannels
from haptid.experiment.collision import CollisionModel
from haptid.experiment.collision.distances import Distances
from haptid.experiment.excitation.criteria import Criterion, Scaling
from haptid.experiment.excitation.limits import FLAT_LOOPS, MotionBounds

# Default safety margin to every limit, relative to its size.
MARGIN = 0.03


@dataclass(frozen=True, eq=False)
class Gradients:
    """Criterion and limit penalties as differentiable functions of the states of a motion.

    Attributes:
        bounds: the limits.
        criterion: to be minimised.
        columns: indices of the base parameters in the criterion, (k,).
        scaling: of their rows.
        information: of logs that there are already, in units of the scaled rows, (k, k).
        dt: sampling period of the states, s: of the limits that take several samples.
        margin: to every limit, relative to its size: penalties begin this far inside.
    """

    bounds: MotionBounds
    criterion: Criterion
    columns: tuple[int, ...]
    scaling: Scaling
    information: Array
    dt: float
    margin: float = MARGIN

    def __post_init__(self) -> None:
        freeze_fields(self, information=(len(self.columns),) * 2)

    @staticmethod
    def of(
        bounds: MotionBounds,
        criterion: Criterion,
        columns: tuple[int, ...],
        noise: Array,
        information: Array | None = None,
        dt: float = 0.04,
        margin: float = MARGIN,
    ) -> Gradients:
        """For base parameters `bounds.beta`, noise, (motors,), information of earlier logs, (p, p), SI, and dt, s."""
        which = list(columns)
        scaling = criterion.scaling(np.abs(bounds.beta[which]), noise)
        there = np.zeros((len(which), len(which)))
        if information is not None:  # rows are in units of their noise, entries differ by the parameter's alone
            size = scaling.factors[0] * noise[0]
            there = information[np.ix_(which, which)] * size[:, None] * size
        return Gradients(bounds, criterion, columns, scaling, there, dt, margin)

    def __call__(self, states: Array, power: float, weight: float) -> tuple[float, Array]:
        """Cost plus limit penalties, and the gradient by states, (3, active, n): see `Evaluation.slopes`."""
        return self.at(states).slopes(power, weight)

    def at(self, states: Array) -> Evaluation:
        """A motion by its states, positions, velocities and accelerations of the active joints, (3, active, n)."""
        return Evaluation(self, states)

    @cached_property
    def selection(self) -> tuple[list[int], Array]:
        """Core columns that the parameters need, and the map (columns, k) from parameters to them."""
        model = self.bounds.model
        kept = model.device.parameters.S[:, [model.base.independent_columns[k] for k in self.columns]]
        needed = np.flatnonzero(kept.any(axis=1))
        return needed.tolist(), freeze(np.ascontiguousarray(kept[needed]))

    @cached_property
    def one_to_one(self) -> bool:
        """Whether the core's columns are the parameters'."""
        return np.array_equal(self.selection[1], np.eye(len(self.columns)))

    def mixed(self, products: Array) -> Array:
        """Products of parameters' columns, (k, k), from those of the core's."""
        S = self.selection[1]
        return products if self.one_to_one else np.asarray(S.T @ products @ S)

    @cached_property
    def factors(self) -> Array:
        """Scale factors of products of core columns, by measured torque, (motors, columns, columns).

        Every core column belongs to at most one parameter.
        """
        factors = self.scaling.factors @ self.selection[1].T
        return freeze(factors[:, :, None] * factors[:, None])


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Criterion and limits at one motion: every quantity is computed once, when it is first needed.

    Attributes:
        gradients: the criterion and the limits.
        states: of the active joints, (3, active, n).
    """

    gradients: Gradients
    states: Array

    @cached_property
    def channels(self) -> CoreChannels:
        """Input channels of the core."""
        return self.gradients.bounds.channels(self.states)

    @cached_property
    def violations(self) -> tuple[Array, tuple[str, ...]]:
        """Relative violations of the limits that have a slope at every sample, (limits, n), and their names."""
        found = list(self.gradients.bounds.by_sample(self.states))
        return np.array([excess for excess, _ in found]), tuple(name for _, name in found)

    @cached_property
    def over_time(self) -> list[tuple[Array, str]]:
        """Relative violations of the limits that take several samples, and their names."""
        return self.gradients.bounds.over_time(self.states, self.gradients.dt)

    @cached_property
    def _flat(self) -> tuple[np.ndarray, Array, Callable[[], Array]] | None:
        """See `LoopLimit.violated`; None without loops that can become flat."""
        loops = self.gradients.bounds.loops
        return None if loops is None else loops.violated(self.states[0], self.gradients.margin)

    @cached_property
    def excesses(self) -> list[tuple[float, str]]:
        """Largest relative violation of each limit, at most 0 where it is met, and the name of the limit."""
        values, names = self.violations
        made = list(zip(values.max(axis=1).tolist(), names, strict=True))
        made += [(float(excess.max()), name) for excess, name in self.over_time]
        if self._flat is not None:
            made.append((float(self._flat[1].max(initial=-self.gradients.margin)), FLAT_LOOPS))
        if self.nearest is not None and len(self.nearest.distance):
            collision, k = self._collision, int(np.argmin(self.nearest.distance))
            worst = (self.gradients.bounds.limits.clearance - float(self.nearest.distance[k])) / collision.size
            made.append((worst, f"the clearance of {collision.label(int(self.nearest.pair[k]))}"))
        return made

    @cached_property
    def worst(self) -> float:
        """The largest of them."""
        return max(excess for excess, _ in self.excesses)

    @property
    def _collision(self) -> CollisionModel:
        assert self.gradients.bounds.collision is not None  # as where there are distances
        return self.gradients.bounds.collision

    @cached_property
    def _followed(self) -> Followed:
        return self.gradients.bounds.model.device.closure.follow(self.states[0])

    @cached_property
    def nearest(self) -> Distances | None:
        """Distances of shapes that are within the clearance and its margin; None without shapes."""
        bounds = self.gradients.bounds
        if bounds.collision is None:
            return None
        reach = bounds.limits.clearance + self.gradients.margin * bounds.collision.size
        return bounds.collision.near(self._followed.q.T, reach)

    def _collisions(self) -> tuple[float, Array]:
        """Mean squared violations of the clearance, relative to the size of the shapes, and their gradient."""
        states, found = self.states, self.nearest
        by_state = np.zeros_like(states)
        if found is None or not len(found.distance):
            return 0.0, by_state
        collision, n = self._collision, states.shape[2]
        over = (self.gradients.bounds.limits.clearance - found.distance) / collision.size + self.gradients.margin
        slopes = collision.slopes(self._followed.q.T, self._followed.G, found)
        np.add.at(by_state[0].T, found.sample, (-2 / n / collision.size * over)[:, None] * slopes)
        return float((over**2).sum()) / n, by_state

    def cost(self, power: float = np.inf) -> float:
        """The smooth criterion without penalties; the criterion itself at an infinite power."""
        criterion, C = self.gradients.criterion, self._unit[1]
        return criterion.value(C) if np.isinf(power) else criterion.smooth(C, power)[0]

    @cached_property
    def _unit(self) -> tuple[Array, Array]:
        """Column lengths that are divided out, (k,), and C of the scaled columns, (k, k)."""
        of = self.gradients
        model, columns = of.bounds.model, of.selection[0]
        made = model.mechanism.inner_products(*self.channels.motion, self.channels.own, columns, self.channels.loops)
        measured = made if all(model.device.measured) else made[list(model.device.measured)]
        C = of.mixed(np.einsum("aij,aij->ij", measured, of.factors)) + of.information
        if not of.scaling.unit.any():
            return np.ones(len(C)), C
        lengths = np.where(of.scaling.unit, np.sqrt(np.diag(C)), 1.0)
        lengths = np.maximum(lengths, np.finfo(float).tiny)
        return lengths, C / lengths / lengths[:, None]

    def slopes(self, power: float, weight: float) -> tuple[float, Array]:
        """Cost plus limit penalties, and the gradient by states, (3, active, n).

        Args:
            power: of the smooth criterion.
            weight: of the penalties.
        """
        cost, by_state = self._criterion(power)
        penalty, more = self._limits(weight)
        return cost + penalty, by_state + more

    def _criterion(self, power: float) -> tuple[float, Array]:
        of = self.gradients
        model, (columns, S) = of.bounds.model, of.selection
        lengths, C = self._unit
        cost, B = of.criterion.smooth(C, power)
        if of.scaling.unit.any():  # the length of a unit column is constant: the derivative along it is projected out
            B = B - np.diag(np.where(of.scaling.unit, (B * C).sum(axis=1), 0.0))
            B = B / lengths / lengths[:, None]
        forms = np.zeros((model.mechanism.coordinates, len(columns), len(columns)))
        forms[list(model.device.measured)] = of.factors * (B if of.one_to_one else S @ B @ S.T)
        channels = self.channels
        by_channel = model.mechanism.form_slopes(*channels.motion, channels.own, columns, forms, channels.loops)
        return cost, model.device.row_map.T @ channels.by_motion(by_channel)

    def _limits(self, weight: float) -> tuple[float, Array]:
        """Mean squared violations of the limits, and their gradient."""
        states, bounds, margin = self.states, self.gradients.bounds, self.gradients.margin
        over, n, by_state = np.maximum(self.violations[0] + margin, 0.0), states.shape[2], np.zeros_like(states)
        violated = over.any(axis=0)
        if violated.any():
            there = np.ascontiguousarray(states[:, :, violated])
            by_state[:, :, violated] = bounds.gradients(there, 2 / n * over[:, violated])
        cost = float((over**2).sum()) / n
        if self._flat is not None and self._flat[0].any():
            at, excess, slopes = self._flat
            by_state[0][:, at] += 2 / n * (excess + margin) * slopes()
            cost += float(((excess + margin) ** 2).sum()) / n
        near, by_distance = self._collisions()
        lasting = [np.maximum(excess + margin, 0.0) for excess, _ in self.over_time]
        if any(x.any() for x in lasting):
            by_state += bounds.over_time_gradients(states, self.gradients.dt, [2 / len(x) * x for x in lasting])
        near += sum(float((x**2).mean()) for x in lasting)
        return weight * (cost + near), weight * (by_state + by_distance)
