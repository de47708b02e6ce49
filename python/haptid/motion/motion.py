"""Motion: the treated signals of a log, zero-phase filtered positions with their central differences, and torques.

In the momentum formulation no acceleration is computed: W is made of momenta, and the parallel filter differentiates
them. Source of the filters: `haptid.motion.treatment`.
"""

from __future__ import annotations

from dataclasses import field, fields, replace
from functools import cached_property, lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid._internal.signals import both_ways
from haptid.errors import LogTimeError, MotionTooShortError, TreatmentError
from haptid.log import Log, OnDisk, as_array
from haptid.log.noise_alone import with_torques_of
from haptid.log.resampling import Spans
from haptid.motion.filters import DIFFERENCES, SECOND_DIFFERENCES, bad_setting
from haptid.motion.streaming import CUBIC, SMOOTH, Delayed, delayed, filtered
from haptid.motion.treatment import Treatment, no_accelerations

# Tail of an impulse response after which a transient counts as over, as a share of the response.
TRANSIENT_LEFT = 1e-3
# Longest delay, as a share of the log: a longer one is almost certainly in another unit.
LONGEST_DELAY = 0.1
# Samples to either side that a central difference requires.
SIDE = len(DIFFERENCES) // 2
# Filters whose positions and differences are kept of a log, and the positions in a log up to which they are.
_FILTERS, _SHARED = 6, 1 << 19


@displayed
@dataclass(frozen=True, eq=False)
class Motion:
    """Treated signals on a uniform grid, with their treatment.

    For a log opened with `open_log`, `q` and `tau` are `haptid.log.OnDisk`.

    Attributes:
        dt: step, s.
        q: filtered positions, at the joints or at the motors as in the log, (n, coordinates), rad or m.
        tau: torques, (n, motors), in the unit of the log's command.
        treatment: settings.
        log: its source; None for a motion computed from formulas.
        t0: time of the first sample, s.
        rates: exact velocities and accelerations where they are known, each like q; None for central differences.

    Motions of one log with the same filtered positions share their central differences.
    """

    dt: float
    q: Array
    tau: Array
    treatment: Treatment
    log: Log | None = None
    t0: float = 0.0
    rates: tuple[Array, Array] | None = field(default=None)
    _shared: dict[Any, Any] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Without what is computed from its positions, which another process computes again."""
        return {**self.__dict__, "_shared": {}}

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
                    raise TreatmentError(
                        f"{name} at sample {first} is {array[first].tolist()}, not finite.",
                        where=(name, first),
                        found=array[first].tolist(),
                    )
        if self.rates is not None:
            rates = tuple(read_only(rate) for rate in self.rates)
            for name, rate in zip(("qd", "qdd"), rates, strict=True):
                expect(name, rate.shape, self.q.shape)
            object.__setattr__(self, "rates", rates)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def name(self) -> str:
        """Name of its rows' source: the SHA-256 of its log, or a name of this object for a motion without one."""
        return self.log.sha256 if self.log else f"motion {id(self):x}"

    @property
    def t(self) -> Array:
        """Sample times, (n,), s."""
        return freeze(self.times(np.arange(len(self))))

    @property
    def qd(self) -> Array:
        """Velocities, (n, coordinates); with central differences the first and last samples repeat their neighbours."""
        start, stop = self._known
        return freeze(self._whole(self.state(start, stop)[1]))

    @property
    def qdd(self) -> Array:
        """Accelerations, (n, coordinates); ends as for `qd`.

        Raises:
            MissingAccelerationError: velocity is by a causal differentiator.
        """
        start, stop = self._known
        return freeze(self._whole(self.kinematics(start, stop)[2]))

    @property
    def _known(self) -> tuple[int, int]:
        """First sample and one past the last for which rates are defined."""
        central = self.rates is None and self.treatment.velocity is None
        return (SIDE, len(self) - SIDE) if central else (0, len(self))

    def _whole(self, rate: Array) -> Array:
        """(n, coordinates) from (coordinates, known), the ends repeated where they are not defined."""
        missing = (len(self) - rate.shape[1]) // 2
        return np.pad(rate, ((0, 0), (missing, missing)), mode="edge").T

    @property
    def usable(self) -> tuple[int, int]:
        """First sample and one past the last that are outside the filters' transients."""
        return self.usable_segments[0][0], self.usable_segments[-1][1]

    @property
    def segments(self) -> Spans:
        """First sample and one past the last of each part without a gap in time."""
        return self.log.segments if self.log else ((0, len(self)),)

    @cached_property
    def usable_segments(self) -> Spans:
        """Of each segment that is longer than the filters' transients, the samples outside these.

        Raises:
            MotionTooShortError: no segment is.
        """
        if self.rates is not None:
            return self.segments
        longest = max(stop - start for start, stop in self.segments)
        before = after = self.treatment.lost_to_delay(self.dt)
        lost_to = "the position filter's ends"
        if self.treatment.velocity is not None:
            before += self.treatment.velocity.memory(self.dt, TRANSIENT_LEFT)
            lost_to = "the differentiator's start"
        else:
            sections = self.treatment.position_filter(self.dt)
            before += SIDE + (0 if sections is None else transient_samples(sections, longest))
            after = before
        usable = tuple((a + before, b - after) for a, b in self.segments if b - a - before - after >= 2)
        if not usable:
            raise too_short(longest * self.dt, (before + after) * self.dt, lost_to, self.treatment.decimation)
        return usable

    def usable_parts(self, most: int) -> Spans:
        """The usable segments, cut off after `most` samples of them: rates of samples beside a gap are not its own."""
        parts, left = [], most
        for start, stop in self.usable_segments:
            stop = min(stop, start + left)
            if stop - start < 2:
                break
            parts.append((start, stop))
            left -= stop - start
        return tuple(parts)

    def times(self, samples: NDArray[np.intp]) -> Array:
        """Times of samples, s."""
        if self.log and len(self.segments) > 1:
            return np.asarray(self.log.t[samples])
        return np.asarray(self.t0 + self.dt * samples, dtype=np.float64)

    def unbroken(self, purpose: str) -> Motion:
        """This motion, if it has no gap in time.

        Raises:
            LogTimeError: it has.
        """
        if len(self.segments) > 1:
            assert self.log is not None
            first = float(self.log.t[self.segments[1][0] - 1])
            raise LogTimeError(
                f"{self.log.path}: {purpose} requires a log without gaps; it has {len(self.segments) - 1}, the first "
                f"at t = {first:.6g} s.",
                where=first,
                found=len(self.segments) - 1,
                limit=0,
                advice="Keep a part without them with `time_range`.",
            )
        return self

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
            MissingAccelerationError: velocity is by a causal differentiator.
        """
        q, qd = self.state(start, stop)
        if self.rates is not None:
            return q, qd, np.ascontiguousarray(self.rates[1][start:stop].T)
        if self.treatment.velocity is not None:
            raise no_accelerations("this call")
        return q, qd, self._differences(start, stop, SECOND_DIFFERENCES, self.dt**2)

    def _differences(self, start: int, stop: int, weights: tuple[float, ...], unit: float) -> Array:
        """Weighted sums of the positions around samples start..stop over a unit, (coordinates, stop - start)."""
        if not isinstance(self.q, OnDisk) and stop - start > SIDE and self.q.size <= _SHARED:
            order = 1 if weights is DIFFERENCES else 2
            if order not in self._shared:
                differences = self._computed(SIDE, len(self) - SIDE, weights, unit)
                self._shared[order] = (self.q, freeze(differences))
            source, differences = self._shared[order]
            if source is self.q:
                return np.array(differences[:, start - SIDE : stop - SIDE], order="C")
        return self._computed(start, stop, weights, unit)

    def _computed(self, start: int, stop: int, weights: tuple[float, ...], unit: float) -> Array:
        """The same, computed from steps between samples: at rest it is exactly zero, and dry friction has no sign."""
        steps = np.diff(self.q[start - SIDE : stop + SIDE].T, axis=1)
        of_steps = np.cumsum(weights[::-1])[:-1] / unit  # backwards, as a convolution takes them; they add up to zero
        result = np.empty((len(steps), stop - start))
        for channel, target in zip(steps, result, strict=True):
            target[:] = np.convolve(channel, of_steps, "valid")
        return result

    def _shown(self) -> Overview:
        settings = [f.name for f in fields(Treatment) if getattr(self.treatment, f.name) != f.default]
        rows = [[name, str(getattr(self.treatment, name))] for name in settings]
        source = "formulas" if self.log is None else self.log.path.name
        title = f"Motion from {source}: {len(self)} samples, {self.dt * len(self):.4g} s, {self.q.shape[1]} positions"
        return Overview(title, ("treatment", "value"), rows)


def transient_samples(sections: Array, longest: int) -> int:
    """Samples after which less than TRANSIENT_LEFT of the two-pass impulse response is left, at most `longest`."""
    return max(_transient_samples(own.tobytes(), longest) for own in sections)


@lru_cache(maxsize=256)
def _transient_samples(one_pass: bytes, longest: int) -> int:
    """The same for the filter of one channel: the bytes of its sections, (sections, 6)."""
    sections, half = np.frombuffer(one_pass).reshape(-1, 6).copy(), 256
    while True:
        impulse = np.zeros(2 * half + 1)
        impulse[half] = 1.0
        response = np.abs(both_ways(sections, impulse[None], 0)[0])[half:]
        reached = int(np.argmax(np.cumsum(response) > (1 - TRANSIENT_LEFT) * response.sum()))
        if reached < half // 2:
            return min(reached, longest)
        if half > longest:
            return longest
        half *= 2


def treat(log: Log, treatment: Treatment | None = None) -> Motion:
    """Zero-phase filter of a log's positions; its torques are kept for the parallel filter.

    Args:
        log: the recording.
        treatment: settings; the default where None.

    Raises:
        TreatmentError: a cut-off is at or above half the sampling rate.
        MotionTooShortError: the log is shorter than the filter's transients.
    """
    treatment = treatment or Treatment()
    dt = float(log.dt)
    sections = treatment.position_filter(dt)
    for name, settings, channels in (
        ("cutoff_hz", treatment.cutoff_hz, log.position.shape[1]),
        ("torque_delay_s", treatment.torque_delay_s, log.torque.shape[1]),
    ):
        if isinstance(settings, tuple) and len(settings) != channels:
            raise bad_setting(name, settings, f"one value, or {channels}: one for each channel")
    n = len(log.t)
    longest = float(np.max(np.abs(treatment.torque_delay_s)))
    if longest > LONGEST_DELAY * n * dt:
        raise bad_setting("torque_delay_s", longest, f"at most a tenth of the log, {LONGEST_DELAY * n * dt:.3g} s")
    if sections is not None and n <= 3 * (2 * sections.shape[1] + 1):
        raise too_short(n * dt, 3 * (2 * sections.shape[1] + 1) * dt, "the position filter")
    q, shared = _positions(log, sections)
    plain = replace(treatment, torque_delay_s=0.0)
    return _timed(Motion(dt, q, log.torque, plain, log, float(log.t[0]), _shared=shared), treatment)


# Of each log in memory, its positions by the filter they have passed, with what is computed from them.
_FILTERED: WeakKeyDictionary[Log, dict[bytes, tuple[Array, dict[Any, Any]]]] = WeakKeyDictionary()


def _positions(log: Log, sections: Array | None) -> tuple[Array, dict[Any, Any]]:
    """Filtered positions of a log, (n, coordinates), and the differences that its motions share.

    The choice of a treatment returns to the same few filters again and again; the last ones are kept.
    """
    if isinstance(log.position, OnDisk) or log.position.size > _SHARED:
        return (log.position if sections is None else filtered(log.position, sections, log.segments)), {}
    kept, key = _FILTERED.setdefault(log, {}), b"" if sections is None else sections.tobytes()
    if key not in kept:
        while len(kept) >= _FILTERS:
            del kept[next(iter(kept))]
        q = log.position if sections is None else filtered(log.position, sections, log.segments)
        kept[key] = (q, {})
    kept[key] = kept.pop(key)  # the last one used
    return kept[key]


def with_delay(motion: Motion, seconds: float | tuple[float, ...]) -> Motion:
    """The motion of a log with another `torque_delay_s`, s; positions are not filtered again.

    Raises:
        MotionTooShortError: as `treat` does.
    """
    assert motion.log is not None
    return _timed(replace(motion, tau=motion.log.torque), replace(motion.treatment, torque_delay_s=seconds))


def _timed(motion: Motion, treatment: Treatment) -> Motion:
    """A motion with the log's own torque, and the delay compensated as a treatment has it."""
    lead = (treatment.position_lead_s - motion.treatment.position_lead_s) / motion.dt
    shift = treatment.torque_shift_s
    shift = tuple(np.divide(shift, motion.dt)) if isinstance(shift, tuple) else shift / motion.dt
    q, shared = _evaluated_later(motion.q, motion._shared, lead)
    tau = shifted(motion.tau, shift, CUBIC)
    timed = replace(motion, q=q, tau=tau, treatment=treatment, _shared=shared)
    timed.usable  # noqa: B018 - raises here if the log is too short for its filter
    return timed


def _evaluated_later(q: Array, shared: dict[Any, Any], lead: float) -> tuple[Array, dict[Any, Any]]:
    """Positions evaluated later by some samples, and what motions that have them share; the last ones are kept."""
    if not lead:
        return q, shared
    if isinstance(q, OnDisk) or q.size > _SHARED:
        return shifted(q, -lead, SMOOTH), {}
    source, by, later, own = shared.get("later", (None, 0.0, q, {}))
    if source is not q or by != lead:
        later, own = shifted(q, -lead, SMOOTH), {}
        shared["later"] = (q, lead, later, own)
    return later, own


def with_positions(motion: Motion, position: Array) -> Motion:
    """The motion of a log with other positions in its channels, (n, channels), treated alike; its torque stays."""
    assert motion.log is not None
    log = with_torques_of(replace(motion.log, position=position), motion.log)
    q, shared = _positions(log, motion.treatment.position_filter(motion.dt))
    q, shared = _evaluated_later(q, shared, motion.treatment.position_lead_s / motion.dt)
    return replace(motion, q=q, log=log, _shared=shared)


def shifted(channels: Array, samples: float | tuple[float, ...], half: int) -> Array:
    """`delayed` channels in memory or on disk; as they are without a shift."""
    if not np.any(samples):
        return channels
    if isinstance(channels, OnDisk):
        return as_array(Delayed(channels, samples, half))
    return delayed(channels, samples, half)


def too_short(seconds: float, needed: float, lost_to: str, decimation: int = 1) -> MotionTooShortError:
    """Error of a motion that is shorter than the transients of its filters."""
    return MotionTooShortError(
        f"the motion lasts {seconds:.3g} s, and {lost_to} alone take {needed:.3g} s.",
        found=seconds,
        limit=needed,
        advice="Record a longer motion, or raise the cut-off"
        + (f", or reduce the decimation of {decimation}." if decimation > 1 else "."),
    )
