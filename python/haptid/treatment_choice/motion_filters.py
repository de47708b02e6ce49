"""Filters that suit the motion of some logs: cut-offs from the spectra of positions, and rows clear of reversals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, MotionTooShortError
from haptid.log import Log
from haptid.log.held_joints import held_joints
from haptid.log.spectrum import Spectrum, spectra, widest
from haptid.motion.channels import state
from haptid.motion.filters import KAISER_REACH
from haptid.motion.motion import treat
from haptid.motion.noise_torques import rows_of_noise
from haptid.motion.treatment import Treatment
from haptid.observation.plan import Plan, rest_samples
from haptid.treatment_choice.corners import corners_cut
from haptid.treatment_choice.feedback import feeds_back

# Usual cut-off of the parallel filter over the motion's bandwidth.
USUAL = 3.0
# Rows per period of the parallel filter's cut-off: aliases are 60 dB down.
ROWS_IN_PERIOD = 8
# Highest cut-offs of the position filter and of the parallel filter, as shares of the sampling rate; the lowest of the
# position filter over the bandwidth; the lowest of the parallel filter as a number of periods in the log.
HIGHEST, HIGHEST_PARALLEL, _LOWEST, _SHORTEST = 0.35, 0.15, 1.2, 10.0
# Highest cut-off of the position filter over that of the parallel filter: it passes that filter's band unchanged.
_WIDEST = 3.0
# Rows for each parameter, at least: a longer parallel filter leaves fewer.
_ROWS_PER_PARAMETER = 4.0
# Share of its root mean square speed below which a coordinate is slow, and the part of the parallel filter's half
# length within which a row must not be near to slow motion.
SLOW, _NEAR = 0.03, 0.3
# Least time for which a joint within the limits of `SLOW` is at rest, s and periods of the bandwidth: in a tenth of a
# period a reversal moves on by four times as much as `SLOW` allows.
_REST, _RESTS = 0.25, 0.1
# Least share of a motor's rows whose filter window is clear of reversals for the others to be dropped; share of slow
# samples, of those not at rest, above which a joint sticks at reversals, twice that of speeds with a normal
# distribution: the sign of its dry friction is wrong for longer than a reversal takes.
_CLEAR, _STICKS = 0.3, 0.05
# Least share of a motor's rows to keep; with fewer, all are kept.
KEPT = 0.1
# Share of rows at rest that is reported.
_MENTIONED = 0.02
# Noise above this share of the acceleration is reported.
_LOUD = 0.1
Given = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class MotionFilters:
    """Filters that suit the motion of some logs.

    Attributes:
        model, logs: device and recordings.
        spectra: of each log's position channels.
        channels: spectrum of each position channel, of the log in which it moves fastest.
        bandwidth: of the motion, Hz.
        dt: sampling period, s.
        top: highest frequency that the channels carry, Hz.
        lowest: least cut-off of the parallel filter, Hz.
        reversal_speed: of each row of torque, SI.
        rest_speed: the same, of rows too whose motor is seldom faster.
        near: whether rows count whose filter window contains a reversal, if not near its middle.
        may_clear: whether enough rows are left without those, and unseen rows are to decide.
        above: bandwidth of what moves besides, and is no motion by the torque, Hz; 0 where there is none.
        position: cut-off of the position filters over the bandwidth, at most.
        held: position channels that hardly move while others do: they tremble faster, and that is no motion.
        shaken: whether `reversal_speed` is that of rotors that the controller shakes.
        cutoffs: position cut-offs found, by the parallel filter's and by `position`; filters that differ from these in
            rows alone share them.
    """

    model: DynamicModel
    logs: tuple[Log, ...]
    spectra: tuple[tuple[Spectrum, ...], ...]
    channels: tuple[Spectrum, ...]
    bandwidth: float
    dt: float
    top: float
    lowest: float
    reversal_speed: tuple[float, ...]
    rest_speed: tuple[float, ...] = ()
    near: bool = True
    may_clear: bool = False
    above: float = 0.0
    position: float = np.inf
    held: tuple[int, ...] = ()
    shaken: bool = False
    cutoffs: dict[tuple[float, float], tuple[float, ...]] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(
        model: DynamicModel, logs: tuple[Log, ...], given: Given, found: tuple[tuple[Spectrum, ...], ...] | None = None
    ) -> MotionFilters:
        """From the spectra of the logs' positions, computed where None."""
        dt, found = max(float(log.dt) for log in logs), found or tuple(spectra(log) for log in logs)
        channels = widest(found)
        held = _held(logs)
        bandwidth = max(spectrum.bandwidth for k, spectrum in enumerate(channels) if k not in held)
        if bandwidth == 0:
            raise IdentifiabilityError(
                "no position moves more than its own noise, so there is no motion to identify from.",
                where=tuple(log.path for log in logs),
                found=0.0,
                advice="Record motion, check the units of the position channels, or identify from static poses.",
            )
        seconds = sum(len(log.t) * float(log.dt) for log in logs)
        rows = max(1, sum(model.device.measured)) * seconds * ROWS_IN_PERIOD
        shortest = _SHORTEST / min(len(log.t) * float(log.dt) for log in logs)
        lowest = max(shortest, _ROWS_PER_PARAMETER * len(model.base) / rows)
        top = min(log.usable_bandwidth_hz or 0.5 / float(log.dt) for log in logs)
        made = MotionFilters(model, logs, found, channels, bandwidth, dt, top, lowest, (), held=held)
        rest, misled = made._slow(made.at(USUAL, {**given, "reversal_speed": 0.0}))
        if any(rest):
            often = made._shares(made.at(USUAL, {}), np.array(rest)) >= KEPT
            made = replace(made, reversal_speed=tuple(np.where(often, rest, 0.0).tolist()), rest_speed=rest)
        return made._clear_of_reversals(given, misled)

    @cached_property
    def _of_noise(self) -> np.ndarray:
        """Whether a row has none of its motor in any log, as its torque shows noise alone, (rows of torque,)."""
        return np.asarray(np.all([rows_of_noise(self.model.device, log) for log in self.logs], axis=0))

    def _clear_of_reversals(self, given: Given, misled: bool) -> MotionFilters:
        """Without windows that contain a reversal where rows mislead there, if enough are left; else with them."""
        if not any(self.reversal_speed):
            return self
        enough = self._leaves_enough(replace(self, near=False).at(USUAL, given))
        return replace(self, near=not (enough and misled), may_clear=enough and not misled)

    def clear(self, treatment: Treatment) -> Treatment:
        """A treatment without windows that contain a reversal where enough rows are left, else with a guard."""
        clear, parallel = replace(treatment, reversal_guard_s=None), treatment.parallel(self.dt)
        if not any(self.reversal_speed) or parallel is None or self._leaves_enough(clear):
            return clear
        return replace(treatment, reversal_guard_s=_guard(parallel))

    def _leaves_enough(self, treatment: Treatment) -> bool:
        """Whether a treatment leaves the rows of every motor that one without windows with a reversal has to leave."""
        judged = np.array(self.model.device.measured) & ~self._of_noise
        return bool(min(self._shares(treatment, np.array(self.reversal_speed))[judged]) >= _CLEAR)

    def faster_than(self, speeds: Array, given: Given) -> MotionFilters:
        """Without windows slower than these anywhere, (rows of torque,), SI, where enough are left; itself for none."""
        wanted = np.maximum(self.reversal_speed or 0.0, [float(f"{speed:.2g}") for speed in speeds])
        made = replace(self, reversal_speed=tuple(wanted.tolist()), near=False, may_clear=False, shaken=True)
        often = made._shares(made.at(USUAL, given), wanted) >= KEPT
        wanted = np.where(often, wanted, self.reversal_speed or 0.0)
        if not np.any(wanted > np.array(self.reversal_speed or 0.0)):
            return self
        return replace(made, reversal_speed=tuple(wanted.tolist()))

    def bulk(self, given: Given) -> MotionFilters:
        """Filters for the bulk of the motion alone; these where there is no other motion."""
        found = tuple(tuple(spectrum.narrowed() for spectrum in own) for own in self.spectra)
        if max(s.bandwidth for s in widest(found)) == 0:
            return self
        return MotionFilters.of(self.model, self.logs, given, found)

    def lowered(self, times: float) -> MotionFilters:
        """With position filters of at most this multiple of the bandwidth."""
        return replace(self, position=times)

    def parallel(self, times: float) -> float:
        """Cut-off of the parallel filter, a multiple of the bandwidth as far as the log allows, Hz."""
        return min(max(times * self.bandwidth, self.lowest), HIGHEST_PARALLEL / self.dt)

    def at(self, times: float, given: Given, all_rows: bool = False) -> Treatment:
        """The treatment with a parallel filter at a multiple of the bandwidth, and the given settings."""
        parallel = given.get("parallel_cutoff_hz") or self.parallel(times)
        decimation = given.get("decimation") or max(1, int(1 / (ROWS_IN_PERIOD * parallel * self.dt)))
        if "decimation" in given and "parallel_cutoff_hz" not in given:
            parallel = min(parallel, Treatment(**given).parallel_shape.share * 0.5 / self.dt / decimation)
        follows: dict[str, Any] = {"parallel_cutoff_hz": parallel, "decimation": decimation}
        if "cutoff_hz" not in given:
            # Two digits more than the differences between cut-offs matter for.
            free = any(self.model.device.free_rows)
            # What a position filter removes is missed in a measured torque, and balances noise. A free joint has no
            # torque: there it only bends the motion, of large angles most.
            follows["cutoff_hz"] = self._position_cutoffs(max(parallel, self.parallel(USUAL)) if free else parallel)
        if "reversal_speed" not in given and not all_rows and any(self.reversal_speed):
            follows["reversal_speed"] = self.reversal_speed
        if all_rows and any(self.rest_speed):
            follows |= {"rest_speed": self.rest_speed, "rest_s": max(_REST, _RESTS / self.bandwidth)}
        if "reversal_guard_s" not in given and not all_rows and self.near:
            follows["reversal_guard_s"] = _guard(parallel)
        return Treatment(**{**follows, **given})

    def _position_cutoffs(self, parallel: float) -> tuple[float, ...]:
        """Cut-off of each position channel's filter, Hz, to the digits that matter."""
        key = (parallel, self.position)
        if key not in self.cutoffs:
            self.cutoffs[key] = self._balanced(parallel)
        return self.cutoffs[key]

    def _balanced(self, parallel: float) -> tuple[float, ...]:
        low = _LOWEST * self.bandwidth
        high = max(min(HIGHEST * 2 * self.top, _WIDEST * parallel), 1.1 * low)
        ceiling = min(0.95 * 0.5 / self.dt, self.position * self.bandwidth)
        found = np.array([own.balanced_cutoff(parallel, low, high) for own in self.channels])
        if (found < parallel).any():
            # Below the parallel filter's cut-off what is removed is missed in the rows.
            wide = np.where(found < parallel, high, found)
            own, less = (Treatment(cutoff_hz=tuple(f), parallel_cutoff_hz=parallel) for f in (wide, found))
            found = np.where(corners_cut(self.logs, own, less), wide, found)
        return tuple(float(f"{cutoff:.3g}") for cutoff in np.minimum(found, ceiling))

    def _slow(self, treatment: Treatment) -> tuple[tuple[float, ...], bool]:
        """The speed of each row below which the sign of its dry friction is uncertain, and whether it is wrong there.

        The first is of all logs, as a treatment is. The second is where joints stick, judged by each log's own speed as
        a slow log sticks no more than a fast one, and where disturbances move the device in a control loop.
        """
        rows = len(self.model.device.row_names)
        if not any(self.model.coulomb_terms(row) for row in range(rows)):
            return (), False
        judged = np.array(self.model.device.measured) & ~self._of_noise
        # Of each velocity: its squares' sum and samples; samples that are slow in their own log, and that are moving.
        squares: dict[tuple[int, int], Array] = {}
        slow: dict[tuple[int, int], Array] = {}
        feeds = False
        for log, found in zip(self.logs, self.spectra, strict=True):
            motion = treat(log, treatment)
            c, cd = state(self.model.device, motion, *motion.usable)
            own = max(spectrum.bandwidth for k, spectrum in enumerate(found) if k not in self.held)
            feeds = feeds or feeds_back(c, motion.tau[slice(*motion.usable)].T, motion.dt, own or self.bandwidth)
            window = max(1, round(max(_REST, _RESTS / (own or self.bandwidth)) / motion.dt))
            for row in range(rows):
                for k, term in enumerate(self.model.coulomb_terms(row)):
                    v = self.model.speed(term, c, cd)
                    squares[row, k] = squares.get((row, k), 0.0) + np.array([v @ v, len(v)])
                    if judged[row]:
                        slow[row, k] = slow.get((row, k), 0.0) + _slow_samples(v, window)
        speeds = np.full(rows, np.inf)
        for (row, _), (total, many) in squares.items():
            speeds[row] = min(speeds[row], SLOW * float(np.sqrt(total / many)))
        sticks = any(bool(few > _STICKS * moving) for few, moving in slow.values())
        return tuple(float(f"{v:.2g}") if np.isfinite(v) else 0.0 for v in speeds), sticks or feeds

    def _shares(self, treatment: Treatment, speeds: Array) -> Array:
        """Share of rows that are kept, of each row of torque."""
        treatment = replace(treatment, reversal_speed=tuple(np.where(np.isfinite(speeds), speeds, 0.0)))
        kept, many = np.zeros(len(speeds)), 0
        for log in self.logs:
            try:
                plan = Plan.of(self.model, treat(log, treatment))
            except MotionTooShortError:
                continue
            for start, stop in plan.segments():
                kept += plan.weights(start, stop).sum(axis=1)
            many += plan.rows
        return kept / max(many, 1)

    def reasons(self, treatment: Treatment, why: str, given: Given) -> tuple[str, ...]:
        """A sentence for each filter that was chosen, that of the parallel filter with the reason for its width."""
        made, parallel = [self._trembling()] if self.held else [], treatment.parallel_cutoff_hz or 0.0
        motion = f"the motion is below {self.bandwidth:.2g} Hz (98 % of the velocity's power)"
        if self.above:
            made.append(
                f"What the positions show between {self.bandwidth:.2g} and {self.above:.2g} Hz is taken for ripple or "
                f"vibration: without it the torque is predicted better on unseen parts."
            )
        if parallel < self.bandwidth and not why:
            made.append(
                f"Parallel filter of torque and columns: {parallel:.3g} Hz, but {motion}: the filter removes part of "
                f"it. Record at a higher rate, or reduce the decimation."
            )
        elif "parallel_cutoff_hz" not in given:
            made.append(f"Parallel filter of torque and columns: {parallel:.3g} Hz; {motion}{why}.")
        if "cutoff_hz" not in given and treatment.cutoff_hz is not None:
            cutoffs = np.atleast_1d(treatment.cutoff_hz)
            each = (
                f"{cutoffs.min():.3g} Hz"
                if len(set(cutoffs)) == 1
                else f"{cutoffs.min():.3g} to {cutoffs.max():.3g} Hz"
            )
            where = f", at most {self.position:g} times the motion's bandwidth" if np.isfinite(self.position) else ""
            made.append(
                f"Position filter{'s' if len(cutoffs) > 1 else ''}: {each}, where the noise that a channel's filter "
                f"passes balances the motion that it removes{where}."
            )
        if "decimation" not in given:
            in_period = f"{1 / (parallel * self.dt * treatment.decimation):.2g} rows per period of the parallel filter"
            made.append(f"Decimation: one row of {treatment.decimation} samples, {in_period}.")
        return (*made, *self._noise(treatment))

    def _trembling(self) -> str:
        """Report of the channels that are no part of the motion."""
        device = self.model.device
        names = [f"joint {device.joints[k].name}" for k in device.active]
        if len(names) != len(self.channels):
            names = [f"position channel {k + 1}" for k in range(len(self.channels))]
        named = ", ".join(names[k] for k in self.held)
        return f"What {named} shows is trembling while others move, and does not set the filters."

    def _noise(self, treatment: Treatment) -> tuple[str, ...]:
        """Report of the positions' noise compared with the acceleration, for the worst channel that moves."""
        if treatment.cutoff_hz is None:
            return ()
        cutoffs = np.broadcast_to(np.atleast_1d(treatment.cutoff_hz), (len(self.channels),))
        parallel = treatment.parallel_cutoff_hz or 0.5 / self.dt
        shares = [
            own.noise_share(cutoff, parallel) if own.bandwidth and k not in self.held else 0.0
            for k, (own, cutoff) in enumerate(zip(self.channels, cutoffs, strict=True))
        ]
        worst = int(np.argmax(shares))
        own = self.logs[0].channels.position.each_unit
        unit = "m" if own[min(worst, len(own) - 1)] in ("m", "mm", "um") else "rad"
        sentence = (
            f"The noise of the positions, {self.channels[worst].noise_rms:.1g} {unit} RMS, is "
            f"{100 * shares[worst]:.2g} % of the filtered acceleration"
        )
        return (sentence + ("." if shares[worst] < _LOUD else ": record faster motion, or with a finer encoder."),)

    def kept(self, treatment: Treatment, given: Given) -> tuple[str, ...]:
        """Report of the rows near reversals, which are dropped."""
        if "reversal_speed" in given or not any(self.reversal_speed):
            return ()
        measured = list(self.model.device.measured)
        shares = self._shares(treatment, np.array(self.reversal_speed))[measured]
        speeds = ", ".join(f"{v:.2g}" for v in np.atleast_1d(treatment.reversal_speed))
        guard = treatment.reversal_guard_s
        where = "Rows whose filter window contains" if guard is None else f"Rows within {guard:.2g} s of"
        pairs = zip(shares, self._of_noise[measured], strict=True)
        left = ", ".join("-" if noise else f"{100 * share:.0f}" for share, noise in pairs)
        of = "motors' rows are kept (-: its torque is noise alone)" if "-" in left else "motors' rows are kept"
        why = "the controller shakes the rotors by the steps of their encoders, which smooths dry friction"
        why = why if self.shaken else "the sign of dry friction is uncertain at reversals"
        return (
            f"{where} motion slower than {speeds} (of each motor, SI) are dropped, because {why}. {left} % of the "
            f"{of}.",
        )

    def at_rest(self, reference: Treatment) -> tuple[str, ...]:
        """Report of the rows at rest, which are left out of all errors, where there are any worth mentioning."""
        if not np.any(reference.rest_speed):
            return ()
        shares = 1 - self._shares(reference, np.zeros(len(self.model.device.row_names)))
        shares[self._of_noise] = 0.0  # not at rest
        shares = shares[list(self.model.device.measured)]
        if shares.max() < _MENTIONED:
            return ()
        left = ", ".join(f"{100 * share:.0f}" for share in shares)
        return (
            f"Rows at rest, where friction is anything up to dry friction, are left out of all errors: "
            f"{left} % of each motor's.",
        )


def _guard(parallel: float) -> float:
    """Time from slow motion within which rows are left out where others may contain it, s; cut-off in Hz."""
    return float(f"{_NEAR * KAISER_REACH / parallel:.3g}")


def _slow_samples(v: Array, window: int) -> Array:
    """How many samples of a log's velocity are slow beside the others, and how many there are, (2,); none at rest."""
    rest = rest_samples(v, SLOW * float(np.sqrt(np.mean(v**2))), window)
    square = v[~rest] ** 2
    return np.array([np.count_nonzero(square < SLOW**2 * square.mean()) if len(square) else 0, len(square)], float)


def _held(logs: tuple[Log, ...]) -> tuple[int, ...]:
    """Position channels, by index, that hardly move in any log while others do."""
    travels = np.max([np.ptp(np.asarray(log.position), axis=0) for log in logs], axis=0)
    units = logs[0].channels.position.each_unit
    straight = [units[min(k, len(units) - 1)] in ("m", "mm", "um") for k in range(len(travels))]
    return tuple(held_joints(travels.tolist(), straight))
