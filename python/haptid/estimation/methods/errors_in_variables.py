"""Total least squares with noise of known size: that of the encoders, as it comes through to every column."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from haptid._internal.arrays import Array, positive, whole
from haptid.errors import MethodSettingError, NoResolutionError
from haptid.estimation.fit import Fit
from haptid.estimation.methods.tls import corrected, exact
from haptid.estimation.methods.wls import WLS
from haptid.motion.treatment import Motion, treat
from haptid.observation.observation import Observation
from haptid.observation.rows import Rows, chunks_of


@dataclass(frozen=True)
class ErrorsInVariables:
    """Least squares without what the encoders' noise adds to W'W: total least squares, noise of known covariance.

    The logs' positions are shaken by noise of the size of an encoder's step and treated again; what that changes in
    the columns, squared, is what the step that is already in them has added. Columns of Coulomb friction and offsets
    are exact. It needs a treatment under which the noise is small beside the columns: it corrects to first order.

    Source: Fuller (1987), Measurement Error Models, eq. 2.2.9 (Sigma of the errors known).

    Attributes:
        resolution: of the position channels, rad or m, one or one for each; None is the smallest step in the log.
        draws: times the positions are shaken.
    """

    resolution: float | tuple[float, ...] | None = None
    draws: int = 4

    def __post_init__(self) -> None:
        if not (whole(self.draws) and self.draws >= 1):
            raise MethodSettingError("Corrected", "draws", self.draws, "a whole number, 1 or more")
        if self.resolution is not None and not all(positive(r) for r in np.atleast_1d(self.resolution).tolist()):
            raise MethodSettingError("Corrected", "resolution", self.resolution, "finite steps above zero, or None")

    @property
    def name(self) -> str:
        return "TLS, encoder noise"

    @property
    def unit_residual(self) -> bool:
        """The variance of the residual is still to be estimated."""
        return False

    def weights(self, observation: Observation) -> Array:
        """Those of WLS, (motors,)."""
        return WLS().weights(observation)

    def fit(self, observation: Observation) -> Fit:
        """The corrected solution.

        Raises:
            NoResolutionError: the steps are not given, and the log does not show them.
            NoisyColumnsError: the noise is as large as what the motion says.
        """
        weights = self.weights(observation)
        p = len(observation.base)
        sure = [k for k in range(p) if exact(observation, k)]
        noise = [np.zeros((len(observation.blocks), p + 1, p + 1)) for _ in observation.motors]
        for seed in range(self.draws):
            for k, motor, columns in self._shaken(observation, np.random.default_rng(seed)):
                columns[:, sure] = 0.0
                noise[motor][k, :p, :p] += columns.T @ columns * (weights[motor] ** 2 / self.draws)
        return corrected(observation, weights, noise)

    def _shaken(self, observation: Observation, rng: np.random.Generator) -> Iterator[tuple[int, int, Array]]:
        """Block, motor, and what shaking changes in its columns, (rows, p)."""
        motions = [shaken(motion, steps(motion, self.resolution), rng) for motion in observation.motions]
        names = {id(a): b for a, b in zip(observation.motions, motions, strict=True)}
        other = renamed(observation, [names[id(motion)] for motion in observation.motions])
        for plain, moved in zip(Rows(observation), chunks_of(other), strict=True):
            both = plain.used & moved.used
            change = (moved.W - plain.W) * both[:, :, None]
            for k, (start, stop) in zip(plain.blocks, pairwise(plain.edges), strict=True):
                for motor in range(len(change)):
                    yield k, motor, change[motor, start:stop]


def renamed(observation: Observation, motions: Sequence[Motion]) -> Observation:
    """The same blocks of other motions of the same lengths."""
    of = {f"motion {id(a):x}": f"motion {id(b):x}" for a, b in zip(observation.motions, motions, strict=True)}
    blocks = tuple(replace(block, log=of.get(block.log, block.log)) for block in observation.blocks)
    return replace(observation, motions=tuple(motions), blocks=blocks)


def steps(motion: Motion, resolution: float | tuple[float, ...] | None) -> Array:
    """Of each position channel's encoder, (channels,), rad or m.

    Raises:
        NoResolutionError: not given, and the log does not show them.
    """
    channels = motion.q.shape[1]
    if resolution is not None:
        return np.broadcast_to(np.asarray(resolution, dtype=float), (channels,))
    if motion.log is None:
        raise NoResolutionError("the motion has no log")
    moves = np.abs(np.diff(motion.log.position, axis=0))
    least = 1e-9 * np.ptp(motion.log.position, axis=0)
    return np.array([own[own > floor].min(initial=np.inf) for own, floor in zip(moves.T, least, strict=True)])


def shaken(motion: Motion, step: Array, rng: np.random.Generator) -> Motion:
    """The motion of positions with the noise of steps added, treated the same.

    Raises:
        NoResolutionError: rates are known exactly, so that positions do not make them.
    """
    noise = rng.uniform(-0.5, 0.5, motion.q.shape) * step
    if motion.log is not None:
        return treat(replace(motion.log, position=motion.log.position + noise), motion.treatment)
    if motion.rates is not None:
        raise NoResolutionError("the motion's velocities are exact, not made from positions")
    return replace(motion, q=motion.q + noise)
