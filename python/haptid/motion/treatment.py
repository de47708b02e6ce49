"""Settings of the treatment of a log: position filter, parallel filter, rows that are dropped, and the torque's delay.

Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III: position
through a zero-phase Butterworth filter, rates by central differences, and the *same* low-pass and decimation on the
torque and on every column of the observation matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np

from haptid._internal.arrays import Array, freeze, positive, whole
from haptid._internal.display import tabulated
from haptid._internal.late import dataclass
from haptid._internal.signals import butterworth
from haptid.errors import MissingAccelerationError
from haptid.motion.filters import (
    LOWEST,
    Causal,
    HighPass,
    KaiserSmoother,
    ParallelFilter,
    Shape,
    bad_setting,
    centred,
    high_cutoff,
)
from haptid.motion.streaming import CUBIC, SMOOTH, lost


@tabulated
@dataclass(frozen=True)
class Treatment:
    """Settings by which a log becomes a motion and its rows.

    Attributes:
        cutoff_hz: -3 dB frequency of the position filter, both passes counted, Hz: one for all position channels, or
            one for each; None for no filter.
        order: order of one pass of the Butterworth filter.
        decimation: samples from one row to the next.
        parallel_cutoff_hz: -3 dB frequency of the parallel filter of torque and columns, Hz; None is a share of the
            decimated Nyquist frequency, and no filter where `decimation` is 1.
        parallel_shape: of that filter: `KaiserSmoother()`, `WindowedSinc()` as in published methods, or `Causal()`.
        reversal_speed: a motor's row is dropped where a coordinate with Coulomb friction is slower than this anywhere
            within `reversal_guard_s` of the row, rad/s or m/s; one value, or one for each row of torque.
        reversal_guard_s: s; None is the length of the parallel filter without its negligible ends.
        rest_speed: a motor's row is dropped too where a coordinate with Coulomb friction rests there: in `rest_s` it
            moves less than at this mean speed, rad/s or m/s; one value, or one for each row of torque, 0 for none.
        rest_s: s.
        block_s: length of a time block, s.
        torque_delay_s: the acting torque is the log's of so much earlier, s: half a sampling period for a command that
            is constant from its sample to the next (zero-order hold). One value, or one for each torque channel.
        formulation: "acceleration", by differences of the positions, or "momentum": no accelerations, the parallel
            filter differentiates momenta.
        velocity: a causal differentiator of the unfiltered positions; None is central differences.
    """

    cutoff_hz: float | tuple[float, ...] | None = 40.0
    order: int = 4
    decimation: int = 1
    parallel_cutoff_hz: float | None = None
    reversal_speed: float | tuple[float, ...] = 0.0
    reversal_guard_s: float | None = None
    block_s: float = 1.0
    torque_delay_s: float | tuple[float, ...] = 0.0
    parallel_shape: Shape | Causal = field(default_factory=KaiserSmoother)
    formulation: Literal["acceleration", "momentum"] = "acceleration"
    velocity: HighPass | None = None
    rest_speed: float | tuple[float, ...] = 0.0
    rest_s: float = 0.25

    def __post_init__(self) -> None:
        for name in ("reversal_speed", "rest_speed", "cutoff_hz", "torque_delay_s"):
            if isinstance(value := getattr(self, name), (list, tuple)):
                object.__setattr__(self, name, tuple(float(v) for v in value))
        if self.cutoff_hz is not None:
            cutoffs = self.cutoff_hz if isinstance(self.cutoff_hz, tuple) else (self.cutoff_hz,)
            self._expect(
                "cutoff_hz", lambda _: bool(cutoffs) and all(map(positive, cutoffs)), "finite numbers above zero"
            )
        if self.parallel_cutoff_hz is not None:
            self._expect("parallel_cutoff_hz", positive, "a finite number above zero")
        if self.reversal_guard_s is not None:
            self._expect("reversal_guard_s", lambda v: v == 0 or positive(v), "a finite time, 0 or more")
        self._expect("block_s", positive, "a finite number above zero")
        shapes = "KaiserSmoother(), WindowedSinc() or Causal()"
        self._expect("parallel_shape", lambda v: isinstance(v, Shape | Causal), shapes)
        delays = self.torque_delay_s if isinstance(self.torque_delay_s, tuple) else (self.torque_delay_s,)
        self._expect("torque_delay_s", lambda _: bool(delays) and all(map(_finite, delays)), "finite times, s")
        self._expect("order", lambda v: whole(v) and 1 <= v <= 12, "a whole number from 1 to 12")
        self._expect("decimation", lambda v: whole(v) and v >= 1, "a whole number, 1 or more")
        self._expect("rest_s", positive, "a finite time above zero")
        for name in ("reversal_speed", "rest_speed"):
            values = v if isinstance(v := getattr(self, name), tuple) else (v,)
            if not values or not all(v == 0 or positive(v) for v in values):
                raise bad_setting(name, getattr(self, name), "finite speeds, 0 or more")
        self._expect("formulation", lambda v: v in ("acceleration", "momentum"), '"acceleration" or "momentum"')
        self._expect("velocity", lambda v: v is None or isinstance(v, HighPass), "None or a HighPass")
        self._check_together()

    def _check_together(self) -> None:
        """Refuse combinations of settings that contradict each other."""
        if self.velocity is not None:
            if not self.momentum:
                raise no_accelerations("formulation = 'acceleration'")
            self._expect("cutoff_hz", lambda v: v is None, "None: `velocity` takes positions as they are")

    @property
    def momentum(self) -> bool:
        """Whether rows are in the momentum formulation, without accelerations."""
        return self.formulation == "momentum"

    def _expect(self, name: str, fits: Callable[[Any], bool], wanted: str) -> None:
        value = getattr(self, name)
        if not fits(value):
            raise bad_setting(name, value, wanted)

    def position_filter(self, dt: float) -> Array | None:
        """Second-order sections of one pass, (1 or channels, sections, 6); None for no filter.

        Two passes together are -3 dB at `cutoff_hz`.
        """
        if self.cutoff_hz is None:
            return None
        return np.stack([self._one_pass(float(cutoff), dt) for cutoff in np.atleast_1d(self.cutoff_hz)])

    def _one_pass(self, cutoff_hz: float, dt: float) -> Array:
        """Second-order sections of one pass, (sections, 6)."""
        nyquist = 0.5 / dt
        # Two passes of |H|^2 = 1/(1 + x^2n) are -3 dB where x^2n = sqrt(2) - 1; x is in prewarped frequency.
        widening = (np.sqrt(2.0) - 1.0) ** (-0.5 / self.order)
        one_pass = 2 * np.arctan(widening * np.tan(0.5 * np.pi * cutoff_hz / nyquist)) / np.pi
        if cutoff_hz >= nyquist or one_pass > 0.98:
            raise high_cutoff("cutoff_hz", cutoff_hz, nyquist)
        if one_pass < LOWEST:
            raise bad_setting("cutoff_hz", cutoff_hz, f"at least {LOWEST * nyquist:g} Hz at this rate")
        return low_pass(self.order, one_pass)

    @cached_property
    def position_lead_s(self) -> float:
        """The part of `torque_delay_s` by which filtered positions are evaluated later, s: the channels' median.

        Filtered positions are smooth and can be interpolated; the torque jumps at reversals with the sign of the
        velocity as it was sampled, and is shifted only by what channels differ. Unfiltered positions stay as they are.
        """
        return 0.0 if self.cutoff_hz is None else float(np.median(self.torque_delay_s))

    @cached_property
    def torque_shift_s(self) -> float | tuple[float, ...]:
        """The rest of `torque_delay_s`, by which the torque itself is shifted to later samples, s."""
        lead = self.position_lead_s
        if isinstance(self.torque_delay_s, tuple):
            return tuple(delay - lead for delay in self.torque_delay_s)
        return self.torque_delay_s - lead

    def lost_to_delay(self, dt: float) -> int:
        """Samples at each end that the compensation of the delay leaves without neighbours to interpolate between."""
        return max(lost(self.position_lead_s / dt, SMOOTH), lost(tuple(np.atleast_1d(self.torque_shift_s) / dt), CUBIC))

    def parallel(self, dt: float) -> float | None:
        """Cut-off of the parallel filter, Hz; None where there is none."""
        if self.parallel_cutoff_hz is None:
            return None if self.decimation == 1 else self.parallel_shape.share * 0.5 / dt / self.decimation
        limit = 0.5 / dt / self.decimation
        if self.parallel_cutoff_hz >= limit:
            raise high_cutoff("parallel_cutoff_hz", self.parallel_cutoff_hz, limit, self.decimation)
        return self.parallel_cutoff_hz

    def reach(self, dt: float) -> float:
        """Approximate half length of the parallel filter in samples, without designing it."""
        cutoff = self.parallel(dt)
        return 0.0 if cutoff is None else self.parallel_shape.reach(cutoff * dt, self.decimation)

    def parallel_filter(self, dt: float) -> ParallelFilter:
        """The parallel filter of torque and columns, of one sample where there is none.

        Raises:
            TreatmentError: its cut-off is too high for the sampling rate or the decimation.
        """
        cutoff = self.parallel(dt)
        if cutoff is None:
            return centred(np.ones(1), dt, self.momentum)
        if isinstance(self.parallel_shape, Causal):
            return self.parallel_shape.filter(cutoff, dt, self.momentum)
        return centred(self.parallel_shape.taps(cutoff * dt, self.decimation), dt, self.momentum)

    def taps(self, dt: float) -> Array:
        """Taps of the parallel filter, oldest sample first, (odd,), unit sum; [1] where there is none."""
        return self.parallel_filter(dt).taps


@lru_cache(maxsize=8)
def low_pass(order: int, cutoff: float) -> Array:
    """Second-order sections of a Butterworth low-pass, (sections, 6); cut-off as a share of half the sampling rate."""
    return freeze(butterworth(order, cutoff))


def _finite(value: Any) -> bool:
    """Whether a value is a finite number."""
    return (whole(value) or isinstance(value, float)) and abs(value) < np.inf


def no_accelerations(purpose: str) -> MissingAccelerationError:
    """Error of accelerations that a causal differentiator does not provide."""
    return MissingAccelerationError(
        f"{purpose} requires accelerations, and `velocity` by a high-pass provides none.",
        where="velocity",
        advice="Choose formulation = 'momentum', or leave `velocity` out.",
    )
