"""Total least squares: noise in the columns as well as in the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid.errors import NoisyColumnsError
from haptid.estimation.fit import Fit
from haptid.estimation.least_squares import Solution, solve
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation
from haptid.observation.r_factor import triangle

# Where noise makes more than this share of what the rows say of a direction, taking it off leaves nothing to trust.
MOST_NOISE = 0.5
# Kinds of parameters whose columns are known exactly: signs of velocity, and ones.
EXACT_KINDS = ("FC", "OFF")


@dataclass(frozen=True)
class TLS:
    """Constrained total least squares: noise is the same share of the torque and of every column that is not exact.

    beta minimises norm(y - W beta)^2 / (1, beta)' C (1, beta) over all rows, motors weighted as in WLS, with C the
    noise's covariance but for a factor: the squares of the columns' and the torque's root mean squares. Columns of
    Coulomb friction and offsets are exact. The factor is the smallest generalised eigenvalue; on the triangle.

    Where noise comes from encoders, `ErrorsInVariables()` knows its size and is the better method: columns of one device are
    not noisy in proportion to their size.

    Sources: Golub and Van Loan (1980), SIAM J. Numerical Analysis 17(6); Van Huffel and Vandewalle (1991), The Total
    Least Squares Problem, section 3.6 for exact columns; Gautier, Vandanjon and Presse (1994), Proc. IEEE CDC.
    """

    @property
    def name(self) -> str:
        return "TLS"

    @property
    def unit_residual(self) -> bool:
        """The variance of the residual is still to be estimated."""
        return False

    def weights(self, observation: Observation) -> Array:
        """Those of WLS, (motors,)."""
        return WLS().weights(observation)

    def fit(self, observation: Observation) -> Fit:
        """The solution of least noise.

        Raises:
            UnexcitedError: the log leaves a direction of the parameters in the dark.
            NoisyColumnsError: the motion tells some parameters apart by less than the noise: take another method.
        """
        solve(observation, np.ones(len(observation.motors)))  # an error where a direction is in the dark
        weights = self.weights(observation)
        p = len(observation.base)
        whole = observation.stack(weights)
        variances = (whole**2).sum(axis=0) / observation.rows
        noisy = np.array([*(not exact(observation, k) for k in range(p)), True])
        C = np.diag(np.where(noisy, variances, 0.0))
        factor = least_noise(whole, noisy, C) / observation.rows
        shares = [motor.rows[:, None, None] * C * factor for motor in observation.motors]
        return corrected(observation, weights, shares)


def exact(observation: Observation, k: int) -> bool:
    """Whether the column of a base parameter is a sign or a constant, and nothing regroups into it."""
    base, kinds = observation.base, observation.model.device.parameters.kinds
    return all(kinds[j].startswith(EXACT_KINDS) for j in np.flatnonzero(base.regrouping[k]))


def least_noise(whole: Array, noisy: np.ndarray, C: Array) -> float:
    """The smallest s with det(M - s C) = 0, M = whole'whole (p + 1, p + 1) and C of the noisy columns.

    Exact columns are taken out by QR (Golub, Hoffman and Stewart 1987, Linear Algebra and its Applications 88/89).
    """
    order = np.concatenate([np.flatnonzero(~noisy), np.flatnonzero(noisy)])
    R = triangle(whole[:, order])
    first = int((~noisy).sum())
    root = linalg.cholesky(C[np.ix_(noisy, noisy)])
    return (
        float(np.linalg.svd(linalg.solve_triangular(root.T, R[first:, first:].T, lower=True), compute_uv=False)[-1])
        ** 2
    )


def corrected(observation: Observation, weights: Array, noise: Sequence[Array]) -> Fit:
    """Least squares without the noise's part in the squares: (W'W - N) beta = W'y - n.

    Args:
        observation: the rows.
        weights: of each motor's rows, (motors,).
        noise: expected squares of every motor's blocks' noise in weighted rows, each (blocks, p + 1, p + 1).

    Raises:
        NoisyColumnsError: more than half of what the rows say of a direction of the parameters would be noise.
    """
    plain = solve(observation, weights)
    N = np.sum([own[motor.rows > 0].sum(axis=0) for own, motor in zip(noise, observation.motors, strict=True)], axis=0)
    # In coordinates in which W'W is the unit matrix.
    shares, vectors = np.linalg.eigh(plain.root.T @ N[:-1, :-1] @ plain.root)
    if shares[-1] >= MOST_NOISE:
        largest = int(np.argmax(np.abs(plain.root @ vectors[:, -1]) / np.linalg.norm(plain.root, axis=1)))
        raise NoisyColumnsError(observation.base.names[largest], float(shares[-1]), MOST_NOISE)
    root = plain.root @ (vectors / np.sqrt(1.0 - shares))
    beta = plain.beta + root @ root.T @ (N[:-1, :-1] @ plain.beta - N[:-1, -1])
    rest = float(np.linalg.norm(observation.stack(weights) @ np.append(-beta, 1.0)))
    R = triangle((np.sqrt(1.0 - shares) * vectors).T @ plain.R)
    return Fit(observation, weights, Solution(beta, R, root, rest, plain.dof), False, tuple(noise))
