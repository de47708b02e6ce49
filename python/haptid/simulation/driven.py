"""Simulation of joints that springs alone move, driven by the measured motion of the motors.

The motors' positions are an input, and not simulated: no controller is needed, and what remains is stable. Rows of the
inverse model that belong to joints without torque determine their accelerations; those of the motors give the torque.

Multiple shooting with condensing (Bock and Plitt 1984, IFAC Proceedings 17(2)): segments are integrated in parallel,
each from a state of its own. Steps of Newton's method make the states of one segment's end and the next one's beginning
meet, together with the steps of the parameters; the torque and its derivatives are those of the motion that meets, to
first order. The vibration of a link on its spring decays in more than a second, so a run-in that outlasts it would
be longer than the segment.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ForwardDynamics, turning
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import regressor_columns
from haptid.errors import SimulationError
from haptid.motion.channels import coordinate_torque, position_map
from haptid.motion.motion import Motion
from haptid.simulation.closed_loop import FASTEST, STABLE, Segments

# States that are linearised together.
_CHUNK = 4096
# Singular values of the beginning below this share of the largest say nothing.
_DETERMINED = 1e-8
# Newton steps to the torsion that carries the torque of the motion without torsion.
_SETTLING = 3
# Root mean square change of a motor's torque that is left until segments meet: at most this share of its error, or of
# the torque where there is hardly an error.
_GAP, _GAP_OF_TORQUE = 0.1, 1e-4


@dataclass(frozen=True, eq=False)
class DrivenCourse:
    """Simulated motion at every sample, and torques as the model predicts them.

    Attributes:
        c, cd, cdd: of the coordinates that torque rows belong to, each (n, samples), SI.
        torque: of the rows, (n, samples), N m or N.
        slope: derivatives of the torque by the base parameters, (n, p, samples).
        start: derivatives by the state that the motion begins in, (n, 2u, samples).
    """

    c: Array
    cd: Array
    cdd: Array
    torque: Array
    slope: Array
    start: Array


@dataclass(frozen=True, eq=False)
class SegmentCourses:
    """Torques of segments that do not meet, each from a beginning of its own, as the model predicts them.

    Attributes:
        begin: states that the segments begin at, (segments, 2u).
        motion: of the coordinates, (n, 3, samples), SI.
        torque: of the rows, (n, samples), N m or N.
        by_beta, by_begin: derivatives by base parameters and by the beginning, (n, p, samples) and (n, 2u, samples).
        met, met_by_beta, met_by_begin: where another segment passes each beginning, (segments, 2u), and derivatives.
    """

    begin: Array
    motion: Array
    torque: Array
    by_beta: Array
    by_begin: Array
    met: Array
    met_by_beta: Array
    met_by_begin: Array


@dataclass(eq=False)
class DrivenJoints:
    """Joints of one motion that springs alone move.

    Attributes:
        model: the dynamic model, its dry friction smoothed.
        motion: whose positions contain those of the motors; those of the other joints are the first approximation.
        segments: the segments; all but the first begin at a sample that another one has as its own.
        base: maps base parameters to the core's columns, (r, p).
        every: samples of the motion in a step of the simulation; samples below are those at which steps begin.
        meets: whether the segments of the last course did, so far that what is left matters less than its error.
    """

    model: DynamicModel
    motion: Motion
    segments: Segments
    base: Array
    every: int = 1
    meets: bool = field(default=False, init=False)
    _begin: Array | None = field(default=None, init=False)
    _by_beta: Array = field(default_factory=lambda: np.zeros((0, 0, 0)), init=False)
    _at: Array = field(default_factory=lambda: np.zeros(0), init=False)

    def __post_init__(self) -> None:
        device, every = self.model.device, self.every
        change = position_map(device, self.motion)
        to_joints = np.linalg.inv(device.row_map)
        self.step = every * float(self.motion.dt)
        self._B = np.asarray(device.row_map)
        self.unknown = unloaded_joints(self.model)
        # Of the joints without motor the first approximation; of all others the coordinates that they move.
        rates = (self.motion.q, self.motion.qd, self.motion.qdd)
        qa = np.array([to_joints @ change(np.ascontiguousarray(x[:][::every].T)) for x in rates])
        self._first_motion = qa[:, self.unknown]
        qa[:, self.unknown] = 0.0
        self._carried = self._B @ qa
        begins = np.arange(qa.shape[2])
        self._midway = _between(self._carried, begins, 0.5, self.step)
        own = self._B[:, self.unknown]
        self._projection = np.kron(own, own)
        # Places of the motors' rows, and the measured torque of every row, (n, samples), N m or N.
        self.motors = [device.row_names.index(motor.name) for motor in device.drives if motor.motorised]
        self.measured = coordinate_torque(device, self.motion, 0, len(self.motion))[:, ::every]
        self._handed = self._handovers()

    def course(self, beta: Array) -> DrivenCourse:
        """Simulate with these base parameters, (p,): one motion, whose segments meet to first order.

        Raises:
            SimulationError: the simulation diverges, or a joint has no inertia or no spring.
        """
        forward = ForwardDynamics(self.model, self.base @ beta)
        if self._begin is None:
            begin = self._settled(forward, self.segments.sample[0])
        else:
            begin = self._begin + self._by_beta @ (beta - self._at)
        return self._condensed(beta, self._linearised(forward, begin, self._simulate(forward, begin)))

    def at(self, motion: Motion) -> DrivenJoints:
        """The same joints along other positions nearby, with the measured torque and beginnings of these."""
        made = replace(self, motion=motion)
        made.measured, made._begin, made._by_beta, made._at = self.measured, self._begin, self._by_beta, self._at
        return made

    def apart(self, beta: Array, begin: Array | None = None) -> SegmentCourses:
        """Simulate segments from beginnings of their own, (segments, 2u); without vibration where None.

        Raises:
            SimulationError: as `course`.
        """
        forward = ForwardDynamics(self.model, self.base @ beta)
        begin = self._settled(forward, self.segments.sample[0]) if begin is None else begin
        return self._linearised(forward, begin, self._simulate(forward, begin))

    def inertia(self, beta: Array) -> Array:
        """Mean mass matrix of the joints without motor where segments begin, (u, u)."""
        begins = self.segments.sample[0]
        c = self._coordinates(self._known(begins), *self._first_motion[:, :, begins])[0]
        return np.asarray(self._projected(ForwardDynamics(self.model, self.base @ beta).mass(c)).mean(axis=0))

    def _known(self, sample: np.ndarray, share: float = 0.0) -> Array:
        """What the measured motion moves the coordinates by, (3, n, states); at a share of the step behind a sample."""
        if share == 0.5:
            return self._midway[:, :, sample]
        if share == 1.0:
            sample, share = np.minimum(sample + 1, self._carried.shape[2] - 1), 0.0
        return _between(self._carried, sample, share, self.step) if share else self._carried[:, :, sample]

    def _rows(self, forward: ForwardDynamics, known: Array, x: Array, v: Array) -> tuple[Array, Array]:
        """M of the unknown joints, (states, u, u), and their torque without own acceleration, (states, u)."""
        c, cd, cdd = self._coordinates(known, x, v, np.zeros_like(x))
        M = self._projected(forward.mass(c))
        return M, (self._B[:, self.unknown].T @ forward.inverse(c, cd, cdd)).T

    def _coordinates(self, known: Array, x: Array, v: Array, a: Array) -> Array:
        """The rows' coordinates, velocities and accelerations, (3, n, states)."""
        return np.asarray(known + self._B[:, self.unknown] @ np.array([x, v, a]))

    def _projected(self, matrix: Array) -> Array:
        """Rows and columns of the unknown joints, (states, u, u), of a matrix of the coordinates, (states, n, n)."""
        u = len(self.unknown)
        return np.asarray((matrix.reshape(len(matrix), -1) @ self._projection).reshape(-1, u, u))

    def _acceleration(self, forward: ForwardDynamics, known: Array, x: Array, v: Array) -> Array:
        M, h = self._rows(forward, known, x, v)
        try:
            return np.asarray(-np.linalg.solve(M, h[:, :, None])[:, :, 0].T)
        except np.linalg.LinAlgError:
            raise self._without("inertia", M) from None

    def _settled(self, forward: ForwardDynamics, sample: np.ndarray) -> Array:
        """States at samples without vibration, (samples, 2u): the torsion carries the links."""
        known = self._known(sample)
        x, v, a = self._first_motion[:, :, sample].copy()
        for _ in range(_SETTLING):
            c, cd, cdd = self._coordinates(known, x, v, a)
            stiffness = self._projected(forward.gradients(c, cd, cdd)[0])
            h = (self._B[:, self.unknown].T @ forward.inverse(c, cd, cdd)).T
            try:
                x -= np.linalg.solve(stiffness, h[:, :, None])[:, :, 0].T
            except np.linalg.LinAlgError:
                raise self._without("spring", stiffness) from None
        return np.concatenate([x, v]).T.copy()

    def _without(self, purpose: str, matrix: Array) -> SimulationError:
        names = [self.model.device.joints[self.model.device.active[k]].name for k in self.unknown]
        return SimulationError(
            f"these parameters give one of the joints {', '.join(names)} no {purpose}, so its motion is undefined.",
            where=purpose,
            found=float(np.abs(matrix).min(initial=0.0)),
            advice="Begin with other values: prior values of the elastic motors' stiffness in the device file.",
        )

    def _simulate(self, forward: ForwardDynamics, begin: Array) -> Array:
        """Positions, velocities and accelerations at every step, (steps, 3, u, segments), by fourth-order Runge-Kutta.

        Dry friction near reversals is integrated in smaller steps.
        """
        x, v = np.split(begin.T, 2)
        h, steps = self.step, len(self.segments.sample)
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
        h, (x, v, a1) = self.step / parts, now
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
        known = self._known(self.segments.sample[0]) * np.array([1.0, 0.0, 0.0])[:, None, None]
        c, cd, cdd = self._coordinates(known, x, still, still)
        M, damping = self._projected(forward.mass(c)), self._projected(forward.gradients(c, cd, cdd)[1])
        rate = float(np.abs(np.linalg.eigvals(np.linalg.solve(M, damping))).max(initial=0.0))
        return max(1, int(np.ceil(self.step * rate / STABLE)))

    def _diverged(self, step: int, v: Array) -> SimulationError:
        time = self.motion.t0 + self.step * int(self.segments.sample[step, int(np.abs(v).max(axis=0).argmax())])
        return SimulationError(
            f"the simulated joints behind springs diverge at {time:.3f} s (limit {FASTEST:g} rad/s or m/s).",
            where=time,
            found=float(np.nan_to_num(np.abs(v), nan=np.inf).max()),
            limit=FASTEST,
            advice="Begin with other values of stiffness and damping: priors in the device file.",
        )

    def _linearised(self, forward: ForwardDynamics, begin: Array, states: Array) -> SegmentCourses:
        """Torques and their derivatives, from the variational equations by the trapezoidal rule."""
        steps, u, count, p = len(states), len(self.unknown), states.shape[3], self.base.shape[1]
        n, h, B = len(self._B), self.step, self._B[:, self.unknown]
        X = np.tile(np.concatenate([np.zeros((2 * u, p)), np.eye(2 * u)], axis=1), (count, 1, 1))
        result = np.empty((n, 4 + p + 2 * u, self.segments.samples))
        met, by_all = begin.copy(), X.copy()
        before: tuple[Array, Array] | None = None
        chunk = max(1, _CHUNK // count)
        for first in range(0, steps, chunk):
            part = slice(first, min(first + chunk, steps))
            sample = self.segments.sample[part]
            x, v, a = (np.moveaxis(states[part, i], 1, 0).reshape(u, -1) for i in range(3))
            c, cd, cdd = self._coordinates(self._known(sample.ravel()), x, v, a)
            by_state = np.concatenate([y @ B for y in forward.gradients(c, cd, cdd)], axis=2)
            mass, Y = forward.mass(c) @ B, regressor_columns(self.model, c, cd, cdd, self.base).transpose(2, 0, 1)
            inverse = -np.linalg.inv(B.T @ mass)
            F, b = inverse @ (B.T @ by_state), inverse @ (B.T @ Y)  # accelerations by states and by parameters
            own_slopes, by_state = Y + mass @ b, by_state + mass @ F
            F, b = (y.reshape(-1, count, *y.shape[1:]) for y in (F, b))
            ahead = (F, b) if before is None else tuple(np.concatenate(y) for y in zip(before, (F, b), strict=True))
            change, forced = _transitions(ahead[0], ahead[1], h)
            before = F[-1:], b[-1:]
            S = np.empty((len(F), *X.shape))
            for k in range(len(F)):
                if first or k:
                    X = change[k - len(F)] @ X
                    X[:, :, :p] += forced[k - len(F)]
                S[k] = X
                for segment, other in self._handed.get(first + k, ()):
                    met[other], by_all[other] = states[first + k, :2, :, segment].ravel(), X[segment]
            slope = by_state @ S.reshape(-1, 2 * u, p + 2 * u)
            slope[:, :, :p] += own_slopes
            motion = np.array([c, cd, cdd, forward.inverse(c, cd, cdd)]).transpose(1, 0, 2)
            own = self.segments.own[part].ravel()
            result[:, :4, sample.ravel()[own]] = motion[:, :, own]
            result[:, 4:, sample.ravel()[own]] = slope[own].transpose(1, 2, 0)
        by_beta, by_begin = result[:, 4 : 4 + p], result[:, 4 + p :]
        return SegmentCourses(
            begin, result[:, :3], result[:, 3], by_beta, by_begin, met, by_all[:, :, :p], by_all[:, :, p:]
        )

    def _condensed(self, beta: Array, made: SegmentCourses) -> DrivenCourse:
        """Torques and derivatives where segments meet, to first order, segment after segment; the next begin there.

        The first beginning is the one with the least error of the motors' torque, whatever the parameters: a log may
        begin in the middle of a motion (variable projection, Golub and Pereyra 1973, SIAM J. Numerical Analysis 10(2)).

        Args:
            beta: base parameters, (p,).
            made: segments that do not meet.
        """
        moved, by_beta = np.zeros_like(made.begin), np.zeros_like(made.met_by_beta)
        by_first = np.zeros_like(made.met_by_begin)
        by_first[0] = np.eye(by_first.shape[1])
        passed = {other: segment for pairs in self._handed.values() for segment, other in pairs}
        for k in range(1, len(moved)):
            by_begin, other = made.met_by_begin[k], passed[k]
            moved[k] = made.met[k] - made.begin[k] + by_begin @ moved[other]
            by_beta[k] = made.met_by_beta[k] + by_begin @ by_beta[other]
            by_first[k] = by_begin @ by_first[other]
        torque, slope, start = np.array(made.torque), np.array(made.by_beta), np.empty_like(made.by_begin)
        for k, own in enumerate(self.segments.own.T):
            samples = self.segments.sample[own, k]
            part = slice(samples[0], samples[-1] + 1)
            by_begin = made.by_begin[:, :, part]
            torque[:, part] += np.einsum("nus,u->ns", by_begin, moved[k])
            slope[:, :, part] += by_beta[k].T @ by_begin
            start[:, :, part] = by_first[k].T @ by_begin
        first, first_by_beta = self._first(torque, slope, start)
        torque += np.einsum("nus,u->ns", start, first)
        slope += first_by_beta.T @ start
        self._begin, self._at = made.begin + moved + by_first @ first, np.array(beta)
        self._by_beta = by_beta + by_first @ first_by_beta
        self.meets = self._agree(made.torque, torque)
        c, cd, cdd = (np.ascontiguousarray(made.motion[:, i]) for i in range(3))
        return DrivenCourse(c, cd, cdd, torque, slope, start)

    def _agree(self, simulated: Array, met: Array) -> bool:
        """Whether the torque of the segments, (n, samples), is that which it will be where they meet."""
        gap, error, size = (
            np.sqrt(np.mean(x[self.motors] ** 2, axis=1)) for x in (met - simulated, self.measured - met, self.measured)
        )
        return bool((gap <= np.maximum(_GAP * error, _GAP_OF_TORQUE * size)).all())

    def _first(self, torque: Array, slope: Array, start: Array) -> tuple[Array, Array]:
        """Change of the first beginning to the least error of the torque, (2u,), and its derivatives, (2u, p)."""
        found = self._projected_on(start, np.concatenate([(self.measured - torque)[:, None], -slope], axis=1))
        return found[:, 0], found[:, 1:]

    def beside_start(self, course: DrivenCourse, columns: Array) -> Array:
        """Columns of the torque, (n, k, samples), less what another beginning would do as well, as slopes are."""
        return np.asarray(columns - self._projected_on(course.start, columns).T @ course.start)

    def _projected_on(self, start: Array, columns: Array) -> Array:
        """Least squares of columns of the motors' torque, (n, k, samples), by the first beginning, (2u, k)."""
        rows = self.motors
        size = np.abs(self.measured[rows]).max(axis=1)
        size = np.where(size > 0, size, 1.0)[:, None, None]
        by_start, wanted = ((x[rows] / size).transpose(0, 2, 1).reshape(-1, x.shape[1]) for x in (start, columns))
        return np.asarray(np.linalg.lstsq(by_start, wanted, rcond=_DETERMINED)[0])

    def _handovers(self) -> dict[int, list[tuple[int, int]]]:
        """By step: which segment has as its own sample the one that another segment begins at."""
        handovers: dict[int, list[tuple[int, int]]] = {}
        for k, sample in enumerate(self.segments.sample[0].tolist()):
            for step, segment in np.argwhere((self.segments.sample == sample) & self.segments.own).tolist():
                if k:
                    handovers.setdefault(step, []).append((segment, k))
        return handovers


def _transitions(F: Array, b: Array, h: float) -> tuple[Array, Array]:
    """Steps of the trapezoidal rule of s'' = F (s, s') + b: (s, s') of a step from the one before, change and offset.

    Args:
        F: (steps, segments, u, 2u).
        b: (steps, segments, u, p).
        h: sampling period, s.

    Returns:
        (steps - 1, segments, 2u, 2u) and (steps - 1, segments, 2u, p).
    """
    u, unit = F.shape[2], np.eye(F.shape[2])
    by_s, by_v = F[..., :u], F[..., u:]
    ahead = 0.25 * h * h * by_s[1:]
    inverse = np.linalg.inv(unit - 0.5 * h * by_v[1:] - ahead)
    lower = inverse @ np.concatenate([0.5 * h * (by_s[:-1] + by_s[1:]), unit + 0.5 * h * by_v[:-1] + ahead], axis=-1)
    upper = 0.5 * h * lower
    upper[..., :u] += unit
    upper[..., u:] += 0.5 * h * unit
    offset = 0.5 * h * inverse @ (b[:-1] + b[1:])
    return np.concatenate([upper, lower], axis=-2), np.concatenate([0.5 * h * offset, offset], axis=-2)


def _between(motion: Array, sample: np.ndarray, share: float, h: float) -> Array:
    """Positions, velocities and accelerations, (3, n, states), at a share of the step h behind samples of (3, n, all).

    Cubic Hermite interpolation of the first two, linear of accelerations.
    """
    s, t = share, 1 - share
    before, after = motion[:, :, sample], motion[:, :, np.minimum(sample + 1, motion.shape[2] - 1)]
    made = t * before + s * after
    ends = t * t * (1 + 2 * s) * before[:2] + s * s * (1 + 2 * t) * after[:2]
    made[:2] = ends + h * s * t * (t * before[1:] - s * after[1:])
    return np.asarray(made)


def unloaded_joints(model: DynamicModel) -> np.ndarray:
    """Places of the joints that springs alone move in the active joints, (u,)."""
    device = model.device
    return np.array([device.active.index(drive.first) for drive in device.drives if drive.unloaded], dtype=int)
