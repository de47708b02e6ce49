"""Simulation of joints that springs alone move, driven by the measured motion of the motors.

The motors' positions are an input, and not simulated: no controller is needed, and what remains is stable. Rows of the
inverse model that belong to joints without torque determine their accelerations; those of the motors give the torque.
Segments are integrated in parallel. Each begins at the state, and at its derivatives by the parameters, that the pass
before found there: over the passes of an estimation, initial states become those of one continuous motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ForwardDynamics, turning
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import regressor_columns
from haptid.errors import SimulationError
from haptid.motion.channels import position_map
from haptid.motion.motion import Motion
from haptid.simulation.closed_loop import FASTEST, STABLE, Segments

# Steps whose states are linearised together.
_CHUNK = 64
# Newton steps to the torsion that carries the torque of the motion without torsion.
_SETTLING = 3


@dataclass(frozen=True, eq=False)
class DrivenCourse:
    """Simulated motion at every sample, and torques as the model predicts them.

    Attributes:
        c, cd, cdd: of the coordinates that torque rows belong to, each (n, samples), SI.
        torque: of the rows, (n, samples), N m or N.
        slope: derivatives of the torque by the base parameters, (n, p, samples).
    """

    c: Array
    cd: Array
    cdd: Array
    torque: Array
    slope: Array


@dataclass(eq=False)
class DrivenJoints:
    """Joints of one motion that springs alone move.

    Attributes:
        model: the dynamic model, its dry friction smoothed.
        motion: whose positions contain those of the motors; those of the other joints are the first approximation.
        segments: the segments.
        base: maps base parameters to the core's columns, (r, p).
    """

    model: DynamicModel
    motion: Motion
    segments: Segments
    base: Array
    _begin: Array | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        device = self.model.device
        change = position_map(device, self.motion)
        to_joints = np.linalg.inv(device.row_map)
        rates = (self.motion.q, self.motion.qd, self.motion.qdd)
        self._qa = [to_joints @ change(np.ascontiguousarray(x[:].T)) for x in rates]
        self._B = np.asarray(device.row_map)
        self.unknown = unloaded_joints(self.model)
        self._handed = self._handovers()

    def course(self, beta: Array) -> DrivenCourse:
        """Simulate with these base parameters, (p,).

        Raises:
            SimulationError: the simulation diverges, or a joint has no inertia or no spring.
        """
        forward = ForwardDynamics(self.model, self.base @ beta)
        states = self._simulate(forward)
        return self._linearised(forward, states)

    def _known(self, sample: np.ndarray, share: float = 0.0) -> list[Array]:
        """Motion of all active joints, each (active, segments); at a share of the step behind a sample.

        Cubic Hermite interpolation; of joints without motor it is not used.
        """
        q, v, a = self._qa
        if not share:
            return [x[:, sample] for x in self._qa]
        after, h = np.minimum(sample + 1, q.shape[1] - 1), self.motion.dt
        return [
            _hermite(q, v, sample, after, share, h),
            _hermite(v, a, sample, after, share, h),
            (1 - share) * a[:, sample] + share * a[:, after],
        ]

    def _rows(self, forward: ForwardDynamics, known: list[Array], x: Array, v: Array) -> tuple[Array, Array]:
        """M of the unknown joints, (states, u, u), and their torque without own acceleration, (states, u)."""
        c, cd, cdd = self._coordinates(known, x, v, np.zeros_like(x))
        M = self._projected(forward.mass(c))
        return M, (self._B.T @ forward.inverse(c, cd, cdd))[self.unknown].T

    def _coordinates(self, known: list[Array], x: Array, v: Array, a: Array) -> list[Array]:
        """The rows' coordinates, velocities and accelerations, each (n, states)."""
        coordinates = []
        for measured, own in zip(known, (x, v, a), strict=True):
            qa = measured.copy()
            qa[self.unknown] = own
            coordinates.append(np.ascontiguousarray(self._B @ qa))
        return coordinates

    def _projected(self, matrix: Array) -> Array:
        """Rows and columns of the unknown joints, (states, u, u), of a matrix of the coordinates, (states, n, n)."""
        B = self._B[:, self.unknown]
        return np.asarray(B.T @ matrix @ B)

    def _acceleration(self, forward: ForwardDynamics, known: list[Array], x: Array, v: Array) -> Array:
        M, h = self._rows(forward, known, x, v)
        try:
            return np.asarray(-np.linalg.solve(M, h[:, :, None])[:, :, 0].T)
        except np.linalg.LinAlgError:
            raise self._without("inertia", M) from None

    def _start(self, forward: ForwardDynamics) -> tuple[Array, Array, Array]:
        """States of all segments at their first sample, and derivatives by the parameters, (segments, 2u, p)."""
        first, u, p = self.segments.sample[0], len(self.unknown), self.base.shape[1]
        known = self._known(first)
        if self._begin is not None:
            return self._begin[:, :u, 0].T.copy(), self._begin[:, u:, 0].T.copy(), self._begin[:, :, 1:]
        x, v, a = (part[self.unknown].copy() for part in known)
        for _ in range(_SETTLING):
            c, cd, cdd = self._coordinates(known, x, v, a)
            stiffness = self._projected(forward.gradients(c, cd, cdd)[0])
            h = (self._B.T @ forward.inverse(c, cd, cdd))[self.unknown].T
            try:
                x -= np.linalg.solve(stiffness, h[:, :, None])[:, :, 0].T
            except np.linalg.LinAlgError:
                raise self._without("spring", stiffness) from None
        return x, v, np.zeros((len(first), 2 * u, p))

    def _without(self, purpose: str, matrix: Array) -> SimulationError:
        names = [self.model.device.joints[self.model.device.active[k]].name for k in self.unknown]
        return SimulationError(
            f"these parameters give one of the joints {', '.join(names)} no {purpose}, so its motion is undefined.",
            where=purpose,
            found=float(np.abs(matrix).min(initial=0.0)),
            advice="Begin with other values: prior values of the elastic motors' stiffness in the device file.",
        )

    def _simulate(self, forward: ForwardDynamics) -> Array:
        """Positions, velocities and accelerations at every step, (steps, 3, u, segments), by fourth-order Runge-Kutta.

        Dry friction near reversals is integrated in smaller steps.
        """
        x, v, _ = self._start(forward)
        h, steps = self.motion.dt, len(self.segments.sample)
        parts = self._parts(forward, x)
        states = np.empty((steps, 3, *x.shape))
        for k in range(steps):
            sample = self.segments.sample[k]
            known = self._known(sample)
            a = self._acceleration(forward, known, x, v)
            states[k] = x, v, a
            slow = np.zeros(len(sample), dtype=bool)
            if parts > 1:
                c, cd, cdd = self._coordinates(known, x, v, a)
                slow = turning(self.model, c, cd, cdd, h)
            after = np.empty((2, *x.shape))
            for mask, count in ((slow, parts), (~slow, 1)):
                if mask.any():
                    now = x[:, mask], v[:, mask], a[:, mask]
                    after[:, :, mask] = self._step(forward, sample[mask], now, count)
            x, v = after
            if not np.abs(v).max() < FASTEST:
                raise self._diverged(k, v)
        return states

    def _step(
        self, forward: ForwardDynamics, sample: np.ndarray, now: tuple[Array, Array, Array], parts: int
    ) -> tuple[Array, Array]:
        """One sampling period in equal steps, from positions, velocities and accelerations."""
        h, (x, v, a1) = self.motion.dt / parts, now
        for part in range(parts):
            middle, after = (self._known(sample, (part + share) / parts) for share in (0.5, 1.0))
            v2 = v + 0.5 * h * a1
            a2 = self._acceleration(forward, middle, x + 0.5 * h * v, v2)
            v3 = v + 0.5 * h * a2
            a3 = self._acceleration(forward, middle, x + 0.5 * h * v2, v3)
            v4 = v + h * a3
            a4 = self._acceleration(forward, after, x + h * v3, v4)
            x, v = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            if part + 1 < parts:
                a1 = self._acceleration(forward, after, x, v)
        return x, v

    def _parts(self, forward: ForwardDynamics, x: Array) -> int:
        """Steps in a sampling period in which smoothed dry friction is stable."""
        still = np.zeros_like(x)
        known = [part * (k == 0) for k, part in enumerate(self._known(self.segments.sample[0]))]
        c, cd, cdd = self._coordinates(known, x, still, still)
        M, damping = self._projected(forward.mass(c)), self._projected(forward.gradients(c, cd, cdd)[1])
        rate = float(np.abs(np.linalg.eigvals(np.linalg.solve(M, damping))).max(initial=0.0))
        return max(1, int(np.ceil(self.motion.dt * rate / STABLE)))

    def _diverged(self, step: int, v: Array) -> SimulationError:
        time = self.motion.t0 + self.motion.dt * int(self.segments.sample[step, int(np.abs(v).max(axis=0).argmax())])
        return SimulationError(
            f"the simulated joints behind springs diverge at {time:.3f} s (limit {FASTEST:g} rad/s or m/s).",
            where=time,
            found=float(np.nan_to_num(np.abs(v), nan=np.inf).max()),
            limit=FASTEST,
            advice="Begin with other values of stiffness and damping: priors in the device file.",
        )

    def _linearised(self, forward: ForwardDynamics, states: Array) -> DrivenCourse:
        """Torques and their derivatives, from the variational equations by the trapezoidal rule."""
        steps, u, count = len(states), len(self.unknown), states.shape[3]
        n, p = len(self._B), self.base.shape[1]
        X = self._start(forward)[2]
        result = np.empty((n, 4 + p, self.segments.samples))
        begin = np.empty((count, 2 * u, 1 + p))
        self._keep(begin, 0, states, X)
        before: tuple[Array, Array] | None = None
        for first in range(0, steps, _CHUNK):
            part = slice(first, min(first + _CHUNK, steps))
            sample = self.segments.sample[part]
            known = self._known(sample.ravel())
            x, v, a = (np.moveaxis(states[part, i], 1, 0).reshape(u, -1) for i in range(3))
            c, cd, cdd = self._coordinates(known, x, v, a)
            by_c, by_cd = forward.gradients(c, cd, cdd)
            mass, Y = forward.mass(c), regressor_columns(self.model, c, cd, cdd, self.base).transpose(2, 0, 1)
            B = self._B[:, self.unknown]
            inverse = np.linalg.inv(B.T @ mass @ B)
            F = np.concatenate([-inverse @ (B.T @ by_c @ B), -inverse @ (B.T @ by_cd @ B)], axis=2)
            F, b = (x.reshape(-1, count, *x.shape[1:]) for x in (F, -inverse @ (B.T @ Y)))
            if before is not None:
                X = self._ahead(before, (F[0], b[0]), X)
            S = np.empty((len(F), *X.shape))
            for k in range(len(F)):
                if k:
                    X = self._ahead((F[k - 1], b[k - 1]), (F[k], b[k]), X)
                S[k] = X
                self._keep(begin, first + k, states, X)
            before = F[-1], b[-1]
            rate = F @ S + b
            s, sd, sdd = (y.reshape(-1, u, p) for y in (S[:, :, :u], S[:, :, u:], rate))
            slope = Y + by_c @ (B @ s) + by_cd @ (B @ sd) + mass @ (B @ sdd)
            torque = forward.inverse(c, cd, cdd)
            course = np.concatenate(
                [np.array([c, cd, cdd, torque]).transpose(1, 0, 2), slope.transpose(1, 2, 0)], axis=1
            )
            own = self.segments.own[part].ravel()
            result[:, :, sample.ravel()[own]] = course[:, :, own]
        self._begin = begin
        c, cd, cdd, torque = (np.ascontiguousarray(result[:, i]) for i in range(4))
        return DrivenCourse(c, cd, cdd, torque, result[:, 4:])

    def _keep(self, begin: Array, step: int, states: Array, X: Array) -> None:
        """States and derivatives at samples where segments begin, from the segment that has them as its own."""
        for segment, k in self._handed.get(step, ()):
            begin[k, :, 0] = states[step, :2, :, segment].ravel()
            begin[k, :, 1:] = X[segment]

    def _handovers(self) -> dict[int, list[tuple[int, int]]]:
        """By step: which segment has as its own sample the one that another segment begins at."""
        handovers: dict[int, list[tuple[int, int]]] = {0: [(0, 0)]}
        for k, sample in enumerate(self.segments.sample[0].tolist()):
            for step, segment in np.argwhere((self.segments.sample == sample) & self.segments.own).tolist():
                handovers.setdefault(step, []).append((segment, k))
        return handovers

    def _ahead(self, now: tuple[Array, Array], then: tuple[Array, Array], X: Array) -> Array:
        """One step of the trapezoidal rule of s'' = F (s, s') + b, (segments, 2u, p)."""
        u, half = len(self.unknown), 0.5 * self.motion.dt
        right = X.copy()
        right[:, :u] += half * X[:, u:]
        right[:, u:] += half * (now[0] @ X + now[1] + then[1])
        A = np.tile(np.eye(2 * u), (len(X), 1, 1))
        A[:, :u, u:] -= half * np.eye(u)
        A[:, u:] -= half * then[0]
        return np.asarray(np.linalg.solve(A, right))


def _hermite(y: Array, rate: Array, before: np.ndarray, after: np.ndarray, share: float, h: float) -> Array:
    """Cubic interpolation between two samples, from values and rates."""
    s, t = share, 1 - share
    ends = t * t * (1 + 2 * s) * y[:, before] + s * s * (1 + 2 * t) * y[:, after]
    return np.asarray(ends + h * s * t * (t * rate[:, before] - s * rate[:, after]))


def unloaded_joints(model: DynamicModel) -> np.ndarray:
    """Places of the joints that springs alone move in the active joints, (u,)."""
    device = model.device
    return np.array([device.active.index(drive.first) for drive in device.drives if drive.unloaded], dtype=int)
