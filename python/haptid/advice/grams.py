"""Gram matrices of time blocks, each motor's of the columns that act on it: most candidates are of one joint."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass


@dataclass(frozen=True, eq=False)
class Grams:
    """Gram matrices of [W, candidates, y_1 .. y_m], by motor, of every block or summed over some.

    Attributes:
        values: products of the columns that act on a motor, (..., motors, n, n), SI. Place 0 is a column of zeros,
            and the last ones are the torque channels.
        place: of every column of W and the candidates in each motor's matrix, 0 where it does not act, (motors, size).
    """

    values: Array
    place: np.ndarray

    @staticmethod
    def of(W: Array, y: Array, used: np.ndarray, edges: np.ndarray) -> Grams:
        """From rows.

        Args:
            W: columns, (motors, rows, size), SI.
            y: torque of every motor's channel, (motors, rows), N m or N.
            used: rows that count, (motors, rows).
            edges: first row of each block, and one past the last, (blocks + 1,).
        """
        motors = len(W)
        acting = [np.flatnonzero(own[kept].any(axis=0)) for own, kept in zip(W, used, strict=True)]
        size = 1 + max(map(len, acting)) + motors
        values, place = np.zeros((len(edges) - 1, motors, size, size)), np.zeros((motors, W.shape[2]), dtype=int)
        for k, columns in enumerate(acting):
            place[k, columns] = 1 + np.arange(len(columns))
            rows = np.zeros((W.shape[1], size))
            rows[:, 1 : 1 + len(columns)], rows[:, -motors:] = W[k][:, columns], y.T
            rows *= used[k][:, None]
            for made, low, high in zip(values, edges[:-1], edges[1:], strict=True):
                np.matmul(rows[low:high].T, rows[low:high], out=made[k])
        return Grams(values, place)

    def with_torque(self, W: Array, y: Array, used: np.ndarray, edges: np.ndarray) -> Grams:
        """Of the same rows with another torque, whose products alone are computed; arguments as `of` has them."""
        values, motors = self.values.copy(), len(W)
        for k, place in enumerate(self.place):
            columns, own = np.flatnonzero(place), y.T * used[k][:, None]
            for made, low, high in zip(values[:, k], edges[:-1], edges[1:], strict=True):
                right = (W[k, low:high].T @ own[low:high])[columns]
                made[place[columns], -motors:], made[-motors:, place[columns]] = right, right.T
                made[-motors:, -motors:] = own[low:high].T @ own[low:high]
        return replace(self, values=values)

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, blocks: slice) -> Grams:
        return replace(self, values=self.values[blocks])

    @property
    def size(self) -> int:
        """Number of columns of W and the candidates."""
        return int(self.place.shape[1])

    def first(self, columns: int) -> Grams:
        """Of the first columns alone."""
        return replace(self, place=self.place[:, :columns])

    def over(self, blocks: np.ndarray) -> Grams:
        """Sum over some blocks, without a copy of them all."""
        made = np.zeros(self.values.shape[1:])
        for block in blocks:
            made += self.values[block]
        return replace(self, values=made)

    def part(self, rows: np.ndarray, columns: np.ndarray, motors: np.ndarray | None = None) -> Array:
        """Products of some columns with others, (..., motors, rows, columns), of all motors where None are given."""
        motors = np.arange(len(self.place)) if motors is None else motors
        place = self.place[motors]
        return np.asarray(self.values[..., motors[:, None, None], place[:, rows, None], place[:, None, columns]])

    def moved_by(self, columns: np.ndarray) -> np.ndarray:
        """Motors on which some of these columns act."""
        return np.flatnonzero(self.place[:, columns].any(axis=1))

    def right(self, columns: np.ndarray, channels: np.ndarray) -> Array:
        """W'y of some columns and each motor's channel, (..., motors, columns)."""
        motor = np.arange(len(self.place))[:, None]
        return np.asarray(self.values[..., motor, self.place[:, columns], self._torque(channels)[:, None]])

    def squares(self, channels: np.ndarray) -> Array:
        """y'y of each motor's channel, (..., motors)."""
        at = self._torque(channels)
        return np.asarray(self.values[..., np.arange(len(self.place)), at, at])

    def pooled(self, weights: Array) -> Array:
        """W'W summed over the weighted motors, of a sum over blocks, (size, size)."""
        made = np.zeros((self.size, self.size))
        for weight, own, place in zip(weights, self.values, self.place, strict=True):
            acting = np.flatnonzero(place)
            made[np.ix_(acting, acting)] += weight * own[np.ix_(place[acting], place[acting])]
        return made

    @cached_property
    def lengths(self) -> Array:
        """Squared length of each column in each motor's rows, (..., motors, size)."""
        return np.asarray(self.values[..., np.arange(len(self.place))[:, None], self.place, self.place])

    def reversed(self, channel: int) -> Grams:
        """With the sign of a torque channel changed."""
        values, at = self.values.copy(), channel - len(self.place)
        values[..., at] *= -1
        values[..., at, :] *= -1
        return replace(self, values=values)

    def _torque(self, channels: np.ndarray) -> np.ndarray:
        """Places of torque channels, from a matrix' end."""
        return channels - len(self.place)
