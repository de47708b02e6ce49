"""`NuisanceProblem`: base parameters and nuisances (delays, home offsets, the direction of gravity) from the same rows.

The torque is linear in a small nuisance to first order: its slope along the motion, of the *model's* torque, is one
more column. Columns change with parameters and nuisances, so callers take Gauss-Newton steps, with a prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate, Spread
from haptid.estimation.intervals.cluster_robust import ClusterRobust, clustered
from haptid.estimation.least_squares import Solution
from haptid.estimation.method import Fit
from haptid.estimation.methods.gls import Whitening, residual_models
from haptid.estimation.methods.wls import WLS
from haptid.motion.motion import Motion
from haptid.observation.augmented import AugmentedPlan, CandidateColumns, augmented_plan, reduced
from haptid.observation.observation import MotorRows, Observation, stacked
from haptid.observation.plan import Block
from haptid.observation.rows import Chunk, Rows
from haptid.treatment_choice.first_fit import LEAST_EXCITED, residual_memory, solve_excited

# The nuisance that a column belongs to, and the column.
NuisanceColumn = tuple[int, CandidateColumns]
# Highest order of the autoregressive model of a residual: enough for noise, too low to follow what the model lacks.
_ORDER = 2
# Samples whose rows are in memory together.
_PIECE = 1 << 13


@dataclass(frozen=True, eq=False)
class NuisanceProblem:
    """Least squares in the base parameters and the nuisances' changes, from R factors by motor and block.

    Attributes:
        model, motions: of the rows.
        rows: R factors with columns of the nuisances after those of the base parameters.
        beta: parameters that the columns were computed with, (p,).
        count: number of nuisances.
        plans: of the rows, each with the place of its columns among those of the rows.
        known_memory: integral time of the residual by a problem almost the same, s; computed where None.
    """

    model: DynamicModel
    motions: Sequence[Motion]
    rows: Observation
    beta: Array
    count: int
    plans: Sequence[tuple[AugmentedPlan, np.ndarray]]
    known_memory: float | None = None

    @staticmethod
    def of(
        model: DynamicModel,
        motions: Sequence[Motion],
        beta: Array,
        chi: Array,
        columns: Sequence[Sequence[NuisanceColumn]],
    ) -> NuisanceProblem:
        """From treated motions.

        Args:
            motions: of the rows.
            beta: base parameters, (p,), SI.
            chi: parameters of the core's columns that the slopes are computed with, (r,), SI.
            columns: of each motion, each with its nuisance; those of one nuisance and motor are added.
        """
        p, rows = len(beta), [int(k) for k in np.flatnonzero(model.device.known)]
        blocks: list[Block] = []
        parts, plans = [], []
        for motion, own in zip(motions, columns, strict=True):
            wide = augmented_plan(model, motion, chi, [column for _, column in own])
            place = np.append(np.arange(p), [p + nuisance for nuisance, _ in own]).astype(int)
            parts.append([replace(m, columns=place[m.columns]) for m in reduced(wide, rows, list(wide.segments()))])
            blocks.extend(wide.blocks())
            plans.append((wide, place))
        motors = tuple(map(_joined, zip(*parts, strict=True)))
        count = 1 + max(nuisance for own in columns for nuisance, _ in own)
        together = Observation(model, motors, tuple(blocks), tuple(motions))
        return NuisanceProblem(model, motions, together, beta, count, plans)

    @cached_property
    def memory(self) -> float:
        """Integral time of the residual's autocorrelation, s."""
        if self.known_memory is not None:
            return self.known_memory
        return residual_memory(self.model, self.motions, self.beta)

    @cached_property
    def weights(self) -> Array:
        """One over each motor's residual, less for residuals with memory: rows count as many as are independent."""
        without = np.append(self.beta, np.zeros(self.count))
        w = np.array([WLS().weight(motor, without) for motor in self.rows.motors])
        step = self.motions[0].treatment.decimation * self.motions[0].dt
        return np.asarray(w / np.sqrt(max(self.memory / step, 1.0)))

    def residual(self, weights: Array) -> float:
        """Sum of squares that the base parameters leave of the rows, with the nuisances as they are.

        Args:
            weights: of each motor's rows, (motors,).
        """
        p = len(self.beta)
        rows = stacked(self.rows.motors, weights, p + self.count)
        X, y = rows[:, :p], rows[:, -1]
        lengths = np.linalg.norm(X, axis=0)
        solution = np.linalg.lstsq(X / np.where(lengths > 0, lengths, 1.0), y, rcond=LEAST_EXCITED)[0]
        return float(np.sum((y - X / np.where(lengths > 0, lengths, 1.0) @ solution) ** 2))

    def solve(self, off: Array, prior: Array) -> tuple[Array, Array, Spread]:
        """Parameters (p,), the nuisances' change (count,), and its covariance with degrees of freedom.

        Args:
            off: prior mean of the change, (count,), SI.
            prior: its covariance, (count, count).
        """
        p, m = len(self.beta), len(off)
        solution = self._solution(off, prior)
        spread = clustered(self.rows, self.weights, solution, np.eye(p + m)[p:])
        return solution.beta[:p], solution.beta[p:], spread

    def moves(self, prior: Array) -> tuple[Array, Array, Array]:
        """By how much each block's errors move the nuisances, and their covariance by the rows and by the prior.

        Args:
            prior: covariance of the nuisances before, (count, count).

        Returns:
            (blocks, count), (count, count) and (count, count), SI.
        """
        p = len(self.beta)
        fit = Fit(self.rows, self.weights, self._solution(np.zeros(self.count), prior), True)
        own, moments = fit.solution.root[p:], fit.pooled_moments
        moved = np.zeros((len(self.rows.blocks), self.count))
        moved[moments.block] = moments.s @ own.T
        pull = own @ fit.solution.pull.T if fit.solution.pull is not None else np.zeros((self.count, 0))
        by_prior = pull @ pull.T
        whole = ClusterRobust().spread(fit, np.eye(p + self.count)[p:]).covariance
        return moved, whole - by_prior, by_prior

    def _solution(self, off: Array, prior: Array) -> Solution:
        """Parameters and nuisances' changes, as `solve` has them."""
        p, m = len(self.beta), len(off)
        whiten = np.linalg.inv(np.linalg.cholesky(prior))
        known = np.zeros((m, p + m + 1))
        known[:, p:-1], known[:, -1] = whiten, whiten @ off
        return solve_excited(self.rows.motors, self.weights, known)

    @cached_property
    def whitening(self) -> Whitening:
        """What whitens its rows in time: a low autoregressive model of each motor's residual.

        The parallel filter leaves neighbouring rows alike. A model relates rows that are half a period of its cut-off
        apart, so that noise that was white before the filter stays as it is.
        """
        motion = self.motions[0]
        cutoff, step = motion.treatment.parallel(motion.dt), motion.treatment.decimation * motion.dt
        stride = max(1, round(0.5 / (cutoff * step))) if cutoff else 1
        left = np.append(self.beta, np.zeros(self.count))
        return Whitening(residual_models(_Rows(self), left, _ORDER, stride), stride)

    def whitened(self, whitening: Whitening) -> NuisanceProblem:
        """The problem with its rows whitened in time."""
        motion = self.motions[0]
        apart = whitening.stride * motion.treatment.decimation * motion.dt
        return replace(self, rows=_Rows(self).folded(whitening), known_memory=apart)

    def sensitivity(self, estimate: Estimate) -> Array:
        """Derivative of an estimate's parameters by each nuisance, (p, count), SI.

        The parameters move by (W'W)^-1 W'D for a change of a nuisance with column D, as in a fit with the nuisances as
        further columns.
        """
        p, root = len(self.beta), estimate.fit.solution.root
        made = np.zeros((p, self.count))
        for motor, weight in zip(self.rows.motors, estimate.weights, strict=True):
            own = motor.columns < p
            cross = motor.whole[:, :-1].T @ motor.whole[:, :-1]
            made[np.ix_(motor.columns[own], motor.columns[~own] - p)] += weight**2 * cross[np.ix_(own, ~own)]
        return np.asarray(-root @ (root.T @ made))

    def propagated(self, estimate: Estimate, covariance: Array) -> Array:
        """By how much one standard error of the nuisances' principal directions moves the parameters, (count, p)."""
        values, vectors = np.linalg.eigh(covariance)
        return np.asarray((self.sensitivity(estimate) @ (vectors * np.sqrt(np.maximum(values, 0.0)))).T)


class _Rows(Rows):
    """The rows of a problem, chunk by chunk."""

    def __init__(self, problem: NuisanceProblem) -> None:
        super().__init__(problem.rows)
        self.problem = problem

    def __iter__(self) -> Iterator[Chunk]:
        known, done = self.problem, 0
        own = known.model.known_rows
        for plan, place in known.plans:
            step = plan.block * max(1, _PIECE // (plan.block * plan.motion.treatment.decimation))
            for start in range(0, plan.rows, step):
                stop = min(start + step, plan.rows)
                first = done + start // plan.block
                blocks = tuple(range(first, first - (start - stop) // plan.block))
                chunk = Chunk(plan, start, stop, plan.model, own, blocks)
                yield chunk.with_rows(chunk.W @ np.eye(len(known.beta) + known.count)[place], chunk.y)
            done += len(plan.blocks())


def _joined(parts: Sequence[MotorRows]) -> MotorRows:
    """Rows of one motor along several motions, whose columns may differ, in the columns of all of them."""
    columns = np.unique(np.concatenate([part.columns for part in parts]))
    if len(parts) == 1 and np.array_equal(columns, parts[0].columns):
        return parts[0]
    size = len(columns) + 1
    r_factors = []
    for part in parts:
        many, n = part.r_factors.shape[:2]
        place = np.append(np.searchsorted(columns, part.columns), size - 1)
        made = np.zeros((many, n, size))
        for k, column in enumerate(place):
            made[:, :, column] += part.r_factors[:, :, k]
        wide = np.zeros((many, size, size))
        wide[:, : min(n, size)] = made if n <= size else np.linalg.qr(made, mode="r")
        r_factors.append(wide)
    rows = np.concatenate([part.rows for part in parts])
    return replace(parts[0], columns=columns, r_factors=np.concatenate(r_factors), rows=rows)
