"""Joint least squares of logs under several loads: base parameters, payloads and drive gains at once, on R factors.

In the logs of one load the base parameters are an affine function beta = M x + m of the unknowns x: base parameters of
the bare device (friction once per load, since load changes it), and the ten parameters of each payload. The torque of
motor k, computed with the gain of its file, is exp(-theta_k) W (M x + m), with theta_k the logarithm of its true gain
over the file's. Torque noise stays on the left side, so that it causes no bias; total least squares with the torque
among the columns (Gautier and Briot 2014) weights the same errors.

The unknowns need not all be determined: the solution is that of least norm in scaled unknowns, and `determined` says of
a combination of them whether it is one that the rows determine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import ConvergenceError
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.covariance import Spread
from haptid.estimation.least_squares import Solution
from haptid.estimation.method import Fit
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.r_factor import r_factor

# Gauss-Newton: most steps, largest step of a logarithm of gain, and largest change at convergence.
MOST_GAIN_STEPS, LARGEST_GAIN_STEP, GAIN_CONVERGED = 60, 1.0, 1e-9
# Passes in which the motors' weights follow their residuals; then they are held.
WEIGHT_PASSES = 4
# Singular values of the rows with unit columns below this share of the largest count as zero.
RANK_TOLERANCE = 1e-9
# Share of a combination that may lie in undetermined directions.
UNDETERMINED_SHARE = 1e-6
# Residuals below this share of a motor's torque are rounding.
EXACT_SHARE = 1e-12


@dataclass(frozen=True, eq=False)
class LoadedRows:
    """Rows of the logs of one load, and its base parameters beta = M x + m.

    Attributes:
        M: (p, unknowns).
        m: (p,).
    """

    observation: Observation
    M: Array
    m: Array


@dataclass(frozen=True, eq=False)
class JointFit:
    """Solution of the unknowns and of the logarithms of gain.

    Attributes:
        x: unknowns, (n,); those that are not determined are arbitrary.
        gains: indices of the motors whose gain was estimated.
        theta: logarithms of their gains over the file's, (gains,).
        motors: indices of the motors whose rows were used.
        rows: linearised at the solution, in n + gains unknowns.
        weights: of the motors used, (motors,).
        solution: of these rows.
        null: unknowns' directions that the rows do not determine, orthonormal in scaled unknowns, (n + gains, null).
        scale: length of each unknown's column, (n + gains,).
    """

    x: Array
    gains: tuple[int, ...]
    theta: Array
    motors: tuple[int, ...]
    rows: Observation
    weights: Array
    solution: Solution
    null: Array
    scale: Array

    def determined(self, combinations: Array) -> np.ndarray:
        """Whether the rows determine each combination (q, n + gains) of unknowns, (q,)."""
        own = combinations / self.scale
        hidden = np.linalg.norm(own @ self.null, axis=1)
        return np.asarray(hidden <= UNDETERMINED_SHARE * np.linalg.norm(own, axis=1))

    def spread(self, combinations: Array) -> Spread:
        """Cluster-robust covariance and degrees of freedom of combinations (q, n + gains) of unknowns."""
        return ClusterRobust().spread(self._blocks, combinations)

    @cached_property
    def _blocks(self) -> Fit:
        """What the covariance needs of each block, once for all combinations."""
        return Fit(self.rows, self.weights, self.solution, True)

    def of_gains(self) -> Array:
        """Combinations that are the logarithms of gain, (gains, n + gains)."""
        return np.eye(len(self.scale))[len(self.x) :]


def joint_fit(
    loads: Sequence[LoadedRows],
    motors: Sequence[int],
    gains: Sequence[int],
    only: int | None = None,
    start: Array | None = None,
    converged: float = GAIN_CONVERGED,
) -> JointFit:
    """Fit all loads' rows of some motors, with the gains of some of these motors unknown.

    Args:
        loads: rows and affine map of each load; the observations are of one model.
        motors: indices of the motors whose rows are used.
        gains: indices of those whose gain is unknown.
        only: the load in whose rows alone the gains are others than the file's; None for those of all.
        start: logarithms of the gains to begin with, (gains,); zeros where None.
        converged: change of these up to which they have.

    Raises:
        ConvergenceError: Gauss-Newton did not converge.
    """
    n = loads[0].M.shape[1]
    theta = np.zeros(len(gains)) if start is None else start
    weights = np.ones(len(motors))
    place = {motor: n + k for k, motor in enumerate(gains)}
    x, moved, rows = np.zeros(n), np.inf, list[MotorRows]()

    def linearised(of: Sequence[LoadedRows], free: Mapping[int, int]) -> list[MotorRows]:
        thetas = [theta[place[k] - n] if k in place else 0.0 for k in motors]
        return [_linearised(of, k, x, own, free.get(k), n, only) for k, own in zip(motors, thetas, strict=True)]

    # Steps need all blocks together, which is far fewer rows; the covariance needs each.
    light = [replace(load, observation=summed(load.observation)) for load in loads] if place else loads
    for step in range(MOST_GAIN_STEPS):
        if place or not rows:  # without gains the rows are the same in every pass
            # The first passes have no gains: the step of one is linearised about parameters, which are zero before.
            rows = linearised(light, place if step > 1 else {})
        solution, null, scale = rank_revealing(rows, weights, n + len(gains))
        x, change = solution.beta[:n], solution.beta[n:]
        moved = float(np.abs(change).max(initial=0.0))
        theta = theta + change * min(1.0, LARGEST_GAIN_STEP / max(moved, 1e-300))
        if step < WEIGHT_PASSES + bool(gains):
            weights = np.array([_weight(motor, solution.beta) for motor in rows])
        elif moved < converged:
            break
    else:
        raise ConvergenceError(
            f"the drive gains still change by {moved:.2g} after {MOST_GAIN_STEPS} steps, limit {converged:.2g}.",
            found=moved,
            limit=converged,
            advice="Record longer, with a heavier payload that loads every motor.",
        )
    if any(few.observation is not load.observation for few, load in zip(light, loads, strict=True)):
        rows = linearised(loads, place)
        solution, null, scale = rank_revealing(rows, weights, n + len(gains))
    first = loads[0].observation
    blocks = tuple(block for load in loads for block in load.observation.blocks)
    observation = replace(first, motors=tuple(rows), blocks=blocks, motions=(), change=None)
    return JointFit(x, tuple(gains), theta, tuple(motors), observation, weights, solution, null, scale)


def summed(observation: Observation) -> Observation:
    """All rows as one block: what a fit needs of them."""
    if len(observation.blocks) == 1:
        return observation
    motors = (
        replace(motor, r_factors=motor.whole[None], rows=np.array([motor.rows.sum()])) for motor in observation.motors
    )
    return replace(observation, motors=tuple(motors), blocks=observation.blocks[:1])


def _weight(motor: MotorRows, unknowns: Array) -> float:
    """One over the standard deviation of a motor's residual."""
    return float(np.sqrt(motor.rows.sum()) / max(motor.residual(unknowns), EXACT_SHARE * motor.norm, 1e-300))


def _linearised(
    loads: Sequence[LoadedRows], k: int, x: Array, theta: float, gain: int | None, n: int, only: int | None
) -> MotorRows:
    """Rows of motor k in the unknowns, and in the change of its logarithm of gain, which is unknown `gain`."""
    parts, counts = [], []
    first = loads[0].observation.motors[k]
    reached = np.zeros(n, dtype=bool)
    for load in loads:
        reached |= (load.M[load.observation.motors[k].columns] != 0).any(axis=0)
    own = np.flatnonzero(reached)
    for number, load in enumerate(loads):
        motor, own_gain = load.observation.motors[k], only in (None, number)
        s = np.exp(-theta) if own_gain else 1.0
        R, z = motor.r_factors[:, :, :-1], motor.r_factors[:, :, -1]
        M, m = load.M[motor.columns], load.m[motor.columns]
        columns = [s * R @ M[:, own]]
        if gain is not None:
            columns.append(-(own_gain * s * R @ (M @ x + m))[:, :, None])
        wide = np.concatenate([*columns, (z - s * R @ m)[:, :, None]], axis=2)
        missing = max(wide.shape[2] - wide.shape[1], 0)
        parts.append(r_factor(np.pad(wide, ((0, 0), (0, missing), (0, 0)))))
        counts.append(motor.rows)
    indices = own if gain is None else np.append(own, gain)
    return replace(first, columns=indices, r_factors=np.concatenate(parts), rows=np.concatenate(counts))


def rank_revealing(rows: Sequence[MotorRows], weights: Array, size: int) -> tuple[Solution, Array, Array]:
    """Least-norm least-squares solution of motors' rows in scaled unknowns.

    Returns:
        the solution; orthonormal directions of the scaled unknowns that the rows do not determine, (size, null); the
        length of each unknown's column, 1 for a column of zeros, (size,).
    """
    stack = []
    for motor, weight in zip(rows, weights, strict=True):
        wide = np.zeros((len(motor.whole), size + 1))
        wide[:, np.append(motor.columns, size)] = weight * motor.whole
        stack.append(wide)
    both = np.concatenate(stack)
    factor = r_factor(np.pad(both, ((0, max(size + 1 - len(both), 0)), (0, 0))))
    R, z = factor[:-1, :-1], factor[:-1, -1]
    lengths = np.linalg.norm(R, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    u, s, vt = np.linalg.svd(R / scale)
    significant = s > RANK_TOLERANCE * s[0]
    root = (vt[significant].T / s[significant]) / scale[:, None]
    projection = u[:, significant].T @ z
    rest = float(np.hypot(factor[-1, -1], np.linalg.norm(z - u[:, significant] @ projection)))
    dof = int(sum(motor.rows.sum() for motor in rows)) - int(significant.sum())
    return Solution(root @ projection, R, root, rest, dof), vt[~significant].T, scale
