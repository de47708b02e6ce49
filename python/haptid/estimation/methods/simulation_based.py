"""Methods that simulate the closed loop: DIDIM, closed-loop input error (CLIE) and output error (CLOE)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from itertools import pairwise

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import regressor_columns
from haptid.errors import SettingError, SimulationError
from haptid.estimation.estimate import estimate
from haptid.estimation.method import (
    Method,
    Wrapper,
    expect_motors,
    expect_positive,
    expect_weighting,
    expect_whole,
    not_converged,
    rows_of,
)
from haptid.estimation.methods.errors_in_variables import of_motions
from haptid.estimation.methods.wls import WLS
from haptid.motion.channels import coordinate_torque, position_map, state
from haptid.motion.motion import Motion, treat
from haptid.motion.streaming import delayed
from haptid.observation.filtering import decimate
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk, Rows
from haptid.simulation import (
    PID,
    Course,
    Segments,
    Sensitivity,
    Steps,
    closed_loop,
    expect_no_history,
    sensitivity,
    smooth,
)

# Number of full Gauss-Newton steps; later ones are halved, because some would oscillate between two points.
FULL_STEPS = 5
# Halvings of a step to parameters with which the simulation diverges.
HALVINGS = 6


@dataclass(frozen=True, kw_only=True)
class SimulationBased(Wrapper, ABC):
    """A method that alternates between simulating the model and fitting rows linearised about the simulation.

    Attributes:
        weighting: how the linearised rows are weighted.
        start: the method that gives the initial parameters.
        most: largest number of passes.
        tolerance: convergence: no parameter moves by more than this, in standard errors.
        friction: dry friction is smoothed within this share of a joint's root mean square speed: what it lacks near
            standstill biases dry and viscous friction, and less smoothing takes more integration steps.
        segment, run_in: length of each simulated segment, and of the transient before it that is not used, s.
    """

    weighting: Method = field(default_factory=WLS)
    start: Method = field(default_factory=WLS)
    most: int = 10
    tolerance: float = 0.1
    friction: float = 1e-3
    segment: float = 0.5
    run_in: float = 0.5

    def __post_init__(self) -> None:
        expect_weighting(self.name, self.weighting)
        expect_whole(self.name, "most", self.most, 1)
        for name in ("tolerance", "friction", "segment", "run_in"):
            expect_positive(self.name, name, getattr(self, name))

    @property
    def name(self) -> str:
        return type(self).__name__

    def rows(self, observation: Observation) -> Observation:
        """Rows linearised about the simulation at the estimate: their weighted least squares give the estimate.

        Raises:
            SettingError: a closed loop without controller, or with that of another device.
            SimulationError: the model cannot be simulated with the initial parameters.
            ConvergenceError: no convergence within `most` passes.
        """
        expect_motors(self.name, observation)
        self.check(observation)
        beta, previous = None, self.first(observation)
        expect_no_history(observation.model)
        smoothed = smooth(observation.model, observation.motions, self.friction)
        for number in range(self.most):
            goal = previous if beta is None or number < FULL_STEPS else 0.5 * (beta + previous)
            beta, rows = self._next(observation, smoothed, beta, goal)
            rows = rows_of(self.weighting, rows)
            fitted = estimate(rows, self.weighting)
            previous, moved = fitted.beta, np.abs(fitted.beta - beta) / np.maximum(fitted.se, np.finfo(float).tiny)
            if moved.max() <= self.tolerance and self.settled():
                return rows
        worst = int(np.argmax(moved))
        name = observation.base.names[worst]
        raise not_converged(self.name, self.most, name, float(moved[worst]), self.tolerance)

    def first(self, observation: Observation) -> Array:
        """Base parameters to begin with, (p,)."""
        return estimate(observation, self.start).beta

    def _next(
        self, observation: Observation, smoothed: DynamicModel, before: Array | None, previous: Array
    ) -> tuple[Array, Observation]:
        """Parameters of the next simulation, and its rows; the step is halved where the simulation diverges."""
        for _ in range(HALVINGS):
            try:
                return previous, self.linearised_rows(observation, smoothed, previous)
            except SimulationError:
                if before is None:
                    raise
                previous = 0.5 * (before + previous)
        return previous, self.linearised_rows(observation, smoothed, previous)

    def check(self, observation: Observation) -> None:
        """Raise for missing inputs before any simulation."""

    def settled(self) -> bool:
        """Whether the last simulation is that of its parameters, whatever those are."""
        return True

    def segments(self, motion: Motion) -> Segments:
        """Of one motion."""
        samples = len(motion.unbroken("a method that simulates"))
        return Segments.of(samples, round(self.segment / motion.dt), round(self.run_in / motion.dt))

    @abstractmethod
    def linearised_rows(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows whose least squares give the next estimate, from a simulation with parameters `beta`."""


@dataclass(frozen=True)
class ClosedLoop(SimulationBased):
    """A method that simulates the device under the controller of the log.

    Attributes:
        controller: PD or PID with its reference.
    """

    controller: PID | None = None

    @property
    def law(self) -> PID:
        """The controller.

        Raises:
            SettingError: there is none.
        """
        if self.controller is None:
            raise SettingError(
                f"{self.name} simulates the device under the controller of the log, and none is given.",
                where="controller",
                advice=f"Write {self.name}(PID(kp=(...), kd=(...), reference=...)) with the gains at the joint side, "
                "N m/rad and N m s/rad; or estimate with WLS, which needs none.",
            )
        return self.controller

    def check(self, observation: Observation) -> None:
        """Raise for missing inputs before any simulation.

        Raises:
            SettingError: there is no controller, or it is one of another device.
        """
        self.law.figures("kp", observation.model)

    def courses(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> list[Course]:
        """The simulated trajectory along every motion."""
        forward = ForwardDynamics(smoothed, sets_of(observation.model, beta))
        courses = []
        for place, motion in enumerate(observation.motions):
            steps = closed_loop(forward, self.law, motion, place, self.segments(motion))
            courses.append(steps.course(motion))
        return courses


@dataclass(frozen=True)
class DIDIM(ClosedLoop):
    """Direct and inverse dynamic identification models: Gauss-Newton on the torque of the simulated closed loop.

    The derivative of the simulated torque by the parameters is approximated by the regressor at the simulated motion,
    because the controller makes that motion follow the reference whatever the parameters. The measured positions only
    give the initial state of each segment, so W has neither their noise nor their filter.

    Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III.
    """

    def linearised_rows(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of torque on the regressor of the simulated motion."""
        base, parts = base_columns(observation.model), []
        for course in self.courses(observation, smoothed, beta):
            slope = regressor_columns(smoothed, course.c, course.cd, course.cdd, base)
            parts.append(Linearised(course.motion, torque_error(observation.model, course), slope))
        return linearised_observation(observation, beta, parts, [motor.unit for motor in observation.motors])


@dataclass(frozen=True)
class CLIE(ClosedLoop):
    """Closed-loop input error: the measured torque against that of the model under the same controller.

    As `DIDIM`, but with exact derivatives of the torque, including the response of the controller.

    Source: Brunot, Janot, Young and Carrillo (2018), Control Engineering Practice 74, section 3.
    """

    def linearised_rows(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of torque."""
        parts = []
        for motion, steps, course in self.sensitivities(observation, smoothed, beta):
            assert course.tau is not None  # a closed loop
            error = torque_error(observation.model, steps.course(motion))
            parts.append(Linearised(motion, error, steps.segments.joined(course.tau)))
        return linearised_observation(observation, beta, parts, [motor.unit for motor in observation.motors])

    def sensitivities(
        self, observation: Observation, smoothed: DynamicModel, beta: Array
    ) -> list[tuple[Motion, Steps, Sensitivity]]:
        """Every motion, its simulation, and the sensitivities of that to the base parameters."""
        model = observation.model
        forward = ForwardDynamics(smoothed, sets_of(model, beta))
        base, results = base_columns(model), []
        for place, motion in enumerate(observation.motions):
            steps = closed_loop(forward, self.law, motion, place, self.segments(motion))
            results.append((motion, steps, sensitivity(forward, self.law, motion, steps, base)))
        return results


@dataclass(frozen=True)
class CLOE(CLIE):
    """Closed-loop output error: the measured positions against those of the model under the same controller.

    With a stiff controller the positions depend little on the parameters: by torque over gain, which has to exceed the
    encoder noise. The treated positions are compared.

    Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section II.C.
    """

    def linearised_rows(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of position."""
        model = observation.model
        parts = []
        for motion, steps, course in self.sensitivities(observation, smoothed, beta):
            simulated = treated_as(model, steps.course(motion))
            low, high = motion.usable
            error = np.zeros((len(model.device.row_names), len(motion)))
            error[:, low:high] = state(model.device, motion, low, high)[0]
            error[:, low:high] -= state(model.device, simulated, low, high)[0]
            parts.append(Linearised(motion, error, steps.segments.joined(course.c)))
        names = [model.device.row_names.index(motor.name) for motor in observation.motors]
        return linearised_observation(observation, beta, parts, [model.device.coordinate_units[k] for k in names])


def base_columns(model: DynamicModel) -> Array:
    """Selection of the regressor's columns that are base parameters, (r, p)."""
    return np.asarray(model.device.parameters.S[:, list(model.base.independent_columns)])


def torque_error(model: DynamicModel, course: Course) -> Array:
    """Measured less simulated torque, treated alike, (n, samples), N m or N."""
    motion = course.motion
    late = float(np.median(motion.treatment.torque_delay_s)) / motion.dt if motion.log else 0.0
    simulated = delayed(course.tau.T, late).T if late else course.tau
    return coordinate_torque(model.device, motion, 0, len(motion)) - simulated


def treated_as(model: DynamicModel, course: Course) -> Motion:
    """The simulated motion, treated as the measured one was; its torque is the measured one."""
    motion = course.motion
    to_channels = np.linalg.inv(position_map(model.device, motion)(np.eye(motion.q.shape[1])))
    q, qd, qdd = (np.ascontiguousarray((to_channels @ x).T) for x in (course.c, course.cd, course.cdd))
    if motion.log is not None:
        return treat(replace(motion.log, position=q), motion.treatment)
    return replace(motion, q=q, rates=None if motion.rates is None else (qd, qdd))


def simulate_along(observation: Observation, motions: list[Motion]) -> Observation:
    """The observation with its rows made from other motions, one for each of its own, with the same samples."""
    return Rows(of_motions(observation, motions)).folded(lambda chunk: chunk)


@dataclass(frozen=True, eq=False)
class Linearised:
    """A simulation linearised in the base parameters, at every sample of a motion, for rows of the device.

    Attributes:
        motion: that was simulated.
        error: measured less simulated, (n, samples), SI.
        slope: derivatives of the simulated quantity by base parameters, (n, p, samples).
        rows: names of the n rows; all of the device where None.
    """

    motion: Motion
    error: Array
    slope: Array
    rows: Sequence[str] | None = None


def linearised_observation(
    observation: Observation, beta: Array, parts: Sequence[Linearised], units: Sequence[str]
) -> Observation:
    """Rows J beta' = J beta + error, filtered and decimated as the observation's are, block by block.

    Rows that the treatment excludes near slow motion are excluded here too.

    Args:
        observation: whose motors and blocks they are of.
        beta: parameters of the simulation, (p,).
        parts: one for each of the observation's motions.
        units: of every motor's rows.
    """
    by_index = {block: rows for part in parts for block, rows in _block_rows(observation, part)}

    def change(chunk: Chunk) -> Chunk:
        J, error = (np.concatenate(x, axis=1) for x in zip(*(by_index[k] for k in chunk.blocks), strict=True))
        return chunk.with_rows(J * chunk.used[:, :, None], (error + J @ beta) * chunk.used)

    folded = Rows(observation).folded(change, [np.arange(len(beta)) for _ in observation.motors])
    motors = (replace(motor, unit=unit) for motor, unit in zip(folded.motors, units, strict=True))
    return replace(folded, motors=tuple(motors))


def _block_rows(observation: Observation, part: Linearised) -> Iterator[tuple[int, tuple[Array, Array]]]:
    """Of every block of one motion in the observation: its index, J (motors, rows, p), and errors."""
    names = list(part.rows or observation.model.device.row_names)
    own = [names.index(motor.name) for motor in observation.motors]
    plan, d = Plan.of(observation.model, part.motion), part.motion.treatment.decimation
    index = {block: k for k, block in enumerate(observation.blocks)}
    starts = pairwise([*range(0, plan.rows, plan.block), plan.rows])
    for block, (start, stop) in zip(plan.blocks(part.motion.name), starts, strict=True):
        if block in index:
            low, high = plan.window(start, stop)
            J = decimate(part.slope[own, :, low:high], plan.taps, d)
            yield index[block], (J.transpose(0, 2, 1), decimate(part.error[own, low:high], plan.taps, d))


def by_block(observation: Observation, method: str, r_factors: Array, rows: np.ndarray) -> Observation:
    """Rows of a method that treats all motors as one and stores R factors only.

    Args:
        observation: whose blocks they are of.
        method: its name.
        r_factors: R factor of every block, (blocks, p + 1, p + 1), of rows of unit variance.
        rows: in each, (blocks,).
    """

    def refuse(_: Chunk) -> Chunk:
        raise SettingError(
            f"{method} stores the information of each block of time, and no single rows, which these intervals need.",
            where=method,
            advice="Use BlockJackknife() or Classical().",
        )

    name = observation.motors[0].name  # a known one, so that a request for its rows gets as far as `refuse`
    motor = MotorRows(name, method, "1", np.arange(r_factors.shape[1] - 1), freeze(r_factors), rows)
    return replace(observation, motors=(motor,), change=refuse)
