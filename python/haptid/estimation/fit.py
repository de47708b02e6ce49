"""What a method makes of rows, before anything is said of how far it may be off."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation.least_squares import Solution
from haptid.observation.observation import Observation

# A block that alone carries more than this share of a direction cannot be left out: without it nothing is left.
ALONE = 1.0 - 1e-6
# Cells that are worked on at a time.
TOGETHER = 32
# A parameter leans on such a block when this much of its variance is in that direction.
MOSTLY = 0.1


@dataclass(frozen=True, eq=False)
class Moments:
    """What each block of each motor's rows adds to a fit, in coordinates g in which all of them together are the unit
    matrix: beta = root g, sum G + pull'pull = 1.

    Attributes:
        G: of the columns, (cells, k, k); a cell is one block of one motor, or of all motors.
        s: of columns and residual, W'e, (cells, k): what a cell asks the solution to move, which adds up to zero.
        block: of each cell, (cells,).
    """

    G: Array
    s: Array
    block: np.ndarray

    @cached_property
    def _heavy(self) -> tuple[np.ndarray, Array, Array]:
        """Cells that may carry a direction alone; eigenvalues (heavy, k) and eigenvectors in columns of their G.

        No eigenvalue is larger than the Frobenius norm, so most cells need none computed.
        """
        cells = np.flatnonzero(np.einsum("bij,bij->b", self.G, self.G) > ALONE**2)
        values, vectors = np.linalg.eigh(self.G[cells])
        return cells, values, vectors

    @cached_property
    def moved(self) -> Array:
        """How far g moves back when each cell is left out, (1 - G)^-1 s, (cells, k)."""
        heavy, values, vectors = self._heavy
        light = np.setdiff1d(np.arange(len(self.s)), heavy)
        shrink = 1.0 / (1.0 - np.minimum(values, ALONE))
        moved = np.empty_like(self.s)
        moved[heavy] = np.einsum("bij,bj->bi", vectors, np.einsum("bij,bi->bj", vectors, self.s[heavy]) * shrink)
        eye = np.eye(self.s.shape[1])
        for few in np.array_split(light, 1 + len(light) // TOGETHER):
            moved[few] = np.linalg.solve(eye - self.G[few], self.s[few, :, None])[..., 0]
        return moved

    def alone(self, spread: Array) -> np.ndarray:
        """Combinations (q, k) of g that lean on a single cell, as indices."""
        _, values, vectors = self._heavy
        cells = np.flatnonzero((values > ALONE).any(axis=1))
        single_block = np.where(values[cells, None] > ALONE, np.abs(spread @ vectors[cells]), 0.0)
        return np.flatnonzero(((single_block**2).sum(axis=2) > MOSTLY * (spread**2).sum(axis=1)).any(axis=0))

    def shares(self, spread: Array) -> Array:
        """How much of the variance of combinations (q, k) of g each cell carries, (cells, q)."""
        return np.asarray(np.einsum("bqj,qj->bq", spread @ self.G, spread))


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution and the rows it came from.

    Attributes:
        observation: the rows as least squares saw them: whitened or weighted one by one where the method does that.
        weights: of each motor's rows, (motors,).
        solution: of these rows with these weights.
        unit_residual: whether the weighted residual has unit variance, or its variance is still to be estimated.
        noise: what is taken off the squares of every motor's blocks [W y]'[W y] for noise in the columns, each
            (blocks, p + 1, p + 1) over all base parameters; None where columns are exact.
    """

    observation: Observation
    weights: Array
    solution: Solution
    unit_residual: bool
    noise: Sequence[Array] | None = None

    @cached_property
    def moments(self) -> Moments:
        """Of every block of every motor that has rows."""
        return moments(self.observation, self.weights, self.solution, self.noise)

    @cached_property
    def together(self) -> Moments:
        """Of every block, whatever the motor."""
        return together(self.observation, self.weights, self.solution, self.noise)

    def combined(self, combinations: Array | None) -> Array:
        """Combinations (q, p) of base parameters as combinations of the coordinates of `moments`, (q, k)."""
        return self.solution.root if combinations is None else combinations @ self.solution.root


def moments(
    observation: Observation, weights: Array, solution: Solution, noise: Sequence[Array] | None = None
) -> Moments:
    """What each block of each motor adds to a solution: see `Fit`."""
    blocks, G, s = zip(*_cells(observation, weights, solution, noise), strict=True)
    return Moments(np.concatenate(G), np.concatenate(s), np.concatenate(blocks))


def together(
    observation: Observation, weights: Array, solution: Solution, noise: Sequence[Array] | None = None
) -> Moments:
    """What each block adds to a solution, all motors as one: see `Fit`."""
    many, k = len(observation.blocks), solution.root.shape[1]
    G, s, there = np.zeros((many, k, k)), np.zeros((many, k)), np.zeros(many, dtype=bool)
    for blocks, here, score in _cells(observation, weights, solution, noise):
        G[blocks] += here
        s[blocks] += score
        there[blocks] = True
    return Moments(G[there], s[there], np.flatnonzero(there))


def _cells(
    observation: Observation, weights: Array, solution: Solution, noise: Sequence[Array] | None
) -> Iterator[tuple[np.ndarray, Array, Array]]:
    """Numbers of some blocks of one motor, and their G and s; few at a time, as many would not stay in the caches."""
    for m, (motor, weight) in enumerate(zip(observation.motors, weights, strict=True)):
        filled = np.flatnonzero(motor.rows > 0)
        for blocks in np.array_split(filled, 1 + len(filled) // TOGETHER):
            T = motor.triangles[blocks] * weight
            U = T[:, :, :-1] @ solution.root[motor.columns]
            e = T[:, :, -1] - T[:, :, :-1] @ solution.beta[motor.columns]
            G, s = U.transpose(0, 2, 1) @ U, np.einsum("bij,bi->bj", U, e)
            if noise is not None:
                N = noise[m][blocks]
                G = G - solution.root.T @ N[:, :-1, :-1] @ solution.root
                s = s - (N[:, :-1, -1] - N[:, :-1, :-1] @ solution.beta) @ solution.root
            yield blocks, G, s
