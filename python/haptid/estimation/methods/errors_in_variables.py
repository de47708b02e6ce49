"""Errors in variables: noise in the columns, of unknown size (`TLS`) or of known size (`ErrorsInVariables`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.errors import IdentifiabilityError, SettingError, setting_error
from haptid.estimation.least_squares import Solution, solve
from haptid.estimation.method import Fit, expect_whole
from haptid.estimation.methods.wls import WLS
from haptid.motion.motion import Motion, treat
from haptid.observation.observation import Observation
from haptid.observation.r_factor import r_factor
from haptid.observation.rows import Rows, chunks_of

# Largest share of noise in the information on a direction; with more, the corrected equations are ill-conditioned.
MOST_NOISE = 0.5
_ADVICE = "Lower the cut-off of the position filter, check the resolution of the encoders, or use WLS()."
# Kinds of parameters whose columns are known exactly: signs of velocity, and ones.
EXACT_KINDS = ("FC", "OFF")


class _NoisyColumns:
    """What both methods share: weights of WLS."""

    unit_residual: ClassVar[bool] = False

    def weights(self, observation: Observation) -> Array:
        """Those of WLS, (motors,)."""
        return WLS().weights(observation)


@dataclass(frozen=True)
class TLS(_NoisyColumns):
    """Constrained total least squares: noise is the same share of the torque and of every column that is not exact.

    beta minimises norm(y - W beta)^2 / (1, beta)' C (1, beta) over all rows, motors weighted as in WLS, with C the
    noise covariance up to a factor: the mean squares of the columns and of the torque. Columns of Coulomb friction and
    offsets are exact. The factor is the smallest generalised eigenvalue; on the R factor.

    Where the noise comes from encoders, `ErrorsInVariables()`, which takes its size as known, is better: columns of one
    device are not noisy in proportion to their size.

    Sources: Golub and Van Loan (1980), SIAM J. Numerical Analysis 17(6); Van Huffel and Vandewalle (1991), The Total
    Least Squares Problem, section 3.6 for exact columns; Gautier, Vandanjon and Presse (1994), Proc. IEEE CDC.
    """

    name: ClassVar[str] = "TLS"

    def fit(self, observation: Observation) -> Fit:
        """The solution of least noise.

        Raises:
            IdentifiabilityError: a direction of the parameters is not excited, or noise makes up too much of the
                information on it.
        """
        solve(observation, np.ones(len(observation.motors)))  # raises where a direction is not excited
        weights = self.weights(observation)
        p = len(observation.base)
        stack = observation.stack(weights)
        variances = (stack**2).sum(axis=0) / observation.rows
        noisy = np.array([*(not exact(observation, k) for k in range(p)), True])
        C = np.diag(np.where(noisy, variances, 0.0))
        factor = smallest_generalised_eigenvalue(stack, noisy, C) / observation.rows
        noise = [motor.rows[:, None, None] * C * factor for motor in observation.motors]
        return noise_corrected(observation, weights, noise)


def exact(observation: Observation, k: int) -> bool:
    """Whether the column of a base parameter is a sign or a constant, and nothing regroups into it."""
    base, kinds = observation.base, observation.model.device.parameters.kinds
    return all(kinds[j].startswith(EXACT_KINDS) for j in np.flatnonzero(base.regrouping[k]))


def smallest_generalised_eigenvalue(stack: Array, noisy: np.ndarray, C: Array) -> float:
    """The smallest s with det(M - s C) = 0, M = stack'stack (p + 1, p + 1) and C of the noisy columns.

    Exact columns are eliminated by QR (Golub, Hoffman and Stewart 1987, Linear Algebra and its Applications 88/89).
    """
    order = np.concatenate([np.flatnonzero(~noisy), np.flatnonzero(noisy)])
    R = r_factor(stack[:, order])
    first = int((~noisy).sum())
    root = linalg.cholesky(C[np.ix_(noisy, noisy)])
    scaled = linalg.solve_triangular(root.T, R[first:, first:].T, lower=True)
    return float(np.linalg.svd(scaled, compute_uv=False)[-1]) ** 2


def noise_corrected(observation: Observation, weights: Array, noise: Sequence[Array], advice: str = _ADVICE) -> Fit:
    """Least squares with the noise subtracted from the normal equations: (W'W - N) beta = W'y - n.

    Args:
        weights: of each motor's rows, (motors,).
        noise: expected squares of the noise of every motor's blocks in weighted rows, each (blocks, p + 1, p + 1).
        advice: of the error.

    Raises:
        IdentifiabilityError: more than half of the information on a direction of the parameters would be noise.
    """
    plain = solve(observation, weights)
    N = np.sum([own[motor.rows > 0].sum(axis=0) for own, motor in zip(noise, observation.motors, strict=True)], axis=0)
    # In coordinates in which W'W is the unit matrix.
    shares, vectors = np.linalg.eigh(plain.root.T @ N[:-1, :-1] @ plain.root)
    if shares[-1] >= MOST_NOISE:
        largest = int(np.argmax(np.abs(plain.root @ vectors[:, -1]) / np.linalg.norm(plain.root, axis=1)))
        name, share = observation.base.names[largest], float(shares[-1])
        raise IdentifiabilityError(
            f"{100 * share:.0f} % of the information on {name} would be noise of the columns (limit "
            f"{100 * MOST_NOISE:.0f} %).",
            where=name,
            found=share,
            limit=MOST_NOISE,
            advice=advice,
        )
    root = plain.root @ (vectors / np.sqrt(1.0 - shares))
    beta = plain.beta + root @ root.T @ (N[:-1, :-1] @ plain.beta - N[:-1, -1])
    rest = float(np.linalg.norm(observation.stack(weights) @ np.append(-beta, 1.0)))
    R = r_factor((np.sqrt(1.0 - shares) * vectors).T @ plain.R)
    return Fit(observation, weights, Solution(beta, R, root, rest, plain.dof), False, tuple(noise))


@dataclass(frozen=True)
class ErrorsInVariables(_NoisyColumns):
    """Least squares corrected for encoder noise in W'W: errors in variables with known noise covariance.

    The noise covariance of the columns is computed by simulation: the logs' positions are perturbed by noise of the
    size of an encoder step and treated again; the squared change of the columns is what the quantisation already in
    them has added. Columns of Coulomb friction and offsets are exact. The correction is of first order: the treatment
    has to leave little noise compared with the columns.

    Source: Fuller (1987), Measurement Error Models, eq. 2.2.9 (Sigma of the errors known).

    Attributes:
        resolution: of the position channels, rad or m, one or one for each; None is the smallest step in the log.
        draws: number of perturbations.
    """

    name: ClassVar[str] = "TLS, encoder noise"
    resolution: float | tuple[float, ...] | None = None
    draws: int = 4

    def __post_init__(self) -> None:
        expect_whole("ErrorsInVariables", "draws", self.draws, 1)
        if self.resolution is not None and not all(positive(r) for r in np.atleast_1d(self.resolution).tolist()):
            wanted = "finite steps above zero, or None"
            raise setting_error("resolution", self.resolution, wanted, "ErrorsInVariables")

    def fit(self, observation: Observation) -> Fit:
        """The corrected solution.

        Raises:
            SettingError: the encoder steps are not given, and the log does not show them.
            IdentifiabilityError: noise makes up too much of the information on a direction.
        """
        weights = self.weights(observation)
        p = len(observation.base)
        sure = [k for k in range(p) if exact(observation, k)]
        noise = [np.zeros((len(observation.blocks), p + 1, p + 1)) for _ in observation.motors]
        for seed in range(self.draws):
            for k, motor, columns in self._changes(observation, np.random.default_rng(seed)):
                columns[:, sure] = 0.0
                noise[motor][k, :p, :p] += columns.T @ columns * (weights[motor] ** 2 / self.draws)
        return noise_corrected(observation, weights, noise)

    def _changes(self, observation: Observation, rng: np.random.Generator) -> Iterator[tuple[int, int, Array]]:
        """Block, motor, and the change of its columns by a perturbation of the positions, (rows, p)."""
        motions = [perturbed(motion, encoder_steps(motion, self.resolution), rng) for motion in observation.motions]
        for plain, moved in zip(Rows(observation), chunks_of(of_motions(observation, motions)), strict=True):
            used = plain.used & moved.used
            change = (moved.W - plain.W) * used[:, :, None]
            for k, (start, stop) in zip(plain.blocks, pairwise(plain.edges), strict=True):
                for motor in range(len(change)):
                    yield k, motor, change[motor, start:stop]


def of_motions(observation: Observation, motions: Sequence[Motion]) -> Observation:
    """The same blocks of other motions, one for each of the observation's, with the same samples."""
    names = {old.name: new.name for old, new in zip(observation.motions, motions, strict=True)}
    blocks = tuple(replace(block, log=names[block.log]) for block in observation.blocks)
    return replace(observation, motions=tuple(motions), blocks=blocks)


def encoder_steps(motion: Motion, resolution: float | tuple[float, ...] | None) -> Array:
    """Resolution of each position channel's encoder, (channels,), rad or m.

    Raises:
        SettingError: not given, and the log does not show it.
    """
    channels = motion.q.shape[1]
    if resolution is not None:
        return np.broadcast_to(np.asarray(resolution, dtype=float), (channels,))
    if motion.log is None:
        raise _no_resolution("the motion has no log")
    moves = np.abs(np.diff(motion.log.position, axis=0))
    least = 1e-9 * np.ptp(motion.log.position, axis=0)
    return np.array([own[own > floor].min(initial=np.inf) for own, floor in zip(moves.T, least, strict=True)])


def perturbed(motion: Motion, step: Array, rng: np.random.Generator) -> Motion:
    """The motion with uniform noise of one encoder step added to its positions, treated the same.

    Raises:
        SettingError: its rates are exact and not computed from positions.
    """
    noise = rng.uniform(-0.5, 0.5, motion.q.shape) * step
    if motion.log is not None:
        return treat(replace(motion.log, position=motion.log.position + noise), motion.treatment)
    if motion.rates is not None:
        raise _no_resolution("the motion's velocities are exact, not made from positions")
    return replace(motion, q=motion.q + noise)


def _no_resolution(why: str) -> SettingError:
    """The error for encoder steps that are neither given nor in the log."""
    return SettingError(
        f"the steps of the encoders are not known: {why}.",
        where="resolution",
        advice="Give `resolution`, in rad or m of the position channels.",
    )
