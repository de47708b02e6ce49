"""Hand force in real time: the generalised-momentum observer.

Source: De Luca and Mattone (2005), IEEE ICRA, eqs (10) to (14).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze_fields, positive
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import core_torque, momentum, raw_parameters, rigid
from haptid.dynamics.kinematics import handle_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.dynamics.wrench import Lever
from haptid.end_effector.force import (
    REVERSAL_SPEED,
    WORST_CONDITION,
    HandleForce,
    WrenchEstimate,
    check_finite,
    check_force_settings,
    handle_force,
    lever_of,
    noise_of,
    noted,
)
from haptid.errors import setting_error
from haptid.estimation import Estimate
from haptid.estimation.feasibility.feasible import check_beta
from haptid.motion.channels import coordinate_torque, state
from haptid.motion.motion import Motion
from haptid.observation.reversals import friction_uncertainty, smoothed_friction
from haptid.uncertainty.quantities import covariance_root
from haptid.validation.validation import Validation

# Time constants after which a singular pose no longer affects the low-pass: 0.7 % is left.
TRANSIENT_DELAYS = 5.0
# Samples passed to the core at a time.
_CHUNK = 1 << 14


@dataclass(frozen=True, eq=False)
class ObserverResult:
    """The observer's output after some samples, and its state for the next ones.

    Attributes:
        torque: external torque on every torque row after each sample, (rows, samples), N m or N.
        mean: of the external torque over the step that ends at each sample, before the low-pass, (rows, samples).
        p: momentum at the last sample, (rows,).
        pushed: rate of momentum without the hand at the last sample: tau + C' cd - g - friction, (rows,).
    """

    torque: Array
    mean: Array
    p: Array
    pushed: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "torque", "mean", "p", "pushed")


@dataclass(frozen=True)
class MomentumObserver:
    """Momentum observer r = K (p - integral of (tau + C' cd - g - friction + r)): the hand's torque times K / (s + K).

    It requires no acceleration, and no more of the past than one sample. Over one step the momentum changes by the mean
    torque; the part not explained by motors, gravity, friction and velocity product is the mean external torque, and
    passes the low-pass as a held signal: exact for any gain and step, without drifting integrals.

    Attributes:
        gain: K, rad/s; the response to a step reaches 63 % after 1 / K.
        reversal_speed: below it the sign of a velocity is smoothed, rad/s or m/s.
    """

    gain: float = 40.0
    reversal_speed: float = REVERSAL_SPEED

    def __post_init__(self) -> None:
        if not positive(self.gain):
            raise setting_error("gain", self.gain, "a finite number above zero, rad/s")
        check_force_settings(self.reversal_speed, WORST_CONDITION)

    @property
    def bandwidth_hz(self) -> float:
        """-3 dB bandwidth, K / 2 pi, Hz."""
        return self.gain / (2 * np.pi)

    @property
    def delay(self) -> float:
        """Low-frequency delay, 1 / K, s; the sampling adds half a step."""
        return 1 / self.gain

    def follow(
        self,
        model: DynamicModel,
        beta: ArrayLike,
        dt: float,
        qa: ArrayLike,
        qda: ArrayLike,
        tau: ArrayLike,
        before: ObserverResult | None = None,
    ) -> ObserverResult:
        """Watch some more samples, one or many.

        Args:
            beta: its base parameters, (p,), SI.
            dt: step, s.
            qa: positions of the active joints, (active, samples), rad or m.
            qda: their velocities.
            tau: motors' torque on every torque row, (rows, samples), N m or N.
            before: what was known before the first sample; None where watching begins there, with no push.

        Raises:
            ShapeError: an array does not fit the device.
            SettingError: a step that is not positive, no sample, or a sample or base parameter that is not finite.
            MissingAccelerationError: a column of the device reads accelerations.
        """
        from scipy import signal  # slow to import, and few programs observe a force

        if not positive(dt):
            raise setting_error("dt", dt, "a finite time above zero, s")
        shape = (len(model.device.active), np.shape(qa)[-1] if np.ndim(qa) else 0)
        for name, array in (("qa", qa), ("qda", qda), ("tau", tau)):
            expect(name, np.shape(array), shape)
            check_finite(name, array)
        if not shape[1]:
            raise setting_error("number of samples", 0, "one sample or more")
        c, cd = (model.device.row_map @ np.asarray(x, dtype=float) for x in (qa, qda))
        p, pushed = self._balance(model, raw_parameters(model, check_beta(model, beta)), c, cd)
        pushed = pushed + np.asarray(tau, dtype=float)
        rest = np.zeros((len(c), 1))
        last = before or ObserverResult(rest, rest, p[:, 0], -pushed[:, 0])  # no step leads to the first sample
        explained = np.column_stack([last.pushed, pushed])
        mean = np.diff(p, axis=1, prepend=last.p[:, None]) / dt - 0.5 * (explained[:, 1:] + explained[:, :-1])
        made, _ = signal.lfilter(*self._filter(dt), mean, axis=1, zi=self._pole(dt) * last.torque[:, -1:])
        return ObserverResult(np.asarray(made), mean, p[:, -1], pushed[:, -1])

    def smooth(self, signals: Array, dt: float) -> Array:
        """The observer's own low-pass of other signals, from rest, (channels, samples), for comparisons.

        Args:
            signals: means over the steps that end at each sample; samples themselves come out half a step early.
            dt: step, s.
        """
        from scipy import signal  # slow to import, and few programs observe a force

        return np.asarray(signal.lfilter(*self._filter(dt), signals, axis=-1))

    def _pole(self, dt: float) -> float:
        """Pole of the discrete low-pass."""
        return float(np.exp(-self.gain * dt))

    def _filter(self, dt: float) -> tuple[list[float], list[float]]:
        """K / (s + K) of a held signal: numerator and denominator."""
        pole = self._pole(dt)
        return [1 - pole], [1, -pole]

    def _balance(self, model: DynamicModel, chi: Array, c: Array, cd: Array) -> tuple[Array, Array]:
        """Momentum, and its rate without the hand and the motors, each (rows, samples)."""
        soft, bodies, pieces = smoothed_friction(model, self.reversal_speed), rigid(model, chi), []
        for low in range(0, c.shape[1], _CHUNK):
            here, rates = c[:, low : low + _CHUNK], cd[:, low : low + _CHUNK]
            p, rest = momentum(model, bodies, here, rates)
            own = external(soft, here, rates, None)
            terms = core_torque(soft, chi - bodies, here, rates, np.zeros_like(here), own)
            pieces.append((p, -rest - terms))
        p, rate = (np.concatenate(each, axis=1) for each in zip(*pieces, strict=True))
        return p, rate


def observe_force(
    estimate: Estimate,
    motion: Motion,
    observer: MomentumObserver | None = None,
    *,
    validation: Validation | None = None,
    worst_condition: float = WORST_CONDITION,
) -> HandleForce:
    """Force of the hand on the device along a motion, by the momentum observer.

    One row for each sample of the motion that has rates, from rest: a push at the first sample appears after about
    1 / gain. The low-pass acts on the wrench in the base frame, not on joint torques, whose relation to the force
    varies with the pose. The moment is taken as zero or, with six measured torque rows or more, estimated.

    Args:
        estimate: the model.
        motion: with torques, while the hand pushes.
        observer: the default one where None.
        validation: on unseen rows without a hand; its residual is the noise of the torque rows, correct where its
            treatment has about the observer's bandwidth.
        worst_condition: condition number of the Jacobian beyond which a pose is left out.

    Raises:
        IncompleteDeviceError: the device has no handle.
        SettingError: a setting out of range.
        LogMismatchError: the motion has more or fewer channels than the device has coordinates or motors.
        MissingAccelerationError: a column of the device reads accelerations.
    """
    observer = observer or MomentumObserver()
    handle_of(estimate.model)
    check_force_settings(observer.reversal_speed, worst_condition)
    path = _Path.of(estimate, motion)
    found = lever_of(estimate, path.middles, noise_of(estimate, validation), False, worst_condition)
    noise = np.square(found.inverse) @ np.square(noise_of(estimate, validation))
    return handle_force(estimate, found, path.wrench(observer, found, noise.T), noted(validation))


@dataclass(frozen=True, eq=False)
class _Path:
    """The observer's input: samples of a motion.

    Attributes:
        estimate: the model.
        dt: step, s.
        t: (samples,), s.
        qa, qda: of the active joints, (active, samples).
        tau: motors' torque on the torque rows, (active, samples).
    """

    estimate: Estimate
    dt: float
    t: Array
    qa: Array
    qda: Array
    tau: Array

    @staticmethod
    def of(estimate: Estimate, motion: Motion) -> _Path:
        """All samples that have rates."""
        model, (low, high) = estimate.model, motion.unbroken("the momentum observer").usable
        c, cd = state(model.device, motion, low, high)
        to_joints, tau = np.linalg.inv(model.device.row_map), coordinate_torque(model.device, motion, low, high)
        t = np.asarray(motion.t0 + motion.dt * np.arange(low, high), dtype=np.float64)
        return _Path(estimate, motion.dt, t, to_joints @ c, to_joints @ cd, tau)

    @property
    def middles(self) -> Array:
        """Positions at the middle of the step that ends at each sample, (active, samples)."""
        return 0.5 * (self.qa + np.column_stack([self.qa[:, :1], self.qa[:, :-1]]))

    def wrench(self, observer: MomentumObserver, found: Lever, noise: Array) -> WrenchEstimate:
        """The wrench at every step, then the observer's low-pass in the base frame."""
        estimate, model, dt = self.estimate, self.estimate.model, self.dt
        rows, none = list(model.measured_rows), np.zeros_like(self.tau)

        def smooth(wrench: Array) -> Array:
            return observer.smooth(np.where(found.usable, wrench, 0.0), dt)

        def filtered(beta: Array, torque: Array) -> Array:
            return smooth(found.wrench(observer.follow(model, beta, dt, self.qa, self.qda, torque).mean[rows]))

        variance = noise.copy()
        for column in covariance_root(
            estimate.covariance
        ).T:  # the observer is linear in parameters and torques together
            variance += filtered(column, none) ** 2
        sizes = self._friction_errors(observer)[rows]
        for m, size in enumerate(sizes):
            variance += smooth(np.abs(found.inverse[:, :, m].T) * size) ** 2
        long = min(len(self.t), 1 + round(TRANSIENT_DELAYS * observer.delay / dt))
        return WrenchEstimate(
            t=self.t,
            external=observer.follow(model, estimate.beta, dt, self.qa, self.qda, self.tau).torque[rows],
            wrench=filtered(estimate.beta, self.tau),
            bare=filtered(np.zeros_like(estimate.beta), self.tau),
            variance=variance,
            usable=np.convolve(~found.usable, np.ones(long))[: len(self.t)] < 0.5,
            moment=np.zeros((0, len(self.t))),
        )

    def _friction_errors(self, observer: MomentumObserver) -> Array:
        """Uncertainty of dry friction, (active, samples), N m or N."""
        model = self.estimate.model
        c, cd = model.device.row_map @ self.qa, model.device.row_map @ self.qda
        return friction_uncertainty(model, raw_parameters(model, self.estimate.beta), c, cd, observer.reversal_speed)
