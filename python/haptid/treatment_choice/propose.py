"""Proposed treatment of logs, from the logs themselves, with the reasons.

Filters follow the motion's bandwidth, separated from encoder noise by channel; the parallel filter is chosen
among a few by its errors on unseen blocks, the delays are estimated jointly with the parameters, and the time blocks
are made long enough to be independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, fields, replace
from itertools import takewhile
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, MotionTooShortError, NoRowsError
from haptid.estimation import estimate
from haptid.estimation.methods.wls import WLS
from haptid.estimation.torque_uncertainty import other_motion, torque_uncertainty
from haptid.log import Log
from haptid.motion.channels import check_log
from haptid.motion.filters import bad_setting
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.observation.observation import observe
from haptid.observation.plan import LEAST_BLOCKS
from haptid.treatment_choice.corners import cuts_corners
from haptid.treatment_choice.delay_estimate import Delays, find_delays
from haptid.treatment_choice.first_fit import least_squares, residual_memory
from haptid.treatment_choice.motion_filters import HIGHEST, HIGHEST_PARALLEL, USUAL, Given, MotionFilters
from haptid.treatment_choice.noise_effect import noise_effect
from haptid.treatment_choice.parallel_choice import better_cutoff
from haptid.treatment_choice.rounding import Rounding, rounding_effect
from haptid.treatment_choice.shaking import shaken_speeds
from haptid.treatment_choice.uncertainty import OF_POSITIONS, with_uncertain_delays

# Cut-offs of the parallel filter over the motion's bandwidth: all that are tried, and that of the filter behind which
# treatments are compared.
TRIED, REFERENCE = (1.5, USUAL, 6.0, 12.0), 6.0
# Time blocks of the reference rows in one of the treatment: to say which held-out part they lie in.
REFERENCE_BLOCKS = 8
# Cut-offs so far apart are two choices; the share by which the loss must fall where what moves faster is ripple.
_APART, _RIPPLE = 1.3, 0.25
# Standard deviations by which unseen rows must show that the friction's sign is wrong in windows with a reversal.
_WRONG_SIGN = 2.0
# Length of a time block: integral times of the residual, periods of the parallel filter's cut-off, s.
_MEMORIES, _PERIODS, _SECOND = 4.0, 2.0, 1.0
# Other filters are tried where errors of the positions are such a share of the torque's variance, and its standard
# error is above this, per cent; one is taken that leaves at most this share of the standard error, in steps of which
# each leaves at most the last share of the one before.
_BY_POSITIONS, _WORTH_TRYING, _BETTER, _STEP = 0.1, 0.3, 0.8, 0.95
# Cut-offs over the bandwidth that are tried then: of the position filters, and of the parallel filter.
_LOWER, _OTHERS, _HALF = (3.0, 2.0, 1.4), (12.0, 1.5), 0.5
# Length of the part of each log that is analysed, s, and samples up to which it may be longer.
_ENOUGH, _LONGER, _SAMPLES = 120.0, 600.0, 200_000
# Ratio of the sampling rates of logs below which they are one: stamps of one recorder differ by a few parts in a
# thousand, and half a period then by less than the prior of a channel's own delay allows.
_SAME_RATE = 1.02


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
        dt: sampling period of the slowest log that it is from, s.
        given: names of the settings that were given.
    """

    treatment: Treatment
    reasons: tuple[str, ...]
    reference: Treatment
    delays: Delays | None
    bandwidth_hz: float
    effects: Mapping[str, Array] = field(default_factory=dict)
    rounding: Rounding | None = None
    dt: float = 0.0
    given: frozenset[str] = frozenset()

    def carried_by(self, log: Log) -> Treatment:
        """The treatment of a log: at a lower rate than those it is from, what was proposed is lowered to that rate."""
        return _lowered(self.treatment, self.dt, float(log.dt), self.given)

    def reference_of(self, log: Log) -> Treatment:
        """The reference of a log, lowered in the same way."""
        return _lowered(self.reference, self.dt, float(log.dt), frozenset())

    def slower(self, logs: Sequence[Log]) -> tuple[str, ...]:
        """A sentence for each log to whose rate the treatment is lowered."""
        lowered = {log: made for log in logs if (made := self.carried_by(log)) != self.treatment}
        return tuple(
            f"{log.path.name} has {log.rate_hz:.4g} Hz, less than the {1 / self.dt:.4g} Hz that the treatment is for: "
            f"there the parallel filter is at {made.parallel(float(log.dt)) or 0.5 * log.rate_hz:.3g} Hz, and one row "
            f"is of {made.decimation} sample{'s' if made.decimation > 1 else ''}."
            for log, made in lowered.items()
        )

    def _shown(self) -> Overview:
        return Overview("Proposed treatment", ("reason",), [[reason] for reason in self.reasons])


def _lowered(treatment: Treatment, dt: float, own: float, given: frozenset[str]) -> Treatment:
    """A treatment of samples every `dt` s as samples every `own` s carry it, but for settings that were given."""
    if own < _SAME_RATE * dt:
        return treatment
    highest = 0.95 * 0.5 / own
    lowered: dict[str, Any] = {
        "parallel_cutoff_hz": min(treatment.parallel(dt) or HIGHEST_PARALLEL / dt, HIGHEST_PARALLEL / own),
        "decimation": max(1, int(treatment.decimation * dt / own)),
    }
    if treatment.cutoff_hz is not None:
        lowered["cutoff_hz"] = tuple(np.minimum(np.atleast_1d(treatment.cutoff_hz), highest).tolist())
    return replace(treatment, **{name: value for name, value in lowered.items() if name not in given})


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
    filters = MotionFilters.of(model, logs, given)
    if "parallel_cutoff_hz" not in given and "cutoff_hz" not in given:
        filters = _known_to_the_torque(filters, given)
    times, why = USUAL, ""
    treatment, delays = _with_delays(filters, filters.at(USUAL, given), given)
    unshaken, filters = filters, _faster_than_shaking(filters, treatment, given)
    if filters is not unshaken:
        treatment, delays = _with_delays(filters, filters.at(USUAL, given), given, delays)
    if filters.may_clear and "reversal_guard_s" not in given:
        clear = replace(filters, near=False)
        settings = {**given, "torque_delay_s": treatment.torque_delay_s}
        tried = [filters.at(USUAL, settings), clear.at(USUAL, settings)]
        if better_cutoff(model, logs, tried, 0, clear.at(REFERENCE, settings), worth=0.0, surely=_WRONG_SIGN):
            filters = clear
            treatment, delays = _with_delays(filters, filters.at(USUAL, given), given)  # not from wrong signs
    if "parallel_cutoff_hz" not in given and "cutoff_hz" not in given:
        times, why = _parallel_times(filters, {**given, "torque_delay_s": treatment.torque_delay_s})
        if times != USUAL:
            treatment, delays = _with_delays(filters, filters.at(times, given), given, delays)
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
    fixed = frozenset(given)
    return Proposal(
        treatment, reasons, reference, delays, filters.bandwidth, choice.effects, choice.rounding, filters.dt, fixed
    )


def _faster_than_shaking(filters: MotionFilters, treatment: Treatment, given: Given) -> MotionFilters:
    """Filters without rows slower than the speeds at which a controller shakes the rotors."""
    if not any(filters.reversal_speed) or "reversal_speed" in given or treatment.momentum:
        return filters
    narrow = filters.at(TRIED[0], {**given, "torque_delay_s": treatment.torque_delay_s})  # as elastic devices have it
    try:
        speeds = shaken_speeds(filters.model, filters.logs, narrow, filters.bandwidth)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return filters
    return filters.faster_than(speeds, given) if speeds.any() else filters


def _parallel_times(filters: MotionFilters, settings: Given) -> tuple[float, str]:
    """Cut-off of the parallel filter over the motion's bandwidth, and why it is not the usual one.

    Of elastic devices the narrowest: what distinguishes the inertias of a rotor and its link is small beside their
    columns. Above the motion these hold noise, that of the encoders and what noise of the torque moves the rotors by,
    whose share in that small part unseen rows of torque do not show.
    """
    model, narrow = filters.model, TRIED[0]
    if model.device.elastic:
        return narrow, f", {narrow:g} times it: above the motion, noise would divide inertia between rotors and links"
    tried, judged = [filters.at(k, settings) for k in TRIED], filters.at(REFERENCE, settings, all_rows=True)
    times = TRIED[better_cutoff(model, filters.logs, tried, TRIED.index(USUAL), judged)]
    return times, "" if times == USUAL else f", {times:g} times it: better on unseen blocks than {USUAL:g} times"


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

    filters: MotionFilters
    times: float
    given: Given
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
        filters: MotionFilters,
        times: float,
        given: Given,
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
            made = estimate(rows, WLS())
            effects = noise_effect(made, logs, filters.spectra, treatment, delays)
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

    def with_filters(self, filters: MotionFilters, times: float) -> _Choice:
        """The choice with other filters."""
        made = _with_delays(filters, filters.at(times, self.given), self.given, self.delays)
        return _Choice.of(filters, times, self.given, *made, self.motion)


def _least_uncertain(usual: _Choice) -> _Choice:
    """The filters behind which the torque of other motion is least uncertain; the usual ones if none is much better.

    Unseen rows cannot choose here: their positions have the same errors, and parameters that these attenuate predict
    them better than the true ones. A lower position filter takes away more of the errors and more of the motion; a wide
    parallel filter behind it keeps the information of dry friction. The standard error has all of this in it, but for
    corners of the motion at its reversals, which no lower filter may cut.

    Args:
        usual: filters for the noise as it was taken from the spectra.
    """
    given, best = usual.given, usual

    def better(best: _Choice, filters: MotionFilters, times: float) -> _Choice:
        return best if _cuts(usual, filters, times) else _better(best, filters, times)

    if "cutoff_hz" not in given and not any(usual.filters.model.device.free_rows):
        for lower in takewhile(lambda lower: not _cuts(usual, usual.filters.lowered(lower), usual.times), _LOWER):
            best = _better(best, best.filters.lowered(lower), usual.times)
    if "parallel_cutoff_hz" not in given:
        for times in _OTHERS[1:] if usual.filters.model.device.elastic else _OTHERS:
            best = better(best, best.filters, times)
        while best.times == times:  # as narrow as it helps: a loop that vibrates is slower than its bandwidth
            times *= _HALF
            best = better(best, best.filters, times)
        if "cutoff_hz" not in given and not usual.filters.above:
            best = better(best, usual.filters.bulk(given), usual.times)
    return best if best.torque_se < _BETTER * usual.torque_se else usual


def _better(best: _Choice, filters: MotionFilters, times: float) -> _Choice:
    """The better one of a choice and that with other filters, where these differ."""
    wanted = filters.at(times, best.given)
    if (wanted.cutoff_hz, wanted.parallel_cutoff_hz) == (best.treatment.cutoff_hz, best.treatment.parallel_cutoff_hz):
        return best
    try:
        other = best.with_filters(filters, times)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return best
    return other if other.torque_se < _STEP * best.torque_se else best


def _cuts(choice: _Choice, filters: MotionFilters, times: float) -> bool:
    """Whether other filters cut corners of the motion that those of a choice leave."""
    return cuts_corners(filters.logs, choice.treatment, filters.at(times, choice.given))


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
    filters: MotionFilters, treatment: Treatment, given: Given, start: Delays | None = None
) -> tuple[Treatment, Delays | None]:
    """The treatment with the delays of the torque channels, and these; as it is where they were given."""
    if "torque_delay_s" in given:
        return treatment, None
    delays = _delays(filters, treatment, start)
    return treatment if delays is None else replace(treatment, torque_delay_s=delays.setting), delays


def _delays(filters: MotionFilters, treatment: Treatment, start: Delays | None = None) -> Delays | None:
    """Delays of the torque channels; None where the logs have no rows, or their rates differ."""
    logs = filters.logs
    if not _one_rate(logs):  # a hold of one sample is not one time
        return None
    plain = treatment
    if treatment.momentum:  # the lag of a differentiator is not a delay of the torque
        wide = USUAL * (treatment.parallel(float(logs[0].dt)) or 1 / logs[0].dt)
        cutoff = treatment.cutoff_hz or min(wide, HIGHEST / float(logs[0].dt))
        plain = replace(treatment, velocity=None, cutoff_hz=cutoff, formulation="acceleration")
    try:
        return find_delays(filters.model, logs, plain, start, filters.bandwidth)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return None


def _known_to_the_torque(filters: MotionFilters, given: Given) -> MotionFilters:
    """Filters for the bulk of the motion alone, where that predicts the torque of unseen parts better.

    Both are judged on positions with all that moves, behind a parallel filter that passes the bulk alone: there a
    model that took ripple for motion fails, and so does one that left true motion out.
    """
    narrow = filters.bulk(given)
    wide, close = filters.at(USUAL, given), narrow.at(USUAL, given)
    if not (np.asarray(wide.cutoff_hz) > _APART * np.asarray(close.cutoff_hz)).any():
        return filters
    delay = _with_delays(filters, wide, given)[0].torque_delay_s
    tried = [replace(wide, torque_delay_s=delay), replace(close, torque_delay_s=delay)]
    guess = {**given, "torque_delay_s": delay}
    bulk = {**guess, "cutoff_hz": tried[0].cutoff_hz, "parallel_cutoff_hz": narrow.parallel(TRIED[0])}
    judged = filters.at(USUAL, bulk, all_rows=True)
    chosen = better_cutoff(filters.model, filters.logs, tried, 0, judged, _RIPPLE)
    return replace(narrow, above=float(np.max(np.asarray(wide.cutoff_hz)))) if chosen else filters


def _independent_blocks(
    model: DynamicModel, logs: Sequence[Log], treatment: Treatment, given: Given
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
