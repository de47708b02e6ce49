"""The force of the hand in real time: the generalised-momentum observer.

Source: De Luca and Mattone (2005), IEEE ICRA, eqs (10) to (14).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from haptid._values import Array, expect, read_only
from haptid.device import Device
from haptid.dynamics import core_torque, momentum, raw_parameters, rigid
from haptid.errors import ForceSettingError
from haptid.estimators import Estimate
from haptid.force import (
    REVERSAL_SPEED,
    UNVALIDATED,
    WORST_CONDITION,
    HandleForce,
    Torques,
    check_settings,
    handle_force,
    noise_of,
    spread,
    spread_columns,
)
from haptid.kinematics import handle_of
from haptid.reversals import doubt, softened
from haptid.signals import coordinate_torque, coordinates, external
from haptid.treatment import Motion, positive
from haptid.validation import Validation


@dataclass(frozen=True, eq=False)
class Watched:
    """What the observer knows after some samples, and all it needs for the next ones.

    Attributes:
        torque: external torque on every torque row after each sample, (rows, samples), N m or N.
        p: momentum at the last sample, (rows,).
        pushed: what moves the momentum beside the hand at the last sample: tau + C' cd - g - friction, (rows,).
    """

    torque: Array
    p: Array
    pushed: Array

    def __post_init__(self) -> None:
        for name in ("torque", "p", "pushed"):
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
        device: Device,
        beta: ArrayLike,
        dt: float,
        qa: ArrayLike,
        qda: ArrayLike,
        tau: ArrayLike,
        before: Watched | None = None,
    ) -> Watched:
        """Watch some more samples, one or many.

        Args:
            device: the mechanism.
            beta: its base parameters, (p,), SI.
            dt: step, s.
            qa: positions of the active joints, (active, samples), rad or m.
            qda: their velocities.
            tau: motors' torque on every torque row, (rows, samples), N m or N.
            before: what was known before the first sample; None where watching begins there, with no push.

        Raises:
            ShapeError: an array does not fit the device.
            ForceSettingError: a step that is not a time.
        """
        if not positive(dt):
            raise ForceSettingError("dt", dt, "a finite time above zero, s")
        shape = (len(device.active), np.shape(qa)[-1] if np.ndim(qa) else 0)
        for name, array in (("qa", qa), ("qda", qda), ("tau", tau)):
            expect(name, np.shape(array), shape)
        c, cd = (device.frame @ np.asarray(x, dtype=float) for x in (qa, qda))
        p, pushed = self._balance(device, raw_parameters(device, beta), c, cd)
        pushed = pushed + np.asarray(tau, dtype=float)
        if before is None:
            before = Watched(np.zeros((len(c), 1)), p[:, 0], pushed[:, 0])
            fresh = self._low_pass(dt, p[:, 1:], pushed[:, 1:], before)
            return Watched(np.column_stack([before.torque, fresh]), p[:, -1], pushed[:, -1])
        return Watched(self._low_pass(dt, p, pushed, before), p[:, -1], pushed[:, -1])

    def smooth(self, signals: Array, dt: float) -> Array:
        """The observer's own low-pass of other signals, from rest, (channels, samples): what to compare it with."""
        keep = float(np.exp(-self.gain * dt))
        return np.asarray(signal.lfilter([1 - keep], [1, -keep], signals, axis=1))

    def _balance(self, device: Device, chi: Array, c: Array, cd: Array) -> tuple[Array, Array]:
        """Momentum, and all that moves it beside motors and hand, each (rows, samples)."""
        soft, bodies, still = softened(device, self.reversal_speed), rigid(device, chi), np.zeros_like(c)
        p, turned = momentum(device, bodies, c, cd)
        own = external(device, c, cd, still)
        gravity = core_torque(device, bodies, c, still, still)
        terms = core_torque(soft, chi - bodies, c, cd, still, own)
        return p, turned - gravity - terms

    def _low_pass(self, dt: float, p: Array, pushed: Array, before: Watched) -> Array:
        """External torque after each sample, (rows, samples)."""
        keep = float(np.exp(-self.gain * dt))
        change = np.diff(p, axis=1, prepend=before.p[:, None]) / dt
        explained = np.column_stack([before.pushed, pushed])
        hand = change - 0.5 * (explained[:, 1:] + explained[:, :-1])
        made, _ = signal.lfilter([1 - keep], [1, -keep], hand, axis=1, zi=keep * before.torque[:, -1:])
        return np.asarray(made)


def observe_force(
    estimate: Estimate,
    motion: Motion,
    observer: MomentumObserver | None = None,
    *,
    validation: Validation | None = None,
    worst_condition: float = WORST_CONDITION,
) -> HandleForce:
    """Force of the hand on the device along a motion, as the observer would have followed it.

    One row for each sample of the motion that has rates. The moment is taken as zero or, with six measured torque rows
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
    """
    observer = observer or MomentumObserver()
    handle_of(estimate.device)
    check_settings(observer.reversal_speed, worst_condition)
    notes = () if validation is not None else (UNVALIDATED,)
    torques = _watched(estimate, motion, observer)
    return handle_force(estimate, torques, noise_of(estimate, validation), worst_condition, notes)


def _watched(estimate: Estimate, motion: Motion, observer: MomentumObserver) -> Torques:
    """Torques of all samples as the observer follows them; it is linear in parameters and torques together."""
    device, (low, high) = estimate.device, motion.usable
    c, cd, _ = coordinates(device, motion, low, high)
    tau, to_joints = coordinate_torque(device, motion, low, high), np.linalg.inv(device.frame)
    qa, qda = to_joints @ c, to_joints @ cd
    rows = [k for k, known in enumerate(device.measured) if known]

    def seen(beta: Array, torque: Array) -> Array:
        return observer.follow(device, beta, motion.dt, qa, qda, torque).torque[rows]

    speed, none = observer.reversal_speed, np.zeros_like(tau)
    sizes = doubt(device, raw_parameters(device, estimate.beta), cd, speed)[rows]
    parts = (seen(column, none) for column in spread_columns(estimate).T)
    return Torques(
        t=np.asarray(motion.t0 + motion.dt * np.arange(low, high), dtype=np.float64),
        qa=qa[:, :1] + observer.smooth(qa - qa[:, :1], motion.dt),  # as late as the torque
        motors=-seen(np.zeros_like(estimate.beta), tau),
        external=seen(estimate.beta, tau),
        covariance=spread(parts, observer.smooth(sizes, motion.dt)),
        moment=np.zeros((0, high - low)),
    )
