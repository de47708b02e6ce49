"""What Kalman filters for joint state and parameters share, in square-root form.

The state is (c, cd, beta): positions, velocities and base parameters. The measured torque drives it, the torque's noise
shakes it, positions are measured. A filter tells beta and a covariance that is true only as far as its noise is. So
what every block of time adds to the information on beta is kept as rows of that block, R beta = z: their least squares
are the filter's estimate, and the spread over them is as honest as that of any other method.

Sources: Gautier and Poignet (2001), Control Engineering Practice 9(12), the extended filter for robots; Kaminski,
Bryson and Schmidt (1971), IEEE Trans. Automatic Control 16(6), square-root arrays.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array, positive
from haptid.dynamics.forward import ParametricForwardDynamics
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import MethodSettingError, SimulationLostError
from haptid.estimation.estimate import Estimate, estimate
from haptid.estimation.method import Method
from haptid.estimation.methods.didim import base_columns
from haptid.estimation.methods.linearised import by_block
from haptid.estimation.methods.open_loop import held_torque, position_noise, recorded_positions
from haptid.estimation.methods.wls import WLS
from haptid.motion.channels import coordinate_torque, coordinates
from haptid.motion.treatment import Motion
from haptid.observation.observation import Observation
from haptid.simulation import measured_state, smooth
from haptid.simulation.closed_loop import FASTEST

Figures = tuple[float, ...]

# A step within which dry friction may turn over is cut into so many: else it turns over half a step late.
PARTS = 8


@dataclass(frozen=True, eq=False)
class Belief:
    """What the filter knows: x = (c, cd, beta) and a root of its covariance.

    Attributes:
        x: (2n + p,).
        S: lower triangle, S S' the covariance, (2n + p, 2n + p).
    """

    x: Array
    S: Array

    def information(self, p: int) -> tuple[Array, Array]:
        """On beta alone: the inverse of its covariance, (p, p), and that times beta, (p,)."""
        root = self.S[-p:]
        inverse = np.asarray(np.linalg.pinv(root @ root.T, rcond=1e-15, hermitian=True), dtype=np.float64)
        return inverse, inverse @ self.x[-p:]

    def measured(self, c: Array, noise: Array) -> Belief:
        """After positions (n,), each with its deviation, by the array form."""
        n, size = len(c), len(self.x)
        before = np.zeros((n + size, n + size))
        before[:n, :n], before[:n, n:], before[n:, n:] = np.diag(noise), self.S[:n], self.S
        after = lower(before)
        gain = np.linalg.solve(after[:n, :n].T, after[n:, :n].T).T
        return Belief(self.x + gain @ (c - self.x[:n]), after[n:, n:])


@dataclass(frozen=True, eq=False)
class Track:
    """What a filter is given of one motion.

    Attributes:
        motion: which.
        c, tau: recorded positions, and torque from each sample to the next, each (n, samples).
        treated: positions and velocities, each (n, samples).
        noise: deviations of positions and of torques, each (n,).
    """

    motion: Motion
    c: Array
    tau: Array
    treated: tuple[Array, Array]
    noise: tuple[Array, Array]


@dataclass(frozen=True)
class Filtering(ABC):
    """A Kalman filter for joint state and parameters.

    Attributes:
        position_noise: deviations of the recorded positions, rad or m, one for each torque row; empty takes what the
            treatment took from them.
        torque_noise: deviations of the torque from one sample to the next, N m or N; empty takes what the first
            estimate leaves of it.
        start: the method that gives the first parameters.
        widen: deviations of these to begin with, in their own.
        friction: dry friction turns over within this share of a joint's root mean square speed: what it lacks near
            standstill biases dry and viscous friction.
    """

    position_noise: Figures = ()
    torque_noise: Figures = ()
    start: Method = field(default_factory=WLS)
    widen: float = 10.0
    friction: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("widen", "friction"):
            if not positive(getattr(self, name)):
                raise MethodSettingError(self.name, name, getattr(self, name), "a finite number above zero")
        for name in ("position_noise", "torque_noise"):
            if not all(positive(value) for value in getattr(self, name)):
                wanted = "finite deviations above zero, one for each torque row"
                raise MethodSettingError(self.name, name, getattr(self, name), wanted)

    @property
    def name(self) -> str:
        return type(self).__name__

    @property
    def unit_residual(self) -> bool:
        """The filter's rows are in units of their deviation."""
        return True

    def weights(self, observation: Observation) -> Array:
        """One for all, (motors,)."""
        return np.ones(len(observation.motors))

    def rows(self, observation: Observation) -> Observation:
        """What every block of time adds to the information on the parameters, as rows of that block.

        Raises:
            SimulationLostError: the filter runs away.
            MasslessError: a mass matrix cannot be inverted.
        """
        model, first = observation.model, estimate(observation, self.start)
        smoothed = smooth(model, observation.motions, self.friction)
        forward = ParametricForwardDynamics(smoothed, base_columns(model))
        p, size = len(observation.base), len(observation.blocks)
        triangles, counts = np.zeros((size, p + 1, p + 1)), np.zeros(size, dtype=int)
        beta, root = first.beta, np.diag(self.widen * first.se)
        for motion in observation.motions:
            track = self._track(first, motion)
            for blocks in runs(observation, motion):
                belief = begin(track, blocks[0][1], beta, root)
                for block, start, stop in blocks:
                    before = belief.information(p)
                    for k in range(start, stop):
                        belief = self.ahead(forward, belief, track, k)
                        check(model, motion, k, belief)
                        belief = belief.measured(track.c[:, k + 1], track.noise[0])
                    triangles[block] = gained(before, belief.information(p))
                    counts[block] = (stop - start) * len(track.c)
                beta, root = belief.x[-p:], lower(belief.S[-p:])
        return by_block(observation, self.name, triangles, counts)

    @abstractmethod
    def ahead(self, forward: ParametricForwardDynamics, belief: Belief, track: Track, k: int) -> Belief:
        """From sample k to the next, without measurement; every filter has its own."""

    def _track(self, first: Estimate, motion: Motion) -> Track:
        model, (low, high) = first.model, motion.usable
        raw, treated = recorded_positions(model, motion), measured_state(model, motion)
        positions = np.asarray(self.position_noise or position_noise(raw, treated[0], motion), dtype=float)
        torques = np.asarray(self.torque_noise, dtype=float)
        if not torques.size:
            qa = (np.linalg.inv(model.device.row_map) @ x for x in coordinates(model.device, motion, low, high))
            left = coordinate_torque(model.device, motion, low, high) - inverse_dynamics(model, first.beta, *qa)
            torques = left.std(axis=1)
        for name, figures in (("position_noise", positions), ("torque_noise", torques)):
            if figures.shape != (len(raw),):
                raise MethodSettingError(self.name, name, figures.tolist(), f"{len(raw)} figures, one for each row")
        return Track(motion, raw, held_torque(model, motion), treated, (positions, torques))


def lower(root: Array) -> Array:
    """The lower triangle L with L L' = root root', from a wide root."""
    return np.ascontiguousarray(np.asarray(np.linalg.qr(root.T, mode="r"), dtype=np.float64).T)


def begin(track: Track, k: int, beta: Array, root: Array) -> Belief:
    """At sample k, from the treated state; a difference of two positions is worth so much of its velocity."""
    n, size = len(track.c), 2 * len(track.c) + len(beta)
    S = np.zeros((size, size))
    S[: 2 * n, : 2 * n] = np.diag(np.concatenate([track.noise[0], track.noise[0] / track.motion.dt]))
    S[2 * n :, 2 * n :] = root
    return Belief(np.concatenate([track.treated[0][:, k], track.treated[1][:, k], beta]), S)


def check(model: DynamicModel, motion: Motion, k: int, belief: Belief) -> None:
    """Raise SimulationLostError where the filter has run away."""
    n = len(model.device.row_names)
    speeds = np.abs(belief.x[n : 2 * n])
    if not speeds.max() < FASTEST:
        row = int(np.argmax(np.nan_to_num(speeds, nan=np.inf)))
        raise SimulationLostError(motion.t0 + k * motion.dt, model.device.row_labels[row], float(speeds[row]), FASTEST)


def gained(before: tuple[Array, Array], after: tuple[Array, Array]) -> Array:
    """Rows R beta = z that take one state of information to another, (p + 1, p + 1); z in the last column."""
    more, sum_ = after[0] - before[0], after[1] - before[1]
    scale = np.sqrt(np.maximum(np.diag(after[0]), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(more / np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, 0.0))
    kept = root > 0
    R = np.where(kept, root, 0.0)[:, None] * vectors.T * scale
    z = np.divide(vectors.T @ (sum_ / scale), root, out=np.zeros_like(root), where=kept)
    return np.pad(np.column_stack([R, z]), ((0, 1), (0, 0)))


def runs(observation: Observation, motion: Motion) -> Iterator[list[tuple[int, int, int]]]:
    """Blocks of one motion that follow one another: index in the observation, first sample, and one past the last."""
    name = motion.log.sha256 if motion.log else f"motion {id(motion):x}"
    run: list[tuple[int, int, int]] = []
    for k, block in enumerate(observation.blocks):
        if block.log != name:
            continue
        start, stop = (
            int(np.clip(round((t - motion.t0) / motion.dt), 0, len(motion) - 1)) for t in (block.start, block.stop)
        )
        if run and run[-1][2] != start:
            yield run
            run = []
        run.append((k, start, stop))
    if run:
        yield run
