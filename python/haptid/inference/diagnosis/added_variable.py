"""Would a column that the model lacks explain what it leaves? Asked of the same rows, by the same honest intervals.

A test for a missing column is a fit with the column in it (Breusch and Pagan 1980, Review of Economic Studies 47): the
column passes through the same filter and decimation as torque and W, its parameter is estimated beside all others, and
its deviation is the default one, over time blocks, so that neither a serially correlated residual nor the parameters
already fitted pass for structure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy import linalg, stats

from haptid._internal.arrays import Array, freeze, read_only
from haptid.device.terms.term import TermColumn
from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.estimation.intervals.cluster_robust import clustered
from haptid.estimation.least_squares import Solution
from haptid.inference.diagnosis.context import ResidualContext
from haptid.inference.diagnosis.subsample import named, runs
from haptid.motion.treatment import Motion
from haptid.observation.observation import Block, MotorRows, Observation, Plan, Signals, triangle

# Blocks are merged until there are no more than this: enough for a deviation, and quick on long logs.
ENOUGH_BLOCKS = 60
# A column is told from those of the model where this share of its length is outside their range.
INDEPENDENT = 1e-4


@dataclass(frozen=True, eq=False)
class Extra:
    """Columns that the model lacks, all acting on one coordinate.

    Attributes:
        weights: the coordinate, as a combination of the device's coordinates, (active,).
        many: how many columns.
        values: what they are along a motion, (many, samples), SI.
    """

    weights: Array
    many: int
    values: Callable[[ResidualContext], Array]


@dataclass(frozen=True, eq=False)
class Added:
    """What a fit with more columns says of them.

    Attributes:
        gamma: their parameters, (k,), SI.
        covariance: over time blocks, (k, k).
        dof: degrees of freedom, the least of the columns'.
        explained: share of the residual's power that goes with them, of each motor, (motors,).
        moved: how far they move the parameters of the other columns in the fit, in their order, SI.
    """

    gamma: Array
    covariance: Array
    dof: float
    explained: Array
    moved: Array

    def __post_init__(self) -> None:
        for name in ("gamma", "covariance", "explained", "moved"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def se(self) -> Array:
        """Deviation of each, (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def last(self, k: int) -> Added:
        """Only the last k columns, beside the others."""
        return replace(self, gamma=self.gamma[-k:], covariance=self.covariance[-k:, -k:])

    @property
    def p(self) -> float:
        """Probability of so much in a residual without them: Hotelling's T^2, Student's t for one column."""
        k = len(self.gamma)
        dof = self.dof - k + 1
        if dof < 1:
            return 1.0
        T2 = float(self.gamma @ np.linalg.pinv(self.covariance, hermitian=True) @ self.gamma)
        return float(stats.f.sf(T2 * dof / (self.dof * k), k, dof))


@dataclass(frozen=True, eq=False)
class Widened:
    """The rows of an estimate, with more columns beside those of its base parameters.

    Attributes:
        estimate: whose rows.
        observation: the same rows; `columns` beyond the base parameters are the extras'.
        first: column of each extra's first.
        extras: what was added.
    """

    estimate: Estimate
    observation: Observation
    first: tuple[int, ...]
    extras: tuple[Extra, ...]

    def test(self, which: Sequence[int], without: Sequence[int] = (), only: int | None = None) -> Added | None:
        """A fit with some extras in; None where the rows do not tell their columns from the model's.

        Args:
            which: indices of the extras.
            without: base parameters that are left out of the fit.
            only: the one motor whose rows are fitted; all where None.
        """
        chosen = slice(None) if only is None else slice(only, only + 1)
        rows, weights = self.observation.motors[chosen], self.estimate.weights[chosen]
        reached = np.unique(np.concatenate([motor.columns for motor in rows]))
        new = [self.first[e] + j for e in which for j in range(self.extras[e].many)]
        left_out = {*without, *self.estimate.zero}
        kept = np.array([k for k in reached if k < len(self.estimate.beta) and k not in left_out] + new)
        motors = tuple(_pick(motor, kept) for motor in rows)
        whole = stack(motors, weights, len(kept))
        R, z, k = whole[:-1, :-1], whole[:-1, -1], len(new)
        lengths = np.linalg.norm(R, axis=0)
        if (np.abs(np.diag(R))[-k:] <= INDEPENDENT * lengths[-k:]).any() or (np.diag(R) == 0).any():
            return None
        beta = linalg.solve_triangular(R, z)
        moved = -linalg.solve_triangular(R[:-k, :-k], R[:-k, -k:] @ beta[-k:])
        dof = int(sum(motor.rows.sum() for motor in motors)) - len(kept)
        root = linalg.solve_triangular(R, np.eye(len(R)))
        solution = Solution(beta, R, root, abs(float(whole[-1, -1])), dof)
        observation = replace(self.observation, motors=motors)
        made = clustered(observation, weights, solution, np.eye(len(kept))[-k:])
        before = [motor.residual(self.estimate.beta) for motor in self.estimate.observation.motors[chosen]]
        after = [motor.residual(beta) for motor in motors]
        explained = 1.0 - np.square(after) / np.where(np.array(before) > 0, np.square(before), 1.0)
        return Added(beta[-k:], made.covariance, float(made.dof.min()), explained, moved)


def widen(estimate: Estimate, extras: Sequence[Extra]) -> Widened:
    """Observe an estimate's motions once more, with extra columns.

    Args:
        estimate: whose observation holds the motions.
        extras: all columns that will be asked for.
    """
    first = len(estimate.beta) + np.cumsum([0, *(extra.many for extra in extras)])
    parts = [_observed(estimate, motion, extras) for motion in estimate.observation.motions]
    blocks = tuple(block for part, _ in parts for block in part)
    kept = _groups(len(blocks))
    motors = tuple(_merged([motors[m] for _, motors in parts], kept) for m in range(len(parts[0][1])))
    ends = tuple(replace(blocks[group[0]], stop=blocks[group[-1]].stop) for group in kept)
    observation = replace(estimate.observation, motors=motors, blocks=ends)
    return Widened(estimate, observation, tuple(int(k) for k in first[:-1]), tuple(extras))


@dataclass(frozen=True, eq=False)
class _WidePlan(Plan):
    """A plan whose rows have the extras' columns too.

    Attributes:
        narrow: the same without.
        chi: the estimate's parameters of the core's columns, (r,), SI.
        extras: what is added.
    """

    narrow: Plan
    chi: Array
    extras: tuple[Extra, ...]

    def signals(self, low: int, high: int) -> Signals:
        """As of the plan without, and the extras' values below the columns that Python computes."""
        c, cd, cdd, own = self.narrow.signals(low, high)
        sight = ResidualContext(self.narrow, self.chi, low, high)
        return c, cd, cdd, np.concatenate([own, *(extra.values(sight) for extra in self.extras)])


def device_rows(estimate: Estimate) -> list[int]:
    """The device's row of each motor of an estimate's observation."""
    return [estimate.model.device.row_names.index(motor.name) for motor in estimate.observation.motors]


def stack(motors: Sequence[MotorRows], weights: Array, columns: int) -> Array:
    """The triangle of all rows, each motor's multiplied by its weight, (columns + 1, columns + 1)."""
    parts = []
    for motor, weight in zip(motors, weights, strict=True):
        wide = np.zeros((len(motor.whole), columns + 1))
        wide[:, np.append(motor.columns, columns)] = motor.whole * weight
        parts.append(wide)
    return triangle(np.concatenate(parts))


def _observed(
    estimate: Estimate, motion: Motion, extras: Sequence[Extra]
) -> tuple[tuple[Block, ...], tuple[MotorRows, ...]]:
    """Blocks of one motion that the estimate was made from, and every motor's rows."""
    model, plan = estimate.model, Plan.of(estimate.model, motion)
    more = [TermColumn("", "", "external", "", extra.weights) for extra in extras for _ in range(extra.many)]
    columns = len(model.device.parameters.raw) + np.arange(len(more))
    selection = linalg.block_diag(plan.selection, np.eye(len(more)))
    with_more = replace(model, terms=(*model.terms, *more))
    shared = {field.name: getattr(plan, field.name) for field in fields(plan)}
    chi = raw_parameters(model, estimate.beta)
    shared |= {"device": with_more, "columns": (*plan.columns, *columns.tolist()), "selection": selection}
    wide = _WidePlan(**shared, narrow=plan, chi=chi, extras=tuple(extras))
    blocks, spans = plan.blocks(named(motion)), list(runs(plan, estimate.observation.blocks))
    parts = [wide.reduce(start, stop) for start, stop in spans]
    rows = np.concatenate([many for _, many in parts], axis=1)
    motors = tuple(
        MotorRows(
            model.device.row_names[k],
            model.device.row_labels[k],
            model.device.torque_units[k],
            parts[0][0][k][0],
            freeze(np.concatenate([stacks[k][1] for stacks, _ in parts])),
            rows[k],
        )
        for k in device_rows(estimate)
    )
    some = [block for start, stop in spans for block in blocks[start // plan.block : -(-stop // plan.block)]]
    return tuple(some), motors


def _pick(motor: MotorRows, kept: np.ndarray) -> MotorRows:
    """Only some columns, in the order of `kept`, with their places in it as their names."""
    place = {int(column): k for k, column in enumerate(motor.columns)}
    own = np.array([k for k, column in enumerate(kept) if int(column) in place], dtype=int)
    at = [place[int(kept[k])] for k in own] + [len(motor.columns)]
    return replace(motor, columns=own, triangles=np.asarray(np.linalg.qr(motor.triangles[:, :, at], mode="r")))


def _groups(blocks: int) -> list[np.ndarray]:
    """Indices of so many blocks, neighbours together so that the groups are not too many."""
    index, size = np.arange(blocks), -(-blocks // ENOUGH_BLOCKS)
    return [index[k : k + size] for k in range(0, blocks, size)]


def _merged(parts: Sequence[MotorRows], groups: Sequence[np.ndarray]) -> MotorRows:
    """One motor's rows of all motions, group by group."""
    T = np.concatenate([part.triangles for part in parts])
    many = np.concatenate([part.rows for part in parts])
    size = T.shape[-1]
    triangles = np.stack([triangle(T[group].reshape(-1, size)) for group in groups])
    return replace(parts[0], triangles=triangles, rows=np.array([many[group].sum() for group in groups]))
