"""Kalman filters for joint state and parameters, extended (`EKF`) and unscented (`UKF`), in square-root form.

The state is (c, cd, beta): positions, velocities and base parameters. The measured torque is the input, its noise the
process noise; positions are measured. The filter's own covariance of beta depends on the assumed noise. So the
information on beta that each block of time adds is stored as rows R beta = z of that block: their least squares are
the filter's estimate, and cluster-robust covariances apply to them as to any other method.

Sources: Gautier and Poignet (2001), Control Engineering Practice 9(12), the extended filter for robots; Kaminski,
Bryson and Schmidt (1971), IEEE Trans. Automatic Control 16(6), square-root arrays.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import field
from typing import ClassVar

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ParametricForwardDynamics
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import SimulationError, setting_error
from haptid.estimation.estimate import Estimate, estimate
from haptid.estimation.method import Method, UnitVarianceRows, expect_motors, expect_positive
from haptid.estimation.methods.open_loop import position_noise, recorded_positions, sampled_torque
from haptid.estimation.methods.simulation_based import base_columns, by_block
from haptid.estimation.methods.wls import WLS
from haptid.motion.channels import coordinate_torque, coordinates
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation
from haptid.simulation import expect_no_history, measured_state, smooth
from haptid.simulation.closed_loop import FASTEST, runge_kutta_step

_Figures = tuple[float, ...]

# Substeps of a sampling period in which dry friction may reverse: in one step it would reverse half a step late.
SUBSTEPS = 8


@dataclass(frozen=True, eq=False)
class FilterState:
    """Mean and square root of the covariance of x = (c, cd, beta).

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

    def updated(self, c: Array, noise: Array) -> FilterState:
        """After measured positions (n,), each with its standard deviation, by the array form."""
        n, size = len(c), len(self.x)
        before = np.zeros((n + size, n + size))
        before[:n, :n], before[:n, n:], before[n:, n:] = np.diag(noise), self.S[:n], self.S
        after = lower(before)
        gain = np.linalg.solve(after[:n, :n].T, after[n:, :n].T).T
        return FilterState(self.x + gain @ (c - self.x[:n]), after[n:, n:])


@dataclass(frozen=True, eq=False)
class FilterInput:
    """Input of a filter along one motion.

    Attributes:
        motion: which.
        c, tau: recorded positions, and torque from each sample to the next, each (n, samples).
        treated: positions and velocities, each (n, samples).
        noise: standard deviations of positions and of torques, each (n,).
    """

    motion: Motion
    c: Array
    tau: Array
    treated: tuple[Array, Array]
    noise: tuple[Array, Array]


@dataclass(frozen=True)
class Filtering(UnitVarianceRows, ABC):
    """A Kalman filter for joint state and parameters: point estimates, without intervals.

    Cluster-robust intervals of the information of its blocks held 50 to 87 % in simulation, not 95: dry friction at
    reversals and the assumed noise bias the estimate by more than its blocks differ. `covariance` has their figures.

    Attributes:
        position_noise: standard deviations of the recorded positions, rad or m, one for each torque row; empty takes
            what the treatment removed from them.
        torque_noise: standard deviations of the torque from one sample to the next, N m or N; empty takes the residual
            of the initial estimate.
        start: the method that gives the initial parameters.
        widen: initial standard deviations of these, in standard errors.
        friction: dry friction is smoothed within this share of a joint's root mean square speed: what it lacks near
            standstill biases dry and viscous friction.
    """

    why_no_intervals: ClassVar[str] = (
        "Kalman filters give point estimates only: intervals from them do not have the nominal coverage, so none are "
        "given. Use WLS or IV for intervals."
    )

    position_noise: _Figures = ()
    torque_noise: _Figures = ()
    start: Method = field(default_factory=WLS)
    widen: float = 10.0
    friction: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("widen", "friction"):
            expect_positive(self.name, name, getattr(self, name))
        for name in ("position_noise", "torque_noise"):
            if not all(positive(value) for value in getattr(self, name)):
                wanted = "finite deviations above zero, one for each torque row"
                raise setting_error(name, getattr(self, name), wanted, self.name)

    @property
    def name(self) -> str:
        return type(self).__name__

    def rows(self, observation: Observation) -> Observation:
        """The information on the parameters that every block of time adds, as rows of that block.

        Raises:
            SimulationError: the filter diverges, or a mass matrix cannot be inverted.
        """
        expect_motors(self.name, observation)
        model, first = observation.model, estimate(observation, self.start)
        expect_no_history(model)
        smoothed = smooth(model, observation.motions, self.friction)
        forward = ParametricForwardDynamics(smoothed, base_columns(model))
        p, size = len(observation.base), len(observation.blocks)
        r_factors, counts = np.zeros((size, p + 1, p + 1)), np.zeros(size, dtype=int)
        beta, root = first.beta, np.diag(self.widen * first.se)
        for motion in observation.motions:
            inputs = self._input(first, motion)
            for blocks in consecutive_blocks(observation, motion):
                state = initial_state(inputs, blocks[0][1], beta, root)
                for block, start, stop in blocks:
                    before = state.information(p)
                    state = self._filtered(forward, state, inputs, range(start, stop))
                    r_factors[block] = information_rows(before, state.information(p))
                    counts[block] = (stop - start) * len(inputs.c)
                beta, root = state.x[-p:], lower(state.S[-p:])
        return by_block(observation, self.name, r_factors, counts)

    def _filtered(
        self, forward: ParametricForwardDynamics, state: FilterState, inputs: FilterInput, samples: range
    ) -> FilterState:
        """The state after some samples, each predicted and then updated by the measurement that follows it."""
        for k in samples:
            state = self.predicted(forward, state, inputs, k)
            _check_speeds(forward.model, inputs.motion, k, state)
            state = state.updated(inputs.c[:, k + 1], inputs.noise[0])
        return state

    @abstractmethod
    def predicted(
        self, forward: ParametricForwardDynamics, state: FilterState, inputs: FilterInput, k: int
    ) -> FilterState:
        """The state at the sample after k, without its measurement."""

    def _input(self, first: Estimate, motion: Motion) -> FilterInput:
        model, (low, high) = first.model, motion.unbroken(self.name).usable
        raw, treated = recorded_positions(model, motion), measured_state(model, motion)
        positions = np.asarray(self.position_noise or position_noise(raw, treated[0], motion), dtype=float)
        torques = np.asarray(self.torque_noise, dtype=float)
        if not torques.size:
            qa = (np.linalg.inv(model.device.row_map) @ x for x in coordinates(model.device, motion, low, high))
            left = coordinate_torque(model.device, motion, low, high) - inverse_dynamics(model, first.beta, *qa)
            torques = left.std(axis=1)
        for name, figures in (("position_noise", positions), ("torque_noise", torques)):
            if figures.shape != (len(raw),):
                raise setting_error(name, figures.tolist(), f"{len(raw)} figures, one for each row", self.name)
        return FilterInput(motion, raw, sampled_torque(model, motion), treated, (positions, torques))


def lower(root: Array) -> Array:
    """The lower triangle L with L L' = root root', from a wide root."""
    return np.ascontiguousarray(np.asarray(np.linalg.qr(root.T, mode="r"), dtype=np.float64).T)


def initial_state(inputs: FilterInput, k: int, beta: Array, root: Array) -> FilterState:
    """The treated state at sample k, its velocity as uncertain as a difference of two positions."""
    n, size = len(inputs.c), 2 * len(inputs.c) + len(beta)
    S = np.zeros((size, size))
    S[: 2 * n, : 2 * n] = np.diag(np.concatenate([inputs.noise[0], inputs.noise[0] / inputs.motion.dt]))
    S[2 * n :, 2 * n :] = root
    return FilterState(np.concatenate([inputs.treated[0][:, k], inputs.treated[1][:, k], beta]), S)


def _check_speeds(model: DynamicModel, motion: Motion, k: int, state: FilterState) -> None:
    """Raise SimulationError where the filter has diverged."""
    n = len(model.device.row_names)
    speeds = np.abs(state.x[n : 2 * n])
    if not speeds.max() < FASTEST:
        row = int(np.argmax(np.nan_to_num(speeds, nan=np.inf)))
        t, label, speed = motion.t0 + k * motion.dt, model.device.row_labels[row], float(speeds[row])
        raise SimulationError(
            f"the filter diverges: at {t:.3f} s the speed of {label} is {speed:.3g} rad/s or m/s (limit {FASTEST:g}).",
            where=t,
            found=speed,
            limit=FASTEST,
            advice="Start from parameters that are physically consistent, such as those of PhysicallyConsistent().",
        )


def information_rows(before: tuple[Array, Array], after: tuple[Array, Array]) -> Array:
    """Rows R beta = z whose information is the gain from `before` to `after`, (p + 1, p + 1); z in the last column."""
    information, sum_ = after[0] - before[0], after[1] - before[1]
    scale = np.sqrt(np.maximum(np.diag(after[0]), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, 0.0))
    positive = root > 0
    R = np.where(positive, root, 0.0)[:, None] * vectors.T * scale
    z = np.divide(vectors.T @ (sum_ / scale), root, out=np.zeros_like(root), where=positive)
    return np.pad(np.column_stack([R, z]), ((0, 1), (0, 0)))


def consecutive_blocks(observation: Observation, motion: Motion) -> Iterator[list[tuple[int, int, int]]]:
    """Runs of consecutive blocks of one motion: index in the observation, first sample, and one past the last."""
    run: list[tuple[int, int, int]] = []
    for k, block in enumerate(observation.blocks):
        if block.log != motion.name:
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


@dataclass(frozen=True)
class EKF(Filtering):
    """Extended Kalman filter: the model linearised about the present estimate.

    A step is exact for the linear model with constant torque (exponential Rosenbrock-Euler), so that stiff friction
    needs no smaller ones. Source: Hochbruck and Ostermann (2010), Acta Numerica 19, eq. 2.38.
    """

    def predicted(
        self, forward: ParametricForwardDynamics, state: FilterState, inputs: FilterInput, k: int
    ) -> FilterState:
        """The state at the sample after k, without its measurement."""
        n, x, dt = len(inputs.c), state.x.copy(), inputs.motion.dt
        linear = forward.linearised(x[:n], x[n : 2 * n], inputs.tau[:, k], x[2 * n :])
        substeps = SUBSTEPS if forward.turning(x[:n], x[n : 2 * n], linear[0], dt) else 1
        by_start, by_beta, process = np.eye(2 * n), np.zeros((2 * n, len(x) - 2 * n)), np.zeros((2 * n, n))
        for substep in range(substeps):
            if substep > 0:
                linear = forward.linearised(x[:n], x[n : 2 * n], inputs.tau[:, k], x[2 * n :])
            cdd, by_state, slope, inverse = linear
            F, integral = exponential(by_state, dt / substeps)
            x[: 2 * n] += integral @ np.concatenate([x[n : 2 * n], cdd])
            by_start, by_beta = F @ by_start, F @ by_beta + integral[:, n:] @ slope
            process = F @ process + integral[:, n:] @ (inverse * inputs.noise[1])
        root = np.zeros((len(x), len(x) + n))
        root[: 2 * n, :-n] = by_start @ state.S[: 2 * n] + by_beta @ state.S[2 * n :]
        root[: 2 * n, -n:], root[2 * n :, :-n] = process, state.S[2 * n :]
        return FilterState(x, lower(root))


def exponential(by_state: Array, dt: float) -> tuple[Array, Array]:
    """exp(A dt), and its integral over the step, each (2n, 2n), of A = [0 1; by_state]."""
    size = by_state.shape[1]
    wide = np.zeros((2 * size, 2 * size))
    wide[: size // 2, size // 2 : size] = np.eye(size // 2)
    wide[size // 2 : size, :size] = by_state
    wide[:size, size:] = np.eye(size)
    result = linalg.expm(wide * dt)
    return result[:size, :size], result[:size, size:]


@dataclass(frozen=True)
class UKF(Filtering):
    """Unscented Kalman filter: 2 (2n + p) points around the present estimate pass through the model, no derivatives.

    Points at plus and minus sqrt(2n + p) standard deviations, with equal weights (the cubature rule), so that the
    square root of the covariance is a QR of the points. Sources: Julier and Uhlmann (2004), Proc. IEEE 92(3);
    Arasaratnam and Haykin (2009), IEEE Trans. Automatic Control 54(6), section VI.

    Attributes:
        parts: Runge-Kutta steps in each sampling period; more where dry friction reverses.
    """

    parts: int = 1

    def predicted(
        self, forward: ParametricForwardDynamics, state: FilterState, inputs: FilterInput, k: int
    ) -> FilterState:
        """The state at the sample after k, without its measurement."""
        n, size, tau = len(inputs.c), len(state.x), inputs.tau[:, k]
        points = state.x[:, None] + np.sqrt(size) * np.column_stack([state.S, -state.S])
        dt, mean = inputs.motion.dt, state.x
        cdd, *_, inverse = forward.linearised(mean[:n], mean[n : 2 * n], tau, mean[2 * n :])
        steps = self.parts * (SUBSTEPS if forward.turning(mean[:n], mean[n : 2 * n], cdd, dt) else 1)
        held, beta = np.repeat(tau[:, None], points.shape[1], axis=1), points[2 * n :].T

        def acceleration(c: Array, cd: Array) -> Array:
            return forward.acceleration(c, cd, held, beta)

        for _ in range(steps):
            points[: 2 * n] = np.concatenate(runge_kutta_step(acceleration, points[:n], points[n : 2 * n], dt / steps))
        x = points.mean(axis=1)
        process = np.zeros((size, n))
        push = inverse * inputs.noise[1]
        process[:n], process[n : 2 * n] = 0.5 * dt**2 * push, dt * push
        spread = (points - x[:, None]) / np.sqrt(2 * size)
        return FilterState(x, lower(np.column_stack([spread, process])))
