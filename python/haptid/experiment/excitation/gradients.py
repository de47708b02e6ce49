"""Gradient of criterion and limit penalties with respect to the state at every sample.

Rows depend on the state of their own sample only, so one adjoint sweep of the core gives the derivatives with respect
to all positions, velocities and accelerations, whatever the number of harmonics.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
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
        """Scale factors of the core's columns by torque, (rows, columns); zero for torques that are not measured.

        Every core column belongs to at most one parameter.
        """
        model, columns = self.bounds.model, self.selection[0]
        made = np.zeros((model.mechanism.coordinates, len(columns)))
        made[list(model.device.measured)] = self.scaling.factors @ self.selection[1].T
        return freeze(made)


@dataclass(frozen=True, eq=False)
class Beyond:
    """What of a motion is beyond limits that hold at a sample, or within the margin to them.

    Attributes:
        over: by how much, relative to the limit, (m,).
        sample: where, (m,).
        slopes: derivatives by the state there, (3, active, m).
    """

    over: Array
    sample: np.ndarray
    slopes: Array


def _of_positions(slopes: Array) -> Array:
    """Derivatives by the state, (3, active, m), from those by the positions, (active, m)."""
    return np.stack([slopes, np.zeros_like(slopes), np.zeros_like(slopes)])


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
        return self.gradients.bounds.violations(self.states)

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

    def beyond(self, *, joints: bool = True, reach: float = 0.0) -> Beyond:
        """What is beyond limits that hold at a sample, or within the margin to them.

        Args:
            joints: whether limits of positions, velocities and accelerations of the active joints count.
            reach: besides, what is so near to the margin, relative to the limit; collisions aside.
        """
        bounds, margin, active = self.gradients.bounds, self.gradients.margin, self.states.shape[1]
        values, first = self.violations[0], 0 if joints else bounds.of_joints
        made = [Beyond(np.zeros(0), np.zeros(0, dtype=int), np.zeros((3, active, 0)))]
        there = values[first:] > -margin - reach
        if there.any():
            limit, sample = np.nonzero(there)
            one = np.zeros((len(values), len(limit)))
            one[limit + first, np.arange(len(limit))] = 1.0
            by_state = bounds.gradients(np.ascontiguousarray(self.states[:, :, sample]), one)
            made.append(Beyond(values[limit + first, sample] + margin, sample, by_state))
        flat = bounds.loops.violated(self.states[0], margin + reach) if bounds.loops and reach else self._flat
        if flat is not None and flat[0].any():
            at, excess, slopes = flat
            made.append(Beyond(excess + margin, np.flatnonzero(at), _of_positions(slopes())))
        found = self.nearest
        if found is not None and len(found.distance):
            collision = self._collision
            over = (bounds.limits.clearance - found.distance) / collision.size + margin
            away = collision.slopes(self._followed.q.T, self._followed.G, found)
            made.append(Beyond(over, found.sample, _of_positions(-away.T / collision.size)))
        if len(made) == 1:
            return made[0]
        kinds = zip(*((x.over, x.sample, x.slopes) for x in made[1:]), strict=True)
        return Beyond(*(np.concatenate(parts, axis=-1) for parts in kinds))

    def cost(self, power: float = np.inf) -> float:
        """The smooth criterion without penalties; the criterion itself at an infinite power."""
        criterion, C = self.gradients.criterion, self._unit[1]
        return criterion.value(C) if np.isinf(power) else criterion.smooth(C, power)[0]

    @cached_property
    def _unit(self) -> tuple[Array, Array]:
        """Column lengths that are divided out, (k,), and C of the scaled columns, (k, k)."""
        of = self.gradients
        model, columns = of.bounds.model, of.selection[0]
        motion, own, loops = self.channels.motion, self.channels.own, self.channels.loops
        C = of.mixed(model.mechanism.inner_products(*motion, own, columns, of.factors, loops)) + of.information
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
        penalty, more = self.penalties(weight)
        return cost + penalty, by_state + more

    def slopes_of_whole(self, power: float, weight: float) -> tuple[float, Array]:
        """The same with the penalties of those limits alone that take several samples."""
        cost, by_state = self._criterion(power)
        penalty, more = self._lasting(weight)
        return cost + penalty, by_state + more

    def penalties(self, weight: float) -> tuple[float, Array]:
        """Mean squared violations of the limits, times the weight, and their gradient by states, (3, active, n)."""
        cost, by_state = self._lasting(weight)
        found, scale = self.beyond(), weight / self.states.shape[2]
        if not len(found.over):
            return cost, by_state
        np.add.at(by_state.transpose(2, 0, 1), found.sample, (2 * scale * found.over * found.slopes).transpose(2, 0, 1))
        return cost + scale * float(found.over @ found.over), by_state

    def _lasting(self, weight: float) -> tuple[float, Array]:
        """The part of limits that take several samples."""
        margin, bounds = self.gradients.margin, self.gradients.bounds
        over = [np.maximum(excess + margin, 0.0) for excess, _ in self.over_time]
        if not any(x.any() for x in over):
            return 0.0, np.zeros_like(self.states)
        weights = [2 * weight / len(x) * x for x in over]
        by_state = bounds.over_time_gradients(self.states, self.gradients.dt, weights)
        return weight * sum(float((x**2).mean()) for x in over), by_state

    def _criterion(self, power: float) -> tuple[float, Array]:
        of = self.gradients
        model, (columns, S) = of.bounds.model, of.selection
        lengths, C = self._unit
        cost, B = of.criterion.smooth(C, power)
        if of.scaling.unit.any():  # the length of a unit column is constant: the derivative along it is projected out
            B = B - np.diag(np.where(of.scaling.unit, (B * C).sum(axis=1), 0.0))
            B = B / lengths / lengths[:, None]
        form, channels = np.ascontiguousarray(B if of.one_to_one else S @ B @ S.T), self.channels
        motion, own, loops = channels.motion, channels.own, channels.loops
        by_channel = model.mechanism.form_slopes(*motion, own, columns, form, of.factors, loops)
        return cost, model.device.row_map.T @ channels.by_motion(by_channel)
