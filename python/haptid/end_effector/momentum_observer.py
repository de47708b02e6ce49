"""The force of the hand in real time: the generalised-momentum observer.

Source: De Luca and Mattone (2005), IEEE ICRA, eqs (10) to (14).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from haptid._internal.arrays import Array, expect, positive, read_only
from haptid.dynamics.inverse import core_torque, momentum, raw_parameters, rigid
from haptid.dynamics.kinematics import handle_of
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.dynamics.wrench import Lever
from haptid.end_effector.force import (
    REVERSAL_SPEED,
    WORST_CONDITION,
    HandleForce,
    Told,
    check_finite,
    check_settings,
    handle_force,
    lever_of,
    noise_of,
    noted,
    spread_columns,
)
from haptid.errors import ForceSettingError
from haptid.estimation import Estimate
from haptid.estimation.feasibility.feasible import checked
from haptid.motion.channels import coordinate_torque, state
from haptid.motion.treatment import Motion
from haptid.observation.reversals import doubt, softened
from haptid.validation.validation import Validation

# After so many times 1 / gain what a pose near a singular one left in the low-pass is forgotten: 0.7 %.
FORGOTTEN = 5.0
# Samples handed to the core at a time.
STRETCH = 1 << 14


@dataclass(frozen=True, eq=False)
class ObserverResult:
    """What the observer knows after some samples, and all it needs for the next ones.

    Attributes:
        torque: external torque on every torque row after each sample, (rows, samples), N m or N.
        mean: of the external torque over the step that ends at each sample, before the low-pass, (rows, samples).
        p: momentum at the last sample, (rows,).
        pushed: what moves the momentum beside the hand at the last sample: tau + C' cd - g - friction, (rows,).
    """

    torque: Array
    mean: Array
    p: Array
    pushed: Array

    def __post_init__(self) -> None:
        for name in ("torque", "mean", "p", "pushed"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclass(frozen=True)
class MomentumObserver:
    """r = K (p - integral of (tau + C' cd - g - friction + r)): follows the torque of the hand, r = K / (s + K) of it.

    It needs no acceleration, and no more of the past than one sample. Over one step the momentum changes by the mean
    torque; what motors, gravity, friction and the velocity product leave unexplained is the mean external torque, and
    that passes the low-pass as a held signal: exact for any gain and step, without integrals that drift.

    Attributes:
        gain: K, rad/s. A constant push is seen in full; a step to 63 % after 1 / K.
        reversal_speed: below it the sign of a velocity is smoothed, rad/s or m/s.
    """

    gain: float = 40.0
    reversal_speed: float = REVERSAL_SPEED

    def __post_init__(self) -> None:
        if not positive(self.gain):
            raise ForceSettingError("gain", self.gain, "a finite number above zero, rad/s")
        check_settings(self.reversal_speed, WORST_CONDITION)

    @property
    def bandwidth_hz(self) -> float:
        """Frequency at which a push is seen 3 dB too small, K / 2 pi, Hz."""
        return self.gain / (2 * np.pi)

    @property
    def delay(self) -> float:
        """By which slow pushes are seen late, 1 / K, s; the sampling adds half a step."""
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
            model: the dynamic model.
            beta: its base parameters, (p,), SI.
            dt: step, s.
            qa: positions of the active joints, (active, samples), rad or m.
            qda: their velocities.
            tau: motors' torque on every torque row, (rows, samples), N m or N.
            before: what was known before the first sample; None where watching begins there, with no push.

        Raises:
            ShapeError: an array does not fit the device.
            ForceSettingError: a step that is not a time, no sample, or one that is not a finite number.
            ParameterValueError: a base parameter is not a finite number.
            AccelerationColumnError: a column of the device is made of accelerations.
        """
        if not positive(dt):
            raise ForceSettingError("dt", dt, "a finite time above zero, s")
        shape = (len(model.device.active), np.shape(qa)[-1] if np.ndim(qa) else 0)
        for name, array in (("qa", qa), ("qda", qda), ("tau", tau)):
            expect(name, np.shape(array), shape)
            check_finite(name, array)
        if not shape[1]:
            raise ForceSettingError("number of samples", 0, "one sample or more")
        c, cd = (model.device.row_map @ np.asarray(x, dtype=float) for x in (qa, qda))
        p, pushed = self._balance(model, raw_parameters(model, checked(model, beta)), c, cd)
        pushed = pushed + np.asarray(tau, dtype=float)
        rest = np.zeros((len(c), 1))
        last = before or ObserverResult(rest, rest, p[:, 0], -pushed[:, 0])  # no step leads to the first sample
        explained = np.column_stack([last.pushed, pushed])
        mean = np.diff(p, axis=1, prepend=last.p[:, None]) / dt - 0.5 * (explained[:, 1:] + explained[:, :-1])
        made, _ = signal.lfilter(*self._filter(dt), mean, axis=1, zi=self._keep(dt) * last.torque[:, -1:])
        return ObserverResult(np.asarray(made), mean, p[:, -1], pushed[:, -1])

    def smooth(self, signals: Array, dt: float) -> Array:
        """The observer's own low-pass of other signals, from rest, (channels, samples): what to compare it with.

        Args:
            signals: means over the steps that end at each sample; samples themselves come out half a step early.
            dt: step, s.
        """
        return np.asarray(signal.lfilter(*self._filter(dt), signals, axis=-1))

    def _keep(self, dt: float) -> float:
        """What is left of the past after a step."""
        return float(np.exp(-self.gain * dt))

    def _filter(self, dt: float) -> tuple[list[float], list[float]]:
        """K / (s + K) of a held signal: numerator and denominator."""
        keep = self._keep(dt)
        return [1 - keep], [1, -keep]

    def _balance(self, model: DynamicModel, chi: Array, c: Array, cd: Array) -> tuple[Array, Array]:
        """Momentum, and all that moves it beside motors and hand, each (rows, samples)."""
        soft, bodies, pieces = softened(model, self.reversal_speed), rigid(model, chi), []
        for low in range(0, c.shape[1], STRETCH):
            here, rates = c[:, low : low + STRETCH], cd[:, low : low + STRETCH]
            p, rest = momentum(model, bodies, here, rates)
            own = external(model, here, rates, None)
            terms = core_torque(soft, chi - bodies, here, rates, np.zeros_like(here), own)
            pieces.append((p, -rest - terms))
        p, moved = (np.concatenate(each, axis=1) for each in zip(*pieces, strict=True))
        return p, moved


def observe_force(
    estimate: Estimate,
    motion: Motion,
    observer: MomentumObserver | None = None,
    *,
    validation: Validation | None = None,
    worst_condition: float = WORST_CONDITION,
) -> HandleForce:
    """Force of the hand on the device along a motion, as the observer would have followed it.

    One row for each sample of the motion that has rates, from rest: what pushes at the first sample is seen after some
    1 / gain. The low-pass is of the wrench in the base frame, not of joint torques, whose share in a force changes
    with the pose. The moment is taken as zero or, with six measured torque rows
    or more, estimated.

    Args:
        estimate: the model.
        motion: with torques, while the hand pushes.
        observer: the default one where None.
        validation: on unseen rows without a hand; its residual is the noise of the torque rows, and is right where its
            treatment passes about the observer's bandwidth.
        worst_condition: condition number of the Jacobian beyond which a pose is left out.

    Raises:
        HandleMissingError: the device has no handle.
        ForceSettingError: a setting that means nothing.
        ChannelCountError: the motion has more or fewer channels than the device has coordinates or motors.
        AccelerationColumnError: a column of the device is made of accelerations.
    """
    observer = observer or MomentumObserver()
    handle_of(estimate.model)
    check_settings(observer.reversal_speed, worst_condition)
    path = _Path.of(estimate, motion)
    found = lever_of(estimate, path.middles, noise_of(estimate, validation), False, worst_condition)
    noise = np.square(found.inverse) @ np.square(noise_of(estimate, validation))
    return handle_force(estimate, found, path.told(observer, found, noise.T), noted(validation))


@dataclass(frozen=True, eq=False)
class _Path:
    """What the observer watches: samples of a motion.

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
        model, (low, high) = estimate.model, motion.usable
        c, cd = state(model.device, motion, low, high)
        to_joints, tau = np.linalg.inv(model.device.row_map), coordinate_torque(model.device, motion, low, high)
        t = np.asarray(motion.t0 + motion.dt * np.arange(low, high), dtype=np.float64)
        return _Path(estimate, motion.dt, t, to_joints @ c, to_joints @ cd, tau)

    @property
    def middles(self) -> Array:
        """Positions in the middle of the step that ends at each sample, (active, samples)."""
        return 0.5 * (self.qa + np.column_stack([self.qa[:, :1], self.qa[:, :-1]]))

    def told(self, observer: MomentumObserver, found: Lever, noise: Array) -> Told:
        """The wrench at every step, then through the observer's low-pass, which does not turn with the device."""
        estimate, model, dt = self.estimate, self.estimate.model, self.dt
        rows, none = [k for k, known in enumerate(model.device.measured) if known], np.zeros_like(self.tau)

        def smooth(wrench: Array) -> Array:
            return observer.smooth(np.where(found.usable, wrench, 0.0), dt)

        def seen(beta: Array, torque: Array) -> Array:
            return smooth(found.wrench(observer.follow(model, beta, dt, self.qa, self.qda, torque).mean[rows]))

        variance = noise.copy()
        for column in spread_columns(estimate).T:  # the observer is linear in parameters and torques together
            variance += seen(column, none) ** 2
        sizes = self._doubts(observer)[rows]
        for m, size in enumerate(sizes):
            variance += smooth(np.abs(found.inverse[:, :, m].T) * size) ** 2
        long = min(len(self.t), 1 + round(FORGOTTEN * observer.delay / dt))
        return Told(
            t=self.t,
            external=observer.follow(model, estimate.beta, dt, self.qa, self.qda, self.tau).torque[rows],
            wrench=seen(estimate.beta, self.tau),
            bare=seen(np.zeros_like(estimate.beta), self.tau),
            variance=variance,
            usable=np.convolve(~found.usable, np.ones(long))[: len(self.t)] < 0.5,
            moment=np.zeros((0, len(self.t))),
        )

    def _doubts(self, observer: MomentumObserver) -> Array:
        """What dry friction may be off by, (active, samples), N m or N."""
        model = self.estimate.model
        c, cd = model.device.row_map @ self.qa, model.device.row_map @ self.qda
        return doubt(model, raw_parameters(model, self.estimate.beta), c, cd, observer.reversal_speed)
