"""Elastic motors from positions of the motors alone: joints behind springs are simulated along the measured motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.dynamics.model import DynamicModel
from haptid.errors import SettingError
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.least_squares import solve
from haptid.estimation.method import Fit, Method, not_converged, rows_of
from haptid.estimation.methods.errors_in_variables import noise_corrected
from haptid.estimation.methods.simulation_based import (
    FULL_STEPS,
    Linearised,
    SimulationBased,
    base_columns,
    linearised_observation,
)
from haptid.estimation.methods.wls import WLS
from haptid.motion.channels import channel_shares, channel_torque
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation
from haptid.simulation import smooth
from haptid.simulation.driven import DrivenCourse, DrivenJoints
from haptid.simulation.driven_noise import MotionNoise, noise_moments
from haptid.simulation.loop import behind_position_filter

# Of logs whose encoders hide parameters.
_ADVICE = (
    "Move faster with the same strokes, or measure with finer encoders; if nothing shows it there either, the motors "
    "are rigid for such motion: remove the elastic terms."
)


@dataclass(frozen=True, eq=False, kw_only=True)
class MotorFit(Fit):
    """A fit whose rows have columns of the torque channels' delays as well.

    Attributes:
        joints: of each motion, as they were simulated last.
        late: what noise adds to the score of each channel's delay, with opposite sign, of weighted rows,
            (motors, blocks, channels).
        wide: the rows, with the rate of each channel's torque behind the columns of the base parameters: R factors of
            [J D y] by motor and block, with the same weights; y - J beta = D times what is missing of the delay.
    """

    joints: tuple[DrivenJoints, ...]
    late: Array
    wide: Observation


@dataclass(frozen=True, kw_only=True)
class MotorSide(SimulationBased):
    """Input error of elastic motors: measured torque against that of the model along the measured positions of motors.

    Gauss-Newton with exact derivatives, which include the motion of the joints behind springs. No controller is needed.
    Positions of joints that springs alone move are not used but as the first approximation. Noise of the motors'
    positions is in the columns and in the error alike: what it adds to both is subtracted from the normal equations.

    Sources: Pham, Gautier and Poignet (2001), IEEE ICRA, for the parameters that motor positions show; Gautier, Janot
    and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section II, for the error; Nakamura (1990),
    Biometrika 77(1), for scores that are corrected for noise.

    Attributes:
        initial: base parameters to begin with by name, SI; those of `start` where left out.
        run_in: not used, because segments meet.
        delays: whether the delay of the torque was estimated from the same rows, so that it is uncertain: the fit is a
            `MotorFit`.
        whitening: symmetric taps of a filter that each motor's errors and columns pass, (motors, taps); None without.
        near: a `MotorFit` of motions nearby, at whose links' motion the simulation begins.
    """

    weighting: Method = field(default_factory=WLS)
    initial: Mapping[str, float] = field(default_factory=dict)
    most: int = 25
    tolerance: float = 0.3
    segment: float = 0.25
    delays: bool = False
    whitening: Array | None = field(default=None, repr=False, compare=False)
    near: Fit | None = field(default=None, repr=False, compare=False)
    _joints: dict[int, DrivenJoints] = field(default_factory=dict, init=False, repr=False, compare=False)
    _courses: list[DrivenCourse] = field(default_factory=list, init=False, repr=False, compare=False)

    def joints(self, smoothed: DynamicModel, motion: Motion) -> DrivenJoints:
        """Of one motion, in segments that meet."""
        length = max(1, min(round(self.segment / motion.dt), len(motion.unbroken("a method that simulates"))))
        return DrivenJoints(smoothed, motion, length, base_columns(smoothed))

    def settled(self) -> bool:
        """Whether segments meet: until then, parameters may hardly move far from the least squares."""
        return all(joints.meets for joints in self._joints.values())

    def rows(self, observation: Observation) -> Observation:
        """As of every method that simulates; passes share the initial states of their segments."""
        return super(MotorSide, replace(self)).rows(observation)

    def fit(self, observation: Observation) -> Fit:
        """The solution corrected for the noise of the motors' positions.

        Raises:
            IdentifiabilityError: noise makes up too much of the information on a direction of the parameters.
            ConvergenceError, SimulationError: as `rows`.
        """
        own = replace(self)
        rows = super(MotorSide, own).rows(observation)
        smoothed = smooth(observation.model, observation.motions, self.friction)
        beta = solve(rows, self.weights(rows)).beta
        sources = [MotionNoise.of(observation.model, motion) if motion.log else None for motion in observation.motions]
        for number in range(self.most):
            weights = self.weights(rows)
            noise, late = noise_of_rows(rows, beta, weights, sources, self.whitening)
            found = noise_corrected(rows, weights, noise, _ADVICE)
            moved = np.abs(found.solution.beta - beta) / np.sqrt(np.diag(ClusterRobust().spread(found).covariance))
            if moved.max() <= self.tolerance:
                return own._with_delays(observation, found, beta, late) if self.delays else found
            beta = found.solution.beta if number < FULL_STEPS else 0.5 * (beta + found.solution.beta)
            rows = rows_of(self.weighting, own.linearised_rows(observation, smoothed, beta))
        worst = int(np.argmax(moved))
        raise not_converged(self.name, self.most, observation.base.names[worst], float(moved[worst]), self.tolerance)

    def first(self, observation: Observation) -> Array:
        """The parameters to begin with."""
        if not observation.model.device.elastic:
            raise SettingError(
                f"{observation.model.device.name} has no elastic motor, and {self.name} identifies elastic motors.",
                where=self.name,
                advice='Add [[terms]] kind = "elastic" to the device file, or estimate with WLS.',
            )
        beta = np.array(super().first(observation) if len(self.initial) < len(observation.base) else [])
        if not len(beta):
            return np.array([self.initial[name] for name in observation.base.names])
        for k, name in enumerate(observation.base.names):
            beta[k] = self.initial.get(name, beta[k])
        return beta

    def linearised_rows(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of the motors' torque; joints without motor have none."""
        self._courses.clear()
        for place, motion in enumerate(observation.motions):
            if place not in self._joints:
                self._joints[place] = self.joints(smoothed, motion)
                if isinstance(self.near, MotorFit):
                    self._joints[place].begin_as(self.near.joints[place])
            self._courses.append(self._joints[place].course(beta))
        return self._linearised(observation, beta, [course.slope for course in self._courses])

    def _linearised(self, observation: Observation, values: Array, slopes: Sequence[Array]) -> Observation:
        """Rows of the motors' torque along the last simulation, each motion with slopes, (motors, columns, samples)."""
        parts, device = [], observation.model.device
        for place, (motion, slope) in enumerate(zip(observation.motions, slopes, strict=True)):
            joints = self._joints[place]
            measured = behind_position_filter(motion, joints.measured)
            error = (measured - self._courses[place].torque)[joints.motors]
            parts.append(self.whitened(Linearised(motion, error, slope, joints.names)))
        idle = [drive.name for drive in device.drives if drive.unloaded]
        motors = tuple(motor for motor in observation.motors if motor.name not in idle)
        rows = replace(observation, motors=motors)
        return linearised_observation(rows, values, parts, [motor.unit for motor in motors])

    def whitened(self, part: Linearised) -> Linearised:
        """Errors and columns of one motion behind the whitening filters."""
        if self.whitening is None:
            return part
        from scipy.signal import fftconvolve  # slow to import, and few fits weigh frequencies

        every = np.concatenate([part.error[:, None], part.slope], axis=1)
        filters = zip(every, self.whitening, strict=True)
        made = np.array([fftconvolve(own, taps[None], "same", axes=1) for own, taps in filters])
        return replace(part, error=made[:, 0], slope=made[:, 1:])

    def _with_delays(self, observation: Observation, found: Fit, beta: Array, late: Array) -> MotorFit:
        """A fit with columns of the delays, from the last simulation, that with parameters `beta`."""
        rates, shares = list[Array](), list[Array]()
        for place, (motion, course) in enumerate(zip(observation.motions, self._courses, strict=True)):
            joints = self._joints[place]
            columns = _torque_rates(observation.model.device, motion, course)[joints.motors]
            own = np.gradient(course.torque[joints.motors], float(motion.dt), axis=1)[:, None]
            shares.append(np.sum(columns * own, axis=2) / np.maximum(np.sum(own**2, axis=2), np.finfo(float).tiny))
            rates.append(joints.beside_start(course, columns))
        values = np.append(beta, np.zeros(rates[0].shape[1]))
        slopes = [np.concatenate([own.slope, rate], axis=1) for own, rate in zip(self._courses, rates, strict=True)]
        wide = self._linearised(observation, values, slopes)
        simulated = tuple(self._joints[place] for place in range(len(observation.motions)))
        scores = late[:, :, None] * np.mean(shares, axis=0)[:, None]
        plain = {own.name: getattr(found, own.name) for own in fields(found)}
        return MotorFit(**plain, joints=simulated, late=scores, wide=wide)


def _torque_rates(device: Device, motion: Motion, course: DrivenCourse) -> Array:
    """Rate of each channel's torque, by the model, in every row, (n, channels, samples), N m/s or N/s.

    By the model, because noise of the torque in such a column would bias the delay.
    """
    shares = channel_shares(device, motion, course.c)
    rates = np.gradient(channel_torque(device, shares, course.torque), float(motion.dt), axis=1)
    return np.asarray(shares.transpose(2, 1, 0) * rates)


def noise_of_rows(
    rows: Observation,
    beta: Array,
    weights: Array,
    sources: Sequence[MotionNoise | None],
    whitening: Array | None = None,
) -> tuple[list[Array], Array]:
    """Expected squares of noise in weighted rows, of each motor (blocks, p + 1, p + 1), and in the rate of its torque.

    Args:
        rows: linearised about a simulation, J b = J beta + e.
        beta: base parameters of the simulation, (p,).
        weights: of each motor's rows, (motors,).
        sources: noise of each motion; None without.
        whitening: as of `MotorSide`.

    Returns:
        The squares, and what noise adds to the score of the rate of each row's torque, with opposite sign,
        (motors, blocks).
    """
    base, p = base_columns(rows.model), len(beta)
    noise = [np.zeros((len(rows.blocks), p + 1, p + 1)) for _ in rows.motors]
    late = np.zeros((len(rows.motors), len(rows.blocks)))
    errors = [np.sum((m.whole[:, -1] - m.whole[:, :-1] @ beta[m.columns]) ** 2) / m.rows.sum() for m in rows.motors]
    names = [drive.name for drive in rows.model.device.drives if drive.motorised]
    own = {motor.name: error for motor, error in zip(rows.motors, errors, strict=True)}
    squares = np.array([own.get(name, 0.0) for name in names])
    for motion, source in zip(rows.motions, sources, strict=True):
        if source is None:
            continue
        moments = noise_moments(rows.model, base, beta, motion, source, squares, whitening)
        blocks = [k for k, block in enumerate(rows.blocks) if block.log == motion.name]
        for k, (motor, weight) in enumerate(zip(rows.motors, weights, strict=True)):
            if motor.name not in names:
                continue
            place = names.index(motor.name)
            N = np.zeros((p + 1, p + 1))
            N[:p, :p] = moments.information[place]
            # The corrected score is that of the rows plus `score`.
            N[:p, p] = N[p, :p] = moments.information[place] @ beta - moments.score[place]
            noise[k][blocks] = weight**2 * motor.rows[blocks, None, None] * N
            late[k, blocks] = weight**2 * motor.rows[blocks] * moments.late[place]
    return noise, late
