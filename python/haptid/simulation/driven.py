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

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ForwardDynamics, turning
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import regressor_columns
from haptid.errors import SimulationError
from haptid.motion.channels import coordinate_torque, position_map
from haptid.motion.motion import Motion
from haptid.simulation.closed_loop import FASTEST, STABLE
from haptid.simulation.variational import inverses, states_first, transitions

# Smaller steps in one of the simulation, at most: friction that needs more is that of parameters that ran away.
MOST_PARTS = 1000
# States that are linearised together.
_CHUNK = 1024
# Random states at which a parameter that moves the links has torque on them.
_STATES = 16
# Singular values of the beginning below this share of the largest say nothing.
_DETERMINED = 1e-8
# Newton steps to the torsion that carries the torque of the motion without torsion.
_SETTLING = 3
# Simulations until segments meet, at most.
_MEETING = 3
# Root mean square change of a motor's torque that is left until segments meet: at most this share of its error, or of
# the torque where there is hardly an error.
_GAP, _GAP_OF_TORQUE = 0.1, 1e-4


@dataclass(frozen=True, eq=False)
class DrivenCourse:
    """Simulated motion at every sample, and torques as the model predicts them.

    Attributes:
        c, cd, cdd: of the coordinates that torque rows belong to, each (n, samples), SI.
        torque: of the rows, (n, samples), N m or N; of the motors' rows where segments meet, to first order.
        slope: derivatives of the motors' torque by the base parameters, (motors, p, samples).
        start: derivatives by the state that the motion begins in, (motors, 2u, samples).
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
        motion: of the coordinates, (3, n, samples), SI.
        torque: of the rows, (n, samples), N m or N.
        by_beta, by_begin: derivatives of the motors' torque by base parameters and by the beginning,
            (motors, p, samples) and (motors, 2u, samples).
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
        length: steps of a segment; each begins where the one before ends.
        base: maps base parameters to the core's columns, (r, p).
        every: samples of the motion in a step of the simulation; samples below are those at which steps begin.
        most_parts: smaller steps in one of the simulation, at most, where dry friction is stiff.
        meets: whether the segments of the last course did, so far that what is left matters less than its error.
    """

    model: DynamicModel
    motion: Motion
    length: int
    base: Array
    every: int = 1
    most_parts: int = MOST_PARTS
    meets: bool = field(default=False, init=False)
    _begin: Array | None = field(default=None, init=False)
    _by_beta: Array = field(default_factory=lambda: np.zeros((0, 0, 0)), init=False)
    _at: Array = field(default_factory=lambda: np.zeros(0), init=False)

    def __post_init__(self) -> None:
        device, every = self.model.device, self.every
        self.step = every * float(self.motion.dt)
        self._B = np.asarray(device.row_map)
        self.unknown = unloaded_joints(self.model)
        self._carried, self._first_motion = self._moved_by(self.motion)
        self._midway = _between(self._carried, np.arange(self._carried.shape[2]), 0.5, self.step)
        self._own = np.ascontiguousarray(self._B[:, self.unknown])  # how the links move the coordinates
        self._projection = np.kron(self._own, self._own)
        # Names and places of the motors' rows, and the measured torque of every row, (n, samples), N m or N.
        self.names = [motor.name for motor in device.drives if motor.motorised]
        self.motors = [device.row_names.index(name) for name in self.names]
        self.measured = coordinate_torque(device, self.motion, 0, len(self.motion))[:, ::every]
        self.samples = self._carried.shape[2]
        self.begins = np.arange(0, self.samples, self.length)
        # Parameters that move the links; those of the motors, such as rotors, do not.
        c, cd, cdd = np.random.default_rng(0).standard_normal((3, len(self._B), _STATES))
        by_links = np.tensordot(self._own.T, regressor_columns(self.model, c, cd, cdd, self.base), (1, 0))
        self._moving = np.flatnonzero(by_links.any(axis=(0, 2)))

    def _moved_by(self, motion: Motion) -> tuple[Array, Array]:
        """What motors move the coordinates by, (3, n, samples), and the links' first approximation, (3, u, samples)."""
        device = self.model.device
        change, to_joints = position_map(device, motion), np.linalg.inv(device.row_map)
        rates = (motion.q, motion.qd, motion.qdd)
        qa = np.array([to_joints @ change(np.ascontiguousarray(x[:][:: self.every].T)) for x in rates])
        links = qa[:, self.unknown]
        qa[:, self.unknown] = 0.0
        return self._B @ qa, links

    def course(self, beta: Array) -> DrivenCourse:
        """Simulate with these base parameters, (p,): one motion, whose segments meet to first order.

        Raises:
            SimulationError: the simulation diverges, or a joint has no inertia or no spring.
        """
        forward = ForwardDynamics(self.model, self.base @ beta)
        if self._begin is None:
            begin = self._settled(forward, self.begins)
        else:
            begin = self._begin + self._by_beta @ (beta - self._at)
        made = self._linearised(forward, begin, self._simulate(forward, begin))
        course, self._begin, self._by_beta = self._condensed(made)
        self._at, self.meets = np.array(beta), self._agree(made.torque, course.torque)
        return course

    def met(self, beta: Array) -> DrivenCourse:
        """The course whose segments meet, or nearly: after a few simulations with these parameters, (p,).

        Raises:
            SimulationError: as `course`.
        """
        for _ in range(_MEETING):
            made = self.course(beta)
            if self.meets:
                break
        return made

    def begin_as(self, nearby: DrivenJoints) -> None:
        """Begin as the last course of the same segments along a motion nearby did."""
        self._begin, self._by_beta, self._at = nearby._begin, nearby._by_beta, nearby._at

    def responses(self, beta: Array, nearby: Sequence[Motion]) -> Array:
        """How the motors' torque changes along other motions nearby, to first order, (motors, k, samples), N m or N.

        The links follow these; what another beginning of the motion would do as well is not in it.

        Args:
            beta: base parameters of the last course, (p,).
            nearby: k motions.
        """
        assert self._begin is not None
        changes = np.stack([self._moved_by(motion)[0] - self._carried for motion in nearby], axis=2)
        forward = ForwardDynamics(self.model, self.base @ beta)
        made = self._linearised(forward, self._begin, self._simulate(forward, self._begin), changes)
        return self._condensed(made)[0].slope

    def apart(self, beta: Array, begin: Array | None = None) -> SegmentCourses:
        """Simulate segments from beginnings of their own, (segments, 2u); without vibration where None.

        Raises:
            SimulationError: as `course`.
        """
        forward = ForwardDynamics(self.model, self.base @ beta)
        begin = self._settled(forward, self.begins) if begin is None else begin
        return self._linearised(forward, begin, self._simulate(forward, begin))

    def inertia(self, beta: Array) -> Array:
        """Mean mass matrix of the joints without motor where segments begin, (u, u)."""
        c = self._coordinates(self._known(self.begins), *self._first_motion[:, :, self.begins])[0]
        return np.asarray(self._projected(ForwardDynamics(self.model, self.base @ beta).mass(c)).mean(axis=0))

    def _known(self, sample: np.ndarray, share: float = 0.0) -> Array:
        """What the measured motion moves the coordinates by, (3, n, states); at a share of the step behind a sample."""
        if share == 0.5:
            return self._midway[:, :, sample]
        if share == 1.0:
            sample, share = np.minimum(sample + 1, self._carried.shape[2] - 1), 0.0
        return _between(self._carried, sample, share, self.step) if share else self._carried[:, :, sample]

    def _coordinates(self, known: Array, x: Array, v: Array, a: Array | None = None) -> Array:
        """The rows' coordinates, velocities and accelerations, (3, n, states); no own acceleration where None."""
        made = np.array(known, order="C")
        for part, own in zip(made, (x, v, a), strict=True):
            if own is not None:
                part += self._own @ own
        return made

    def _projected(self, matrix: Array) -> Array:
        """Rows and columns of the unknown joints, (states, u, u), of a matrix of the coordinates, (states, n, n)."""
        u = len(self.unknown)
        return np.asarray((matrix.reshape(len(matrix), -1) @ self._projection).reshape(-1, u, u))

    def _acceleration(self, forward: ForwardDynamics, known: Array, x: Array, v: Array) -> Array:
        c, cd, cdd = self._coordinates(known, x, v)
        M, h = self._projected(forward.mass(c)), self._own.T @ forward.inverse(c, cd, cdd)
        try:
            return np.asarray(-np.linalg.solve(M, h.T[:, :, None])[:, :, 0].T)
        except np.linalg.LinAlgError:
            raise self._without("inertia", M) from None

    def _settled(self, forward: ForwardDynamics, sample: np.ndarray) -> Array:
        """States at samples without vibration, (samples, 2u): the torsion carries the links."""
        known = self._known(sample)
        x, v, a = self._first_motion[:, :, sample].copy()
        for _ in range(_SETTLING):
            c, cd, cdd = self._coordinates(known, x, v, a)
            stiffness = self._projected(forward.gradients(c, cd, cdd)[0])
            h = (self._own.T @ forward.inverse(c, cd, cdd)).T
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
        if not (np.isfinite(x).all() and np.abs(v).max(initial=0.0) < FASTEST):  # a step of parameters went far
            raise self._diverged(self.begins, v)
        h, parts = self.step, self._parts(forward, x)
        states = np.empty((self.length + 1, 3, *x.shape))
        for k in range(self.length + 1):
            sample = self._at_step(k)
            a = self._acceleration(forward, self._known(sample), x, v)
            states[k] = x, v, a
            if not np.abs(v).max() < FASTEST:
                raise self._diverged(sample, v)
            if k == self.length:
                break
            slow = np.zeros(len(sample), dtype=bool)
            if parts > 1:
                c, cd, cdd = self._coordinates(self._known(sample), x, v, a)
                slow = turning(self.model, c, cd, cdd, h)
            if not slow.any():
                x, v = self._step(forward, sample, (x, v, a), 1)
                continue
            after = np.empty((2, *x.shape))
            for mask, count in ((slow, parts), (~slow, 1)):
                if not mask.any():  # all segments are near a reversal
                    continue
                now = x[:, mask], v[:, mask], a[:, mask]
                after[:, :, mask] = self._step(forward, sample[mask], now, count)
            x, v = after
        return states

    def _at_step(self, k: int) -> np.ndarray:
        """Sample of each segment at a step; past the end the last one."""
        return np.asarray(np.minimum(self.begins + k, self.samples - 1))

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
        known = self._known(self.begins) * np.array([1.0, 0.0, 0.0])[:, None, None]
        c, cd, cdd = self._coordinates(known, x, still, still)
        M, damping = self._projected(forward.mass(c)), self._projected(forward.gradients(c, cd, cdd)[1])
        rate = float(np.abs(np.linalg.eigvals(np.linalg.solve(M, damping))).max(initial=0.0))
        parts = max(1.0, np.ceil(self.step * rate / STABLE))
        if not parts <= self.most_parts:
            raise SimulationError(
                f"dry friction of the joints behind springs needs {parts:.3g} smaller steps in one of "
                f"{1e3 * self.step:.3g} ms (limit {self.most_parts}).",
                where="dry friction",
                found=parts,
                limit=self.most_parts,
                advice="Put dry friction on the motors, where the rotors carry it.",
            )
        return int(parts)

    def _diverged(self, sample: np.ndarray, v: Array) -> SimulationError:
        time = self.motion.t0 + self.step * int(sample[int(np.abs(v).max(axis=0).argmax())])
        return SimulationError(
            f"the simulated joints behind springs diverge at {time:.3f} s (limit {FASTEST:g} rad/s or m/s).",
            where=time,
            found=float(np.nan_to_num(np.abs(v), nan=np.inf).max()),
            limit=FASTEST,
            advice="Begin with other values of stiffness and damping: priors in the device file.",
        )

    def _linearised(
        self, forward: ForwardDynamics, begin: Array, states: Array, changes: Array | None = None
    ) -> SegmentCourses:
        """Torques and their derivatives, from the variational equations by the trapezoidal rule.

        Args:
            forward: of the model.
            begin, states: of a simulation.
            changes: of what motors move the coordinates by, (3, n, p, samples): derivatives are by these where given.
        """
        u, count, length, n = len(self.unknown), len(self.begins), self.length, len(self._B)
        p = self.base.shape[1] if changes is None else changes.shape[2]
        moving, B, rows = self._moving if changes is None else np.arange(p), self._own, self.motors
        q = len(moving)
        X = np.tile(np.concatenate([np.zeros((2 * u, q)), np.eye(2 * u)], axis=1), (count, 1, 1))
        motion = np.empty((3, n, count, length))
        torque, by_beta, by_begin = (
            np.empty((*shape, count, length)) for shape in ((n,), (len(rows), p), (len(rows), 2 * u))
        )
        before: Array | None = None
        chunk = max(1, _CHUNK // count)
        for first in range(0, length + 1, chunk):
            steps = range(first, min(first + chunk, length + 1))
            sample = np.array([self._at_step(k) for k in steps]).T.ravel()
            x, v, a = states[steps.start : steps.stop].transpose(1, 2, 3, 0).reshape(3, u, -1)
            now = c, cd, cdd = self._coordinates(self._known(sample), x, v, a)
            slopes = forward.slopes(c, cd, cdd)
            if changes is None:
                Y = regressor_columns(self.model, c, cd, cdd, self.base)
            else:
                Y = np.einsum("rmcs,mcks->rks", slopes, changes[..., sample])
            slopes = B.T @ slopes
            # Derivatives of the links' rows and of the motors', by the links' positions, velocities and accelerations.
            links, motors = states_first(np.tensordot(B.T, slopes, (1, 0))), states_first(slopes[rows])
            by_moving = states_first(np.tensordot(B.T, Y, (1, 0))[:, moving])
            # Accelerations by states and by parameters, and what they do to the motors' torque.
            F = -inverses(links[..., 2 * u :]) @ np.concatenate([links[..., : 2 * u], by_moving], axis=2)
            by_all = motors[..., 2 * u :] @ F
            by_all[..., : 2 * u] += motors[..., : 2 * u]
            F = F.reshape(count, -1, u, 2 * u + q)
            change = transitions(F if before is None else np.concatenate([before, F], axis=1), self.step)
            before = F[:, -1:]
            S = np.empty((count, len(steps), *X.shape[1:]))
            for k in range(len(steps)):
                if first or k:
                    now_changed = change[:, k - len(steps)]
                    X = now_changed[..., : 2 * u] @ X
                    X[..., :q] += now_changed[..., 2 * u :]
                S[:, k] = X
            made = by_all[..., : 2 * u] @ S.reshape(-1, 2 * u, q + 2 * u)
            made[..., :q] += by_all[..., 2 * u :]
            own = slice(first, min(steps.stop, length))
            kept = slice(0, own.stop - first)

            def shaped(z: Array, steps: range = steps, kept: slice = kept) -> Array:
                return z.reshape(*z.shape[:-1], count, len(steps))[..., kept]

            slope = shaped(made.transpose(1, 2, 0))
            motion[..., own], torque[..., own] = shaped(now), shaped(forward.inverse(c, cd, cdd))
            by_beta[..., own], by_begin[..., own] = shaped(Y[rows]), slope[:, q:]
            for k, column in enumerate(moving):
                by_beta[:, column, :, own] += slope[:, k]
        met = states[-1, :2].reshape(2 * u, count).T
        met_by_beta = np.zeros((count, 2 * u, p))
        met_by_beta[..., moving] = X[..., :q]
        motion, torque, by_beta, by_begin = (
            z.reshape(*z.shape[:-2], -1)[..., : self.samples] for z in (motion, torque, by_beta, by_begin)
        )
        return SegmentCourses(begin, motion, torque, by_beta, by_begin, met, met_by_beta, X[..., q:])

    def _condensed(self, made: SegmentCourses) -> tuple[DrivenCourse, Array, Array]:
        """Torques and derivatives where segments meet, to first order, segment after segment; the next begin there.

        The first beginning is the one with the least error of the motors' torque, whatever the parameters: a log may
        begin in the middle of a motion (variable projection, Golub and Pereyra 1973, SIAM J. Numerical Analysis 10(2)).

        Args:
            made: segments that do not meet.

        Returns:
            The course, and the beginnings of its segments with their derivatives, (segments, 2u) and (segments, 2u, p).
        """
        moved, by_beta = np.zeros_like(made.begin), np.zeros_like(made.met_by_beta)
        by_first = np.zeros_like(made.met_by_begin)
        by_first[0] = np.eye(by_first.shape[1])
        for k, by_begin in enumerate(made.met_by_begin[:-1]):
            moved[k + 1] = made.met[k] - made.begin[k + 1] + by_begin @ moved[k]
            by_beta[k + 1] = made.met_by_beta[k] + by_begin @ by_beta[k]
            by_first[k + 1] = by_begin @ by_first[k]
        torque, slope, start = np.array(made.torque), made.by_beta, np.empty_like(made.by_begin)
        for k, sample in enumerate(self.begins):
            part = slice(sample, sample + self.length)
            by_begin = made.by_begin[:, :, part]
            torque[self.motors, part] += moved[k] @ by_begin
            slope[:, :, part] += by_beta[k].T @ by_begin
            start[:, :, part] = by_first[k].T @ by_begin
        first, first_by_beta = self._first(torque, slope, start)
        torque[self.motors] += first @ start
        slope += first_by_beta.T @ start
        c, cd, cdd = (np.ascontiguousarray(part) for part in made.motion)
        course = DrivenCourse(c, cd, cdd, torque, slope, start)
        return course, made.begin + moved + by_first @ first, by_beta + by_first @ first_by_beta

    def _agree(self, simulated: Array, met: Array) -> bool:
        """Whether the torque of the segments, (n, samples), is that which it will be where they meet."""
        gap, error, size = (
            np.sqrt(np.mean(x[self.motors] ** 2, axis=1)) for x in (met - simulated, self.measured - met, self.measured)
        )
        return bool((gap <= np.maximum(_GAP * error, _GAP_OF_TORQUE * size)).all())

    def _first(self, torque: Array, slope: Array, start: Array) -> tuple[Array, Array]:
        """Change of the first beginning to the least error of the torque, (2u,), and its derivatives, (2u, p)."""
        error = (self.measured - torque)[self.motors, None]
        return self._projected_on(start, error)[:, 0], -self._projected_on(start, slope)

    def beside_start(self, course: DrivenCourse, columns: Array) -> Array:
        """Columns of the motors' torque, (motors, k, samples), less what another beginning would do, as slopes are."""
        return np.asarray(columns - self._projected_on(course.start, columns).T @ course.start)

    def _projected_on(self, start: Array, columns: Array) -> Array:
        """Least squares of columns of the motors' torque, (motors, k, samples), by the first beginning, (2u, k)."""
        size = np.abs(self.measured[self.motors]).max(axis=1)
        size = np.where(size > 0, size, 1.0)[:, None, None]
        by_start = (start / size).transpose(1, 0, 2).reshape(start.shape[1], -1)
        Q, R = np.linalg.qr(by_start.T)
        Q = np.ascontiguousarray(Q.T).reshape(-1, *start.shape[::2]).transpose(1, 0, 2) / size
        shares = sum(own @ column.T for own, column in zip(Q, columns, strict=True))
        return np.asarray(np.linalg.lstsq(R, shares, rcond=_DETERMINED)[0])


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
