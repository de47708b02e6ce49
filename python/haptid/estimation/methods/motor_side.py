"""Elastic motors from positions of the motors alone: joints behind springs are simulated along the measured motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import SettingError
from haptid.estimation.estimate import Estimate
from haptid.estimation.method import Method
from haptid.estimation.methods.simulation_based import Linearised, SimulationBased, base_columns, linearised_observation
from haptid.estimation.methods.wls import WLS
from haptid.log.spectrum import spectra
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation
from haptid.simulation import Segments, smooth
from haptid.simulation.driven import DrivenJoints
from haptid.simulation.driven_noise import noise_moments


@dataclass(frozen=True, kw_only=True)
class MotorSide(SimulationBased):
    """Input error of elastic motors: measured torque against that of the model along the measured positions of motors.

    Gauss-Newton with exact derivatives, which include the motion of the joints behind springs. The motors' positions
    are taken as exact behind their filter; no controller is needed. Positions of joints that springs alone move are
    not used but as the first approximation.

    Sources: Pham, Gautier and Poignet (2001), IEEE ICRA, for the parameters that motor positions show; Gautier, Janot
    and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section II, for the error.

    Attributes:
        initial: base parameters to begin with by name, SI; those of `start` where left out.
        run_in: not used, because segments meet.
    """

    weighting: Method = field(default_factory=WLS)
    initial: Mapping[str, float] = field(default_factory=dict)
    most: int = 25
    tolerance: float = 0.3
    segment: float = 0.25
    _joints: dict[int, DrivenJoints] = field(default_factory=dict, init=False, repr=False, compare=False)

    def segments(self, motion: Motion) -> Segments:
        """Of one motion; each begins at the last sample of the one before."""
        samples = len(motion.unbroken("a method that simulates"))
        return Segments.of(samples, max(1, round(self.segment / motion.dt)), 1)

    def settled(self) -> bool:
        """Whether segments meet: until then, parameters may hardly move far from the least squares."""
        return all(joints.meets for joints in self._joints.values())

    def rows(self, observation: Observation) -> Observation:
        """As of every method that simulates; passes share the initial states of their segments."""
        return super(MotorSide, replace(self)).rows(observation)

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
        model, parts = observation.model, []
        for place, motion in enumerate(observation.motions):
            if place not in self._joints:
                self._joints[place] = DrivenJoints(smoothed, motion, self.segments(motion), base_columns(model))
            joints = self._joints[place]
            course = joints.course(beta)
            parts.append(Linearised(motion, joints.measured - course.torque, course.slope))
        idle = [drive.name for drive in model.device.drives if drive.unloaded]
        motors = tuple(motor for motor in observation.motors if motor.name not in idle)
        rows = replace(observation, motors=motors)
        return linearised_observation(rows, beta, parts, [motor.unit for motor in motors])


# Note on the intervals.
UNPROVEN = (
    "The coverage of intervals from the motor side alone has not been studied over many logs: take them for a lower "
    "bound of the uncertainty, that of damping above all. Positions of both sides have intervals that are validated."
)


def with_noise_uncertainty(fitted: Estimate) -> Estimate:
    """The estimate with what the encoders' noise may have moved its parameters by in its covariance.

    Args:
        fitted: by `MotorSide`; its motions hold the simulated joints.
    """
    G, _, b = _moments(fitted)
    fitted = fitted.with_nuisance("noise of the encoders", np.asarray(np.linalg.solve(G, b)[None], dtype=np.float64))
    return replace(fitted, notes=(*fitted.notes, UNPROVEN))


def shares_of_motor_noise(fitted: Estimate) -> Array:
    """Share of the encoders' noise in the part of each column that no other column explains, (p,).

    Above one the noise, as the model amplifies it, is more than the column holds.

    Args:
        fitted: by `MotorSide`.
    """
    G, N, _ = _moments(fitted)
    v = np.linalg.inv(G)
    return np.asarray(np.einsum("ij,ik,kj->j", v, N, v) / np.diag(v))


def _moments(fitted: Estimate) -> tuple[Array, Array, Array]:
    """Weighted squares of the rows, (p, p), those of the encoders' noise in them, and its score, (p,)."""
    assert isinstance(fitted.method, MotorSide)
    rows, smoothed = fitted.fit.observation, smooth(fitted.model, fitted.observation.motions, fitted.method.friction)
    base, p = base_columns(fitted.model), len(fitted.base)
    G, N, b = np.zeros((p, p)), np.zeros((p, p)), np.zeros(p)
    for motor, weight in zip(rows.motors, fitted.fit.weights, strict=True):
        R = motor.whole[:, :-1] * weight
        G[np.ix_(motor.columns, motor.columns)] += R.T @ R
    for motion in rows.motions:
        if motion.log is None:
            continue
        variance = np.array([spectrum.white(float(motion.log.dt)) for spectrum in spectra(motion.log)])
        information, score = noise_moments(smoothed, base, fitted.beta, motion, variance)
        own = [k for k, block in enumerate(rows.blocks) if block.log == motion.name]
        for motor, weight in zip(rows.motors, fitted.fit.weights, strict=True):
            k, count = fitted.model.device.row_names.index(motor.name), weight**2 * int(motor.rows[own].sum())
            N += count * information[k]
            b += count * score[k]
    return G, N, b
