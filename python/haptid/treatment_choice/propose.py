"""Proposed treatment of logs, from the logs themselves, with the reasons.

Filters follow the motion's bandwidth, separated from encoder noise by channel; the parallel filter is chosen
among a few by its errors on unseen blocks, the delays are estimated jointly with the parameters, and the time blocks
are made long enough to be independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.display import Overview, displayed
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, MotionTooShortError, NoRowsError
from haptid.estimation import estimate
from haptid.estimation.methods.wls import WLS
from haptid.estimation.torque_uncertainty import other_motion, torque_uncertainty
from haptid.log import Log
from haptid.log.spectrum import Spectrum, spectra, widest
from haptid.motion.channels import check_log, state
from haptid.motion.filters import KAISER_REACH, bad_setting
from haptid.motion.treatment import Treatment, treat
from haptid.observation.observation import observe
from haptid.observation.plan import LEAST_BLOCKS, Plan
from haptid.treatment_choice.delay_estimate import Delays, find_delays
from haptid.treatment_choice.first_fit import least_squares, residual_memory
from haptid.treatment_choice.noise_effect import noise_effect
from haptid.treatment_choice.parallel_choice import better_cutoff
from haptid.treatment_choice.rounding import Rounding, rounding_effect
from haptid.treatment_choice.uncertainty import OF_POSITIONS, with_uncertain_delays

# Cut-off of the parallel filter over the motion's bandwidth: the usual one, all that are tried, and that of the filter
# behind which treatments are compared.
USUAL, TRIED, REFERENCE = 3.0, (1.5, 3.0, 6.0, 12.0), 6.0
# Time blocks of the reference rows in one of the treatment: to say which held-out part they lie in.
REFERENCE_BLOCKS = 8
# Rows per period of the parallel filter's cut-off: aliases are 60 dB down.
ROWS_IN_PERIOD = 8
# Highest cut-offs of the position filter and of the parallel filter, as shares of the sampling rate; the lowest of the
# position filter over the bandwidth; the lowest of the parallel filter as a number of periods in the log.
_HIGHEST, HIGHEST_PARALLEL, _LOWEST, _SHORTEST = 0.35, 0.15, 1.2, 10.0
# Highest cut-off of the position filter over that of the parallel filter: it passes that filter's band unchanged.
_WIDEST = 3.0
# Rows for each parameter, at least: a longer parallel filter leaves fewer.
_ROWS_PER_PARAMETER = 4.0
# Share of its root mean square speed below which a coordinate is slow, and the part of the parallel filter's half
# length within which a row must not be near to slow motion.
SLOW, _NEAR = 0.03, 0.3
# Least time in which a joint that hardly moves is at rest, s and periods of the bandwidth: in a tenth of a period a
# reversal moves on by four times as much as `SLOW` allows.
_REST, _RESTS = 0.25, 0.1
# Shares of a motor's rows whose filter window is clear of reversals: with this many the others are dropped, which
# costs little; with fewer than the second, they are not; between, unseen rows decide.
_CLEARLY, _CLEAR = 0.6, 0.3
# Least share of a motor's rows to keep; with fewer, all are kept.
KEPT = 0.1
# Cut-offs so far apart are two choices; the share by which the loss must fall where what moves faster is ripple.
_APART, _RIPPLE = 1.3, 0.25
# Length of a time block: integral times of the residual, periods of the parallel filter's cut-off, s.
_MEMORIES, _PERIODS, _SECOND = 4.0, 2.0, 1.0
# Share of rows at rest that is reported.
_MENTIONED = 0.02
# Noise above this share of the acceleration is reported.
_LOUD = 0.1
# Other filters are tried where errors of the positions are such a share of the torque's variance, and its standard
# error is above this, per cent; one is taken that leaves at most this share of the standard error.
_BY_POSITIONS, _WORTH_TRYING, _BETTER = 0.1, 0.3, 0.8
# Cut-offs over the bandwidth that are tried then: of the position filters, and of the parallel filter.
_LOWER, _OTHERS, _HALF = (3.0, 2.0, 1.4), (12.0, 1.5), 0.5
# Length of the part of each log that is analysed, s, and samples up to which it may be longer.
_ENOUGH, _LONGER, _SAMPLES = 120.0, 600.0, 200_000
# Ratio of the sampling rates of logs below which they are one: stamps of one recorder differ by a few parts in a
# thousand, and half a period then by less than the prior of a channel's own delay allows.
_SAME_RATE = 1.02
_Given = Mapping[str, Any]


@displayed
@dataclass(frozen=True, eq=False)
class Proposal:
    """Proposed treatment with reasons.

    Attributes:
        treatment: the settings that were given, and the others as proposed.
        reasons: a sentence for each proposed setting.
        reference: the treatment behind which errors are compared: it depends on the motion alone, and keeps all rows
            but those at rest.
        delays: of the torque channels as estimated; None where they were given or could not be estimated.
        bandwidth_hz: of the motion.
        effects: standard errors of the parameters by the encoders' noise and by the position filter, (1, p) each.
        rounding: what rounding of the positions moves; None without encoders.
    """

    treatment: Treatment
    reasons: tuple[str, ...]
    reference: Treatment
    delays: Delays | None
    bandwidth_hz: float
    effects: Mapping[str, Array] = field(default_factory=dict)
    rounding: Rounding | None = None

    def _shown(self) -> Overview:
        return Overview("Proposed treatment", ("reason",), [[reason] for reason in self.reasons])


def propose(model: DynamicModel, *logs: Log, **given: Any) -> Proposal:
    """Propose a treatment for logs of one device, recorded by one instrument.

    Args:
        logs: recordings; the most active minutes of each are analysed.
        given: settings of `Treatment` that are fixed.

    Raises:
        TreatmentError: a given setting is impossible, or a given cut-off too high for the sampling rate.
        IdentifiabilityError: no position moves more than its noise.
        HaptidError: as `observe` where a log does not fit the device.
    """
    if given.get("velocity") is not None:  # it takes unfiltered positions
        given = {"cutoff_hz": None, **given}
    unknown = set(given) - {setting.name for setting in fields(Treatment)}
    if unknown or not logs:
        wanted = f"one of {', '.join(setting.name for setting in fields(Treatment))}" if unknown else "one log at least"
        raise bad_setting("setting" if unknown else "logs", ", ".join(sorted(unknown)), wanted)
    Treatment(**given)  # impossible settings are an error before any work
    for log in logs:
        check_log(model.device, log)
    logs = tuple(
        part for log in logs for part in log.busiest(min(max(_ENOUGH, _SAMPLES * float(log.dt)), _LONGER)).parts()
    )
    filters = _Filters.of(model, logs, given)
    if "parallel_cutoff_hz" not in given and "cutoff_hz" not in given:
        filters = filters.known_to_the_torque(given)
    times, why = USUAL, ""
    treatment, delays = _with_delays(model, logs, filters.at(USUAL, given), given)
    if filters.may_clear and "reversal_guard_s" not in given:
        clear = replace(filters, near=False)
        settings = {**given, "torque_delay_s": treatment.torque_delay_s}
        tried = [filters.at(USUAL, settings), clear.at(USUAL, settings)]
        if better_cutoff(model, logs, tried, 0, clear.at(REFERENCE, settings), worth=0.0):
            filters = clear
            treatment, delays = _with_delays(model, logs, filters.at(USUAL, given), given, delays)
    if "parallel_cutoff_hz" not in given and "cutoff_hz" not in given:
        settings = {**given, "torque_delay_s": treatment.torque_delay_s}
        tried, judged = [filters.at(k, settings) for k in TRIED], filters.at(REFERENCE, settings, all_rows=True)
        times = TRIED[better_cutoff(model, logs, tried, TRIED.index(USUAL), judged)]
        if times != USUAL:
            treatment, delays = _with_delays(model, logs, filters.at(times, given), given, delays)
            why = f", {times:g} times it: better on unseen blocks than {USUAL:g} times"
    choice = _Choice.of(filters, times, given, treatment, delays)
    if choice.positions_matter:
        usual, choice = choice, _least_uncertain(choice)
        if choice is not usual:
            why = (
                f", {choice.times:g} times it: errors of the positions matter, and behind these filters the torque of "
                f"other motion has a standard error of {choice.torque_se:.2g} in place of {usual.torque_se:.2g} %"
            )
    filters, treatment, delays = choice.filters, choice.treatment, choice.delays
    reference = filters.lowered(np.inf).at(REFERENCE, {"torque_delay_s": treatment.torque_delay_s}, all_rows=True)
    why_time = () if "torque_delay_s" in given else (delays.sentence if delays else _no_delay(logs),)
    why_rows = (*filters.kept(treatment, given), *filters.at_rest(reference))
    reasons = (*filters.reasons(treatment, why, given), *why_rows, *choice.why_block, *why_time)
    reference = replace(reference, block_s=treatment.block_s / REFERENCE_BLOCKS)
    return Proposal(treatment, reasons, reference, delays, filters.bandwidth, choice.effects, choice.rounding)


@dataclass(frozen=True, eq=False)
class _Choice:
    """A treatment with all that is estimated behind it.

    Attributes:
        filters: that it has.
        times: parallel cut-off over the bandwidth.
        given: settings that stand.
        treatment, why_block: with its time blocks, and their reason.
        delays: of the torque channels.
        effects: of noise and position filter on the parameters.
        rounding: its effect on parameters and delays.
        motion: the other motion, of `other_motion`; None where nothing was estimated.
        torque_se: standard error of the torque in it, per cent.
        by_positions: share of its square by errors of the positions.
    """

    filters: _Filters
    times: float
    given: _Given
    treatment: Treatment
    why_block: tuple[str, ...]
    delays: Delays | None
    effects: Mapping[str, Array]
    rounding: Rounding | None
    motion: Array | None
    torque_se: float
    by_positions: float

    @staticmethod
    def of(
        filters: _Filters,
        times: float,
        given: _Given,
        treatment: Treatment,
        delays: Delays | None,
        motion: Array | None = None,
    ) -> _Choice:
        """Time blocks, effects of noise and the torque's uncertainty of a treatment; its own motion where None."""
        model, logs = filters.model, filters.logs
        treatment, why_block = _independent_blocks(model, logs, treatment, given)
        effects: Mapping[str, Array] = {}
        rounding = None
        try:
            rows = observe(model, *(treat(log, treatment) for log in logs))
            effects, made = noise_effect(rows, logs, filters.spectra, treatment), estimate(rows, WLS())
            rounding = rounding_effect(made, logs, filters.spectra, treatment, delays)
            made, delays = with_uncertain_delays(made, delays, effects, rounding)
        except (NoRowsError, IdentifiabilityError, MotionTooShortError):
            torque_se, share = np.inf, 0.0  # nothing to compare
        else:
            motion = other_motion(made.observation) if motion is None else motion
            torque_se = torque_uncertainty(made.observation, made.covariance, motion)
            parts = [made.nuisances[name] for name in OF_POSITIONS if name in made.nuisances]
            own = sum(torque_uncertainty(made.observation, shifts.T @ shifts, motion) ** 2 for shifts in parts)
            share = own / torque_se**2 if 0 < torque_se < np.inf else 0.0
        return _Choice(filters, times, given, treatment, why_block, delays, effects, rounding, motion, torque_se, share)

    @property
    def positions_matter(self) -> bool:
        """Whether other filters may be better: errors of the positions are much of what is uncertain."""
        return self.torque_se > _WORTH_TRYING and self.by_positions > _BY_POSITIONS

    def with_filters(self, filters: _Filters, times: float) -> _Choice:
        """The choice with other filters."""
        model, logs = filters.model, filters.logs
        made = _with_delays(model, logs, filters.at(times, self.given), self.given, self.delays)
        return _Choice.of(filters, times, self.given, *made, self.motion)


def _least_uncertain(usual: _Choice) -> _Choice:
    """The filters behind which the torque of other motion is least uncertain; the usual ones if none is much better.

    Unseen rows cannot choose here: their positions have the same errors, and parameters that these attenuate predict
    them better than the true ones. A lower position filter takes away more of the errors and more of the motion; a wide
    parallel filter behind it keeps the information of dry friction. The standard error has all of this in it.

    Args:
        usual: filters for the noise as it was taken from the spectra.
    """
    given, best = usual.given, usual
    if "cutoff_hz" not in given:
        for lower in _LOWER:
            best = _better(best, best.filters.lowered(lower), usual.times)
            if best.filters.position > lower:
                break
    if "parallel_cutoff_hz" not in given:
        for times in _OTHERS:
            best = _better(best, best.filters, times)
        while best.times == times:  # as narrow as it helps: a loop that vibrates is slower than its bandwidth
            times *= _HALF
            best = _better(best, best.filters, times)
        if "cutoff_hz" not in given and not usual.filters.above:
            best = _better(best, usual.filters.bulk(given), usual.times)
    return best if best.torque_se < _BETTER * usual.torque_se else usual


def _better(best: _Choice, filters: _Filters, times: float) -> _Choice:
    """The better one of a choice and that with other filters, where these differ."""
    wanted = filters.at(times, best.given)
    if (wanted.cutoff_hz, wanted.parallel_cutoff_hz) == (best.treatment.cutoff_hz, best.treatment.parallel_cutoff_hz):
        return best
    try:
        other = best.with_filters(filters, times)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return best
    return other if other.torque_se < best.torque_se else best


def _no_delay(logs: Sequence[Log]) -> str:
    """Why there is no estimate of the delay."""
    rates = sorted({f"{log.rate_hz:.4g}" for log in logs})
    why = "" if _one_rate(logs) else f", which have {' and '.join(rates)} Hz"
    return f"The torque delay could not be estimated from the logs{why}; none is compensated. Give `torque_delay_s`."


def _one_rate(logs: Sequence[Log]) -> bool:
    """Whether the logs have one sampling rate, but for what stamps of one clock differ by."""
    rates = [log.rate_hz for log in logs]
    return max(rates) < _SAME_RATE * min(rates)


def _with_delays(
    model: DynamicModel, logs: Sequence[Log], treatment: Treatment, given: _Given, start: Delays | None = None
) -> tuple[Treatment, Delays | None]:
    """The treatment with the delays of the torque channels, and these; as it is where they were given."""
    if "torque_delay_s" in given:
        return treatment, None
    delays = _delays(model, logs, treatment, start)
    return treatment if delays is None else replace(treatment, torque_delay_s=delays.setting), delays


def _delays(
    model: DynamicModel, logs: Sequence[Log], treatment: Treatment, start: Delays | None = None
) -> Delays | None:
    """Delays of the torque channels; None where the logs have no rows, or their rates differ."""
    if not _one_rate(logs):  # a hold of one sample is not one time
        return None
    plain = treatment
    if treatment.momentum:  # the lag of a differentiator is not a delay of the torque
        wide = USUAL * (treatment.parallel(float(logs[0].dt)) or 1 / logs[0].dt)
        cutoff = treatment.cutoff_hz or min(wide, _HIGHEST / float(logs[0].dt))
        plain = replace(treatment, velocity=None, cutoff_hz=cutoff, formulation="acceleration")
    try:
        return find_delays(model, logs, plain, start)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return None


@dataclass(frozen=True, eq=False)
class _Filters:
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
        rest_speed: the same, of rows that are hardly ever faster too.
        near: whether rows count whose filter window contains a reversal, if not near its middle.
        may_clear: whether enough rows are left without those.
        above: bandwidth of what moves besides, and is no motion by the torque, Hz; 0 where there is none.
        position: cut-off of the position filters over the bandwidth, at most.
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

    @staticmethod
    def of(
        model: DynamicModel, logs: tuple[Log, ...], given: _Given, found: tuple[tuple[Spectrum, ...], ...] | None = None
    ) -> _Filters:
        """From the spectra of the logs' positions, computed where None."""
        dt, found = max(float(log.dt) for log in logs), found or tuple(spectra(log) for log in logs)
        channels = widest(found)
        bandwidth = max(spectrum.bandwidth for spectrum in channels)
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
        made = _Filters(model, logs, found, channels, bandwidth, dt, top, lowest, ())
        rest = made._slow(made.at(USUAL, {**given, "reversal_speed": 0.0}))
        if any(rest):
            often = made._shares(made.at(USUAL, {}), np.array(rest)) >= KEPT
            made = replace(made, reversal_speed=tuple(np.where(often, rest, 0.0).tolist()), rest_speed=rest)
        if any(made.reversal_speed):
            clear = replace(made, near=False).at(USUAL, given)
            kept = made._shares(clear, np.array(made.reversal_speed))[list(model.device.measured)]
            made = replace(made, near=bool(min(kept) < _CLEARLY), may_clear=bool(_CLEAR <= min(kept) < _CLEARLY))
        return made

    def known_to_the_torque(self, given: _Given) -> _Filters:
        """Filters for the bulk of the motion alone, where that predicts the torque of unseen parts better.

        Both are judged on positions with all that moves, behind a parallel filter that passes the bulk alone: there a
        model that took ripple for motion fails, and so does one that left true motion out.
        """
        narrow = self.bulk(given)
        wide, close = self.at(USUAL, given), narrow.at(USUAL, given)
        if not (np.asarray(wide.cutoff_hz) > _APART * np.asarray(close.cutoff_hz)).any():
            return self
        delay = _with_delays(self.model, self.logs, wide, given)[0].torque_delay_s
        tried = [replace(wide, torque_delay_s=delay), replace(close, torque_delay_s=delay)]
        guess = {**given, "torque_delay_s": delay}
        bulk = {**guess, "cutoff_hz": tried[0].cutoff_hz, "parallel_cutoff_hz": narrow.parallel(TRIED[0])}
        judged = self.at(USUAL, bulk, all_rows=True)
        chosen = better_cutoff(self.model, self.logs, tried, 0, judged, _RIPPLE)
        return replace(narrow, above=float(np.max(np.asarray(wide.cutoff_hz)))) if chosen else self

    def bulk(self, given: _Given) -> _Filters:
        """Filters for the bulk of the motion alone; these where there is no other motion."""
        found = tuple(tuple(spectrum.narrowed() for spectrum in own) for own in self.spectra)
        if max(s.bandwidth for s in widest(found)) == 0:
            return self
        return _Filters.of(self.model, self.logs, given, found)

    def lowered(self, times: float) -> _Filters:
        """With position filters of at most this multiple of the bandwidth."""
        return replace(self, position=times)

    def parallel(self, times: float) -> float:
        """Cut-off of the parallel filter, so many times the bandwidth, as far as the log allows, Hz."""
        return min(max(times * self.bandwidth, self.lowest), HIGHEST_PARALLEL / self.dt)

    def at(self, times: float, given: _Given, all_rows: bool = False) -> Treatment:
        """The treatment with a parallel filter so many times the bandwidth, and the given settings."""
        parallel = given.get("parallel_cutoff_hz") or self.parallel(times)
        decimation = given.get("decimation") or max(1, int(1 / (ROWS_IN_PERIOD * parallel * self.dt)))
        if "decimation" in given and "parallel_cutoff_hz" not in given:
            parallel = min(parallel, Treatment(**given).parallel_shape.share * 0.5 / self.dt / decimation)
        follows: dict[str, Any] = {"parallel_cutoff_hz": parallel, "decimation": decimation}
        if "cutoff_hz" not in given:
            # Two digits more than the differences between cut-offs matter for.
            follows["cutoff_hz"] = self._position_cutoffs(parallel)
        if "reversal_speed" not in given and not all_rows and any(self.reversal_speed):
            follows["reversal_speed"] = self.reversal_speed
        if all_rows and any(self.rest_speed):
            follows |= {"rest_speed": self.rest_speed, "rest_s": max(_REST, _RESTS / self.bandwidth)}
        if "reversal_guard_s" not in given and not all_rows and self.near:
            follows["reversal_guard_s"] = float(f"{_NEAR * KAISER_REACH / parallel:.3g}")
        return Treatment(**{**follows, **given})

    @cached_property
    def _cutoffs(self) -> dict[float, tuple[float, ...]]:
        """Those found, by the parallel filter's cut-off; a cache of the class would keep the logs for ever."""
        return {}

    def _position_cutoffs(self, parallel: float) -> tuple[float, ...]:
        """Cut-off of each position channel's filter, Hz, to the digits that matter."""
        if parallel not in self._cutoffs:
            self._cutoffs[parallel] = self._balanced(parallel)
        return self._cutoffs[parallel]

    def _balanced(self, parallel: float) -> tuple[float, ...]:
        low = _LOWEST * self.bandwidth
        high = max(min(_HIGHEST * 2 * self.top, _WIDEST * parallel), 1.1 * low)
        ceiling = min(0.95 * 0.5 / self.dt, self.position * self.bandwidth)
        found = (min(own.balanced_cutoff(parallel, low, high), ceiling) for own in self.channels)
        return tuple(float(f"{cutoff:.3g}") for cutoff in found)

    def _slow(self, treatment: Treatment) -> tuple[float, ...]:
        """The speed of each row of torque below which the sign of its dry friction is uncertain."""
        rows = len(self.model.device.row_names)
        if not any(self.model.coulomb_terms(row) for row in range(rows)):
            return ()
        speeds, samples = np.full(rows, np.inf), 0
        power: dict[tuple[int, int], float] = {}
        for log in self.logs:
            motion = treat(log, treatment)
            c, cd = state(self.model.device, motion, *motion.usable)
            samples += cd.shape[1]
            for row in range(rows):
                for k, term in enumerate(self.model.coulomb_terms(row)):
                    own = float(np.sum(self.model.speed(term, c, cd) ** 2))
                    power[row, k] = power.get((row, k), 0.0) + own
        for (row, _), total in power.items():
            speeds[row] = min(speeds[row], SLOW * float(np.sqrt(total / samples)))
        return tuple(float(f"{v:.2g}") if np.isfinite(v) else 0.0 for v in speeds)

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

    def reasons(self, treatment: Treatment, why: str, given: _Given) -> tuple[str, ...]:
        """A sentence for each filter that was chosen, that of the parallel filter with the reason for its width."""
        made, parallel = [], treatment.parallel_cutoff_hz or 0.0
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

    def _noise(self, treatment: Treatment) -> tuple[str, ...]:
        """Report of the positions' noise compared with the acceleration, for the worst channel that moves."""
        if treatment.cutoff_hz is None:
            return ()
        cutoffs = np.broadcast_to(np.atleast_1d(treatment.cutoff_hz), (len(self.channels),))
        parallel = treatment.parallel_cutoff_hz or 0.5 / self.dt
        shares = [
            own.noise_share(cutoff, parallel) if own.bandwidth else 0.0
            for own, cutoff in zip(self.channels, cutoffs, strict=True)
        ]
        worst = int(np.argmax(shares))
        own = self.logs[0].channels.position.each_unit
        unit = "m" if own[min(worst, len(own) - 1)] in ("m", "mm", "um") else "rad"
        sentence = (
            f"The noise of the positions, {self.channels[worst].noise_rms:.1g} {unit} RMS, is "
            f"{100 * shares[worst]:.2g} % of the filtered acceleration"
        )
        return (sentence + ("." if shares[worst] < _LOUD else ": record faster motion, or with a finer encoder."),)

    def kept(self, treatment: Treatment, given: _Given) -> tuple[str, ...]:
        """Report of the rows near reversals, which are dropped."""
        if "reversal_speed" in given or not any(self.reversal_speed):
            return ()
        shares = self._shares(treatment, np.array(self.reversal_speed))[list(self.model.device.measured)]
        speeds = ", ".join(f"{v:.2g}" for v in np.atleast_1d(treatment.reversal_speed))
        guard = treatment.reversal_guard_s
        where = "Rows whose filter window contains" if guard is None else f"Rows within {guard:.2g} s of"
        left = ", ".join(f"{100 * share:.0f}" for share in shares)
        return (
            f"{where} motion slower than {speeds} (of each motor, SI) are dropped, because the sign of dry friction is "
            f"uncertain at reversals. {left} % of the motors' rows are kept.",
        )

    def at_rest(self, reference: Treatment) -> tuple[str, ...]:
        """Report of the rows at rest, which are in no error, where there are any worth mentioning."""
        if not np.any(reference.rest_speed):
            return ()
        shares = 1 - self._shares(reference, np.zeros(len(self.model.device.row_names)))
        shares = shares[list(self.model.device.measured)]
        if shares.max() < _MENTIONED:
            return ()
        left = ", ".join(f"{100 * share:.0f}" for share in shares)
        return (
            f"Rows at rest, where friction is anything up to dry friction, are in no error: {left} % of each motor's.",
        )


def _independent_blocks(
    model: DynamicModel, logs: Sequence[Log], treatment: Treatment, given: _Given
) -> tuple[Treatment, tuple[str, ...]]:
    """With time blocks, the clusters of standard errors, several times longer than the memory of the residual."""
    if "block_s" in given:
        return treatment, ()
    longest = min(len(log.t) * float(log.dt) for log in logs) / LEAST_BLOCKS
    try:
        motions = [treat(log, treatment) for log in logs]
        memory = residual_memory(model, motions, least_squares(observe(model, *motions)))
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return treatment, ()
    period = _PERIODS / (treatment.parallel(float(logs[0].dt)) or 1 / float(logs[0].dt))
    wanted = max(_SECOND, period, _MEMORIES * memory)
    block = float(f"{min(wanted, max(longest, period)):.2g}")
    short = "" if wanted <= longest else "; the log is too short for longer ones, and its intervals are rough"
    return replace(treatment, block_s=block), (
        f"Time blocks of {block:g} s: the residual's autocorrelation has an integral time of {memory:.2g} s{short}.",
    )
