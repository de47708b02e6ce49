"""From a log to a motion: zero-phase low-pass, central differences, and the filter that torque and W will share.

Where accelerations are not wanted, W is made of momenta, and the shared filter differentiates those.

Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III: position
through a zero-phase Butterworth filter, rates by central differences, and the *same* low-pass and decimation on the
torque and on every column of the observation matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from scipy import ndimage, signal

from haptid._internal.arrays import Array, expect, freeze, positive, read_only, whole
from haptid.errors import CutoffError, MotionTooShortError, NoAccelerationError, TreatmentValueError
from haptid.log import Log, OnDisk, as_array
from haptid.motion.causal import Causal, HighPass
from haptid.motion.parallel_filter import DIFFERENCES, SECOND_DIFFERENCES, ParallelFilter, centred
from haptid.motion.shapes import KaiserSmoother, Shape
from haptid.motion.streaming import Late, filtered
from haptid.motion.time_shift import delayed, lost

# The impulse response of a filter is taken to have died out where what is left of it weighs less than this.
SETTLED = 1e-3
# Samples to either side that a central difference needs.
SIDE = len(DIFFERENCES) // 2
# Below this share of half the sampling rate a Butterworth filter of high order drowns in rounding.
LOWEST = 1e-5


@dataclass(frozen=True)
class Treatment:
    """How a log becomes a motion and its rows.

    Attributes:
        cutoff_hz: the position filter's gain is -3 dB here, both passes counted, Hz; None leaves positions as they are.
        order: order of one pass of the Butterworth filter.
        decimation: one row is kept of so many samples.
        parallel_cutoff_hz: -3 dB of the filter that torque and columns share, Hz; None is a share of what decimation
            can carry, and no filter at all where `decimation` is 1.
        parallel_shape: of that filter: `KaiserSmoother()`, `WindowedSinc()` as published recipes have it, or `Causal()`.
        reversal_speed: a motor's row is dropped where a coordinate with Coulomb friction moves slower than this anywhere
            within `guard` of the row, rad/s or m/s; one figure, or one for each row of torque.
        guard: s; None is all that the parallel filter reaches but what hardly weighs.
        block: length of a time block, s.
        torque_delay_s: the torque that acts is the log's of so much earlier, s: half a sampling period for a command
            that is held from its sample to the next.
        accelerations: "differences" of the positions, or "momentum": none, the shared filter differentiates momenta.
        velocity: a causal differentiator of the positions as they are; None is central differences.
    """

    cutoff_hz: float | None = 40.0
    order: int = 4
    decimation: int = 1
    parallel_cutoff_hz: float | None = None
    reversal_speed: float | tuple[float, ...] = 0.0
    guard: float | None = None
    block: float = 1.0
    torque_delay_s: float = 0.0
    parallel_shape: Shape | Causal = field(default_factory=KaiserSmoother)
    accelerations: Literal["differences", "momentum"] = "differences"
    velocity: HighPass | None = None

    def __post_init__(self) -> None:
        if isinstance(self.reversal_speed, (list, tuple)):
            object.__setattr__(self, "reversal_speed", tuple(float(v) for v in self.reversal_speed))
        for name in ("cutoff_hz", "parallel_cutoff_hz"):
            if getattr(self, name) is not None:
                self._expect(name, positive, "a finite number above zero")
        if self.guard is not None:
            self._expect("guard", lambda v: v == 0 or positive(v), "a finite time, 0 or more")
        self._expect("block", positive, "a finite number above zero")
        self._expect("parallel_shape", lambda v: isinstance(v, Shape | Causal), "Bell(), Sharp() or Causal()")
        self._expect("torque_delay_s", finite, "a finite time, s")
        self._expect("order", lambda v: whole(v) and 1 <= v <= 12, "a whole number from 1 to 12")
        self._expect("decimation", lambda v: whole(v) and v >= 1, "a whole number, 1 or more")
        many = self.reversal_speed if isinstance(self.reversal_speed, tuple) else (self.reversal_speed,)
        if not many or not all(v == 0 or positive(v) for v in many):
            raise TreatmentValueError("reversal_speed", self.reversal_speed, "finite speeds, 0 or more")
        self._expect("accelerations", lambda v: v in ("differences", "momentum"), '"differences" or "momentum"')
        self._expect("velocity", lambda v: v is None or isinstance(v, HighPass), "None or a HighPass")
        self._check_together()

    def _check_together(self) -> None:
        """Settings that mean nothing beside one another."""
        if self.velocity is not None:
            if not self.momentum:
                raise NoAccelerationError("accelerations = 'differences'")
            self._expect("cutoff_hz", lambda v: v is None, "None: `velocity` takes positions as they are")

    @property
    def momentum(self) -> bool:
        """Whether rows are made without accelerations."""
        return self.accelerations == "momentum"

    def _expect(self, name: str, fits: Callable[[Any], bool], wanted: str) -> None:
        value = getattr(self, name)
        if not fits(value):
            raise TreatmentValueError(name, value, wanted)

    def position_filter(self, dt: float) -> Array | None:
        """Second-order sections of one pass, such that two passes together have -3 dB at `cutoff_hz`; None for none."""
        if self.cutoff_hz is None:
            return None
        nyquist = 0.5 / dt
        # Two passes of |H|^2 = 1/(1 + x^2n) are -3 dB where x^2n = sqrt(2) - 1; x is in prewarped frequency.
        stretch = (np.sqrt(2.0) - 1.0) ** (-0.5 / self.order)
        one_pass = 2 * np.arctan(stretch * np.tan(0.5 * np.pi * self.cutoff_hz / nyquist)) / np.pi
        if self.cutoff_hz >= nyquist or one_pass > 0.98:
            raise CutoffError("cutoff_hz", self.cutoff_hz, nyquist)
        if one_pass < LOWEST:
            raise TreatmentValueError("cutoff_hz", self.cutoff_hz, f"at least {LOWEST * nyquist:g} Hz at this rate")
        return low_pass(self.order, one_pass).copy()  # SciPy's filters want sections that could be written to

    def parallel(self, dt: float) -> float | None:
        """Cut-off of the filter that torque and columns share, Hz; None where there is none."""
        if self.parallel_cutoff_hz is None:
            return None if self.decimation == 1 else self.parallel_shape.share * 0.5 / dt / self.decimation
        limit = 0.5 / dt / self.decimation
        if self.parallel_cutoff_hz >= limit:
            raise CutoffError("parallel_cutoff_hz", self.parallel_cutoff_hz, limit)
        return self.parallel_cutoff_hz

    def reach(self, dt: float) -> float:
        """Half the samples under that filter, about; known without making it."""
        cutoff = self.parallel(dt)
        return 0.0 if cutoff is None else self.parallel_shape.reach(cutoff * dt, self.decimation)

    def parallel_filter(self, dt: float) -> ParallelFilter:
        """The filter that torque and columns share, of one sample where there is none.

        Raises:
            CutoffError: the sampling rate, or the decimation, cannot carry its cut-off.
        """
        cutoff = self.parallel(dt)
        if cutoff is None:
            return centred(np.ones(1), dt, self.momentum)
        if isinstance(self.parallel_shape, Causal):
            return self.parallel_shape.filter(cutoff, dt, self.momentum)
        return centred(self.parallel_shape.taps(cutoff * dt, self.decimation), dt, self.momentum)

    def taps(self, dt: float) -> Array:
        """Weights of that filter, oldest sample first, (odd,), unit sum; [1] where there is none."""
        return self.parallel_filter(dt).taps


@lru_cache(maxsize=8)
def low_pass(order: int, cutoff: float) -> Array:
    """Second-order sections of a Butterworth filter, (sections, 6); cut-off as a share of half the sampling rate."""
    return freeze(np.asarray(signal.butter(order, cutoff, output="sos")))


def finite(value: Any) -> bool:
    """A finite number."""
    return (whole(value) or isinstance(value, float)) and abs(value) < np.inf


@dataclass(frozen=True, eq=False)
class Motion:
    """Treated signals on a uniform grid, and how they were made.

    Of a log that was opened and not read, `q` and `tau` are `haptid.log.OnDisk`.

    Attributes:
        dt: step, s.
        q: positions as the log has them, at the joints or at the motors, (n, coordinates), rad or m.
        tau: torques as the log has them, (n, motors), in the unit of the log's command.
        treatment: how it was treated.
        log: the log it came from; None for a motion made from formulas.
        t0: time of the first sample, s.
        rates: exact velocities and accelerations where they are known, each like q; None for central differences.
    """

    dt: float
    q: Array
    tau: Array
    treatment: Treatment
    log: Log | None = None
    t0: float = 0.0
    rates: tuple[Array, Array] | None = field(default=None)

    def __post_init__(self) -> None:
        for name in ("q", "tau"):
            if not isinstance(getattr(self, name), OnDisk):
                object.__setattr__(self, name, read_only(getattr(self, name)))
        expect("q", self.q.shape, (None, None))
        expect("tau", self.tau.shape, (len(self.q), None))
        if self.log is None:  # a log has been checked
            for name, array in (("q", self.q), ("tau", self.tau)):
                if not np.isfinite(array).all():
                    first = int(np.argmin(np.isfinite(array).all(axis=1)))
                    raise TreatmentValueError(f"{name} at sample {first}", array[first].tolist(), "finite numbers")
        if self.rates is not None:
            rates = tuple(read_only(rate) for rate in self.rates)
            for name, rate in zip(("qd", "qdd"), rates, strict=True):
                expect(name, rate.shape, self.q.shape)
            object.__setattr__(self, "rates", rates)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def t(self) -> Array:
        """Sample times, (n,), s."""
        return freeze(np.asarray(self.t0 + self.dt * np.arange(len(self)), dtype=np.float64))

    @property
    def qd(self) -> Array:
        """Velocities, (n, coordinates); by central differences the first and last samples repeat their neighbours."""
        start, stop = self._known
        return freeze(self._whole(self.state(start, stop)[1]))

    @property
    def qdd(self) -> Array:
        """Accelerations, (n, coordinates); as for `qd` at the ends.

        Raises:
            NoAccelerationError: velocity is by a causal differentiator.
        """
        start, stop = self._known
        return freeze(self._whole(self.kinematics(start, stop)[2]))

    @property
    def _known(self) -> tuple[int, int]:
        """First sample and one past the last that have rates at all."""
        central = self.rates is None and self.treatment.velocity is None
        return (SIDE, len(self) - SIDE) if central else (0, len(self))

    def _whole(self, rate: Array) -> Array:
        """(n, coordinates) of (coordinates, known), the ends repeated where they are not known."""
        missing = (len(self) - rate.shape[1]) // 2
        return np.pad(rate, ((0, 0), (missing, missing)), mode="edge").T

    @cached_property
    def usable(self) -> tuple[int, int]:
        """First sample and one past the last whose rates are good: the ends, where the filters settle, are dropped."""
        if self.rates is not None:
            return 0, len(self)
        shifted = lost(self.treatment.torque_delay_s / self.dt)
        if self.treatment.velocity is not None:
            start = shifted + self.treatment.velocity.memory(self.dt, SETTLED)
            if len(self) - start - shifted < 2:
                raise MotionTooShortError(len(self) * self.dt, start * self.dt, "the differentiator's start")
            return start, len(self) - shifted
        sections = self.treatment.position_filter(self.dt)
        edge = shifted + SIDE + (0 if sections is None else settling(sections, len(self)))
        if len(self) - 2 * edge < 2:
            raise MotionTooShortError(len(self) * self.dt, 2 * edge * self.dt, "the position filter's ends")
        return edge, len(self) - edge

    def state(self, start: int, stop: int) -> tuple[Array, Array]:
        """Positions and velocities of samples start..stop, each (coordinates, stop - start)."""
        if self.rates is not None:
            return np.ascontiguousarray(self.q[start:stop].T), np.ascontiguousarray(self.rates[0][start:stop].T)
        if self.treatment.velocity is not None:
            begin = max(0, start - self.treatment.velocity.memory(self.dt))
            wide = np.ascontiguousarray(self.q[begin:stop].T)
            qd = self.treatment.velocity.velocity(wide, self.dt)
            return np.ascontiguousarray(wide[:, start - begin :]), np.ascontiguousarray(qd[:, start - begin :])
        return np.ascontiguousarray(self.q[start:stop].T), self._differences(start, stop, DIFFERENCES, self.dt)

    def kinematics(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations of samples start..stop, each (coordinates, stop - start).

        Raises:
            NoAccelerationError: velocity is by a causal differentiator.
        """
        q, qd = self.state(start, stop)
        if self.rates is not None:
            return q, qd, np.ascontiguousarray(self.rates[1][start:stop].T)
        if self.treatment.velocity is not None:
            raise NoAccelerationError("this call")
        return q, qd, self._differences(start, stop, SECOND_DIFFERENCES, self.dt**2)

    def _differences(self, start: int, stop: int, weights: tuple[float, ...], unit: float) -> Array:
        """Weighted sums of the positions about samples start..stop, in a unit, (coordinates, stop - start)."""
        wide = self.q[start - SIDE : stop + SIDE].T
        made = np.empty((len(wide), stop - start))
        for channel, out in zip(wide, made, strict=True):
            np.divide(ndimage.correlate1d(channel, weights)[SIDE:-SIDE], unit, out=out)
        return made


def settling(sections: Array, longest: int) -> int:
    """Samples after which the two-pass impulse response weighs less than SETTLED of the whole, at most `longest`."""
    half = 256
    while True:
        impulse = np.zeros(2 * half + 1)
        impulse[half] = 1.0
        response = np.abs(signal.sosfiltfilt(sections, impulse, padlen=0))[half:]
        settled = int(np.argmax(np.cumsum(response) > (1 - SETTLED) * response.sum()))
        if settled < half // 2:
            return min(settled, longest)
        if half > longest:
            return longest
        half *= 2


def treat(log: Log, treatment: Treatment | None = None) -> Motion:
    """Filter a log's positions without delay, and keep its torques for the parallel filter.

    Args:
        log: what was recorded.
        treatment: how; the default where None.

    Raises:
        CutoffError: a cut-off at or above what the sampling rate can carry.
        MotionTooShortError: the log is shorter than the filter's own ends.
    """
    treatment = treatment or Treatment()
    dt = float(log.dt)
    sections = treatment.position_filter(dt)
    n = len(log.t)
    if sections is not None and n <= 3 * (2 * len(sections) + 1):
        raise MotionTooShortError(n * dt, 3 * (2 * len(sections) + 1) * dt, "the position filter")
    q = log.position if sections is None else filtered(log.position, sections)
    motion = Motion(dt, q, log.torque, treatment, log, float(log.t[0]))
    return with_delay(motion, treatment.torque_delay_s)


def with_delay(motion: Motion, seconds: float) -> Motion:
    """The motion of a log as if its treatment had this `torque_delay_s`; positions are not filtered again.

    Raises:
        MotionTooShortError: as `treat` does.
    """
    assert motion.log is not None
    torque, treatment = motion.log.torque, replace(motion.treatment, torque_delay_s=seconds)
    tau = torque if seconds == 0 else _late(torque, seconds / motion.dt)
    made = replace(motion, tau=tau, treatment=treatment)
    made.usable  # noqa: B018 - a log too short for its filter is an error here, not later
    return made


def _late(channels: Array, samples: float) -> Array:
    """Each channel so many samples later, (n, channels)."""
    return as_array(Late(channels, samples)) if isinstance(channels, OnDisk) else delayed(channels, samples)
