"""Torque of rows as a linear filter of small motion, at poses of a motion: what noise of the positions passes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import coordinates, position_map
from haptid.motion.motion import Motion

# Poses of the motion over which noise is averaged.
_POSES = 24


@dataclass(frozen=True, eq=False)
class SmallMotion:
    """The linearised model at poses of a motion, along which some joints are not measured and follow the others.

    Attributes:
        rows, known, unknown: places of the rows with a residual, of the joints that are measured, and of the others.
        moved: of the measured joints by the position channels, (known, channels).
        by_beta: derivatives of impedances by the parameters, (poses, n, p, 3, joints).
        impedance: of all rows to position, velocity and acceleration of the joints, (3, poses, n, joints).
        own: how the unknown joints move the coordinates, (unknown, n).
    """

    rows: Sequence[int]
    known: np.ndarray
    unknown: np.ndarray
    moved: Array
    by_beta: Array
    impedance: Array
    own: Array

    @staticmethod
    def along(
        model: DynamicModel, base: Array, beta: Array, motion: Motion, unknown: np.ndarray, rows: Sequence[int]
    ) -> SmallMotion:
        """At poses that are spread over a motion.

        Args:
            model: the dynamic model; dry friction that jumps has no slope, as in rows away from reversals.
            base: maps base parameters to the core's columns, (r, p).
            beta: base parameters, (p,).
            motion: of all joints.
            unknown: joints that are not measured; their rows are solved for them.
            rows: places of the rows with a residual.
        """
        device = model.device
        low, high = motion.usable
        samples = np.linspace(low, high - 1, _POSES + 2).astype(int)[1:-1]
        c, cd, cdd = (np.ascontiguousarray(x[:, samples - low]) for x in coordinates(device, motion, low, high))
        B = np.asarray(device.row_map)
        known = np.delete(np.arange(len(B)), unknown)
        moved = (np.linalg.inv(B) @ position_map(device, motion)(np.eye(motion.q.shape[1])))[known]
        parts = [_impedances(ForwardDynamics(model, base[:, k]), c, cd, cdd, B) for k in range(len(beta))]
        by_beta = np.array(parts).transpose(2, 3, 0, 1, 4)
        impedance = np.einsum("arkdj,k->darj", by_beta, beta)
        return SmallMotion(rows, known, unknown, moved, np.ascontiguousarray(by_beta), impedance, B[:, unknown].T)

    def at(self, s: np.ndarray) -> At:
        """At complex frequencies, (k,), 1/s."""
        s = s[:, None, None, None]
        A = self.impedance[0] + s * self.impedance[1] + s**2 * self.impedance[2]
        back = np.linalg.inv(self.own @ A[..., self.unknown]) @ self.own
        through = np.eye(A.shape[-2])[self.rows] - A[..., self.rows, :][..., self.unknown] @ back
        return At(self, s, A, back, through, through @ A[..., self.known])


@dataclass(frozen=True, eq=False)
class At:
    """A linearised model at some complex frequencies.

    Attributes:
        of: the model.
        s: frequencies, (k, 1, 1, 1), 1/s.
        A: impedance of all rows, (k, poses, n, joints).
        back: motion of the unknown joints by torque of the rows, (k, poses, unknown, n).
        through: what of all rows' torque is in the residual, (k, poses, rows, n).
        Z: torque of the rows by motion of the known joints, (k, poses, rows, known).
    """

    of: SmallMotion
    s: np.ndarray
    A: np.ndarray
    back: np.ndarray
    through: np.ndarray
    Z: np.ndarray

    def by_parameters(self, spread: np.ndarray) -> np.ndarray:
        """Derivatives of the rows' torque by the parameters, where the known joints move by a spread of channels.

        Args:
            spread: (k, poses, known, channels).

        Returns:
            With what the unknown joints do about it, (k, poses, rows, p, channels).
        """
        of, s, (count, poses) = self.of, self.s, self.Z.shape[:2]
        n, p = of.by_beta.shape[1:3]
        v = np.zeros((count, poses, n, spread.shape[-1]), dtype=complex)
        v[..., of.known, :] = spread
        v[..., of.unknown, :] = -self.back @ (self.A[..., of.known] @ spread)
        rates = np.concatenate([v, s * v, s**2 * v], axis=2)
        direct = of.by_beta.reshape(poses, n * p, -1) @ np.concatenate([rates.real, rates.imag], axis=-1)
        direct = direct[..., : v.shape[-1]] + 1j * direct[..., v.shape[-1] :]
        made = self.through @ direct.reshape(count, poses, n, -1)
        return np.asarray(made.reshape(count, poses, len(of.rows), p, -1))


def _impedances(forward: ForwardDynamics, c: Array, cd: Array, cdd: Array, B: Array) -> Array:
    """Derivatives of the rows' torque by positions, velocities and accelerations of the joints, (3, poses, n, n)."""
    return np.asarray(forward.slopes(c, cd, cdd).transpose(1, 3, 0, 2) @ B)
