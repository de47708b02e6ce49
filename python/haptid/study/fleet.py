"""Fleets: every log of many devices identified by itself as one study says; what drifts, and which device differs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import field, fields, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError, ShapeError, listed
from haptid.estimation import Estimate, estimate
from haptid.executors import Executor, SerialExecutor
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.observation.observation import observe
from haptid.study import Study
from haptid.study.fleet_logs import SECONDS_IN_DAY, FleetLog, fleet_logs
from haptid.study.fleet_results import FleetResults, fleet_fingerprint
from haptid.study.identify import check_kind, logs_to_propose_from, read_entry, with_all_uncertainty
from haptid.study.schema import fault
from haptid.study.study import silent
from haptid.treatment_choice.propose import Proposal, propose
from haptid.uncertainty.multiple_testing import holm_adjusted, two_sided
from haptid.uncertainty.quantities import LEVEL, aligned, half_width
from haptid.uncertainty.random_effects import RandomEffects, random_effects
from haptid.validation.validation import fit_errors

# Fewest logs of a device whose drift is told, and fewest devices of which one is called unusual.
_LEAST_LOGS, _LEAST_DEVICES = 3, 4
# Distance from the median of the devices, in robust standard deviations, of an unusual one (Iglewicz and Hoaglin 1993).
_UNUSUAL = 3.5
_NORMAL_MAD = 1.4826
# Fewest logs of which one is called unlike the others by the error of its fit, and the least factor between them.
_LEAST_FITS, _WORSE = 3, 2.0
# Devices in the printed table.
_SHOWN = 40
# Fields that JSON has as lists.
_KEPT: dict[str, Callable[[Any], Any]] = {
    "names": tuple,
    "units": tuple,
    "values": np.array,
    "se": np.array,
    "dof": np.array,
}
_Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class FleetEstimate:
    """What one log gives.

    Attributes:
        log: which.
        error: why it gives nothing; empty where it does.
        status: of the estimate.
        error_percent: relative torque error of its fit.
        names, units: of the parameters, (k,).
        values, se, dof: of the parameters, (k,).
        sha256: of the log's file; empty where it gives nothing.
    """

    log: FleetLog
    error: str = ""
    status: str = ""
    error_percent: float = np.nan
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    values: Array = field(default_factory=lambda: np.zeros(0))
    se: Array = field(default_factory=lambda: np.zeros(0))
    dof: Array = field(default_factory=lambda: np.zeros(0))
    sha256: str = ""

    @staticmethod
    def of_kept(log: FleetLog, kept: dict[str, Any] | None) -> FleetEstimate | None:
        """What an interrupted run has kept of a log of the same content; None where it is not whole."""
        try:
            made: dict[str, Any] = {key: _KEPT.get(key, lambda x: x)(x) for key, x in (kept or {}).items()}
            return FleetEstimate(log, **made) if made else None
        except (TypeError, ValueError, ShapeError):
            return None

    def to_keep(self) -> dict[str, Any]:
        """All but the log, as JSON values."""
        own = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "log"}
        return {key: x.tolist() if isinstance(x, np.ndarray) else x for key, x in own.items()}

    def __post_init__(self) -> None:
        k = len(self.names)
        freeze_fields(self, values=(k,), se=(k,), dof=(k,))

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals of the parameters, (k, 2)."""
        half = half_width(self.se, self.dof, level)
        return np.column_stack([self.values - half, self.values + half])


@dataclass(frozen=True, eq=False)
class FleetTrend:
    """Mean and drift of the parameters of one device, by random-effects regression over its logs.

    Attributes:
        device: its name.
        logs: number of its logs that count.
        mean: of each parameter at the middle of the time, (k,).
        slope: of each parameter in a day, (k,); undetermined where all logs are of one time.
    """

    device: str
    logs: int
    mean: tuple[RandomEffects, ...]
    slope: tuple[RandomEffects, ...]

    def of_mean(self, name: Literal["values", "se"]) -> Array:
        """Values or standard errors of all means, (k,)."""
        return np.array([getattr(one, name)[0] for one in self.mean])

    def of_slope(self, name: Literal["values", "se"]) -> Array:
        """Values or standard errors of all slopes, (k,)."""
        return np.array([getattr(one, name)[-1] for one in self.slope])

    @property
    def dof(self) -> Array:
        """Degrees of freedom of the slopes, (k,)."""
        return np.array([one.dof for one in self.slope])


@dataclass(frozen=True, eq=False)
class Fleet:
    """All logs of a fleet, each identified by itself.

    Drift is tested device by device and parameter by parameter, with Holm's correction over all of them. A device is
    unusual in a parameter where its mean is further from the median of all devices than 3.5 robust standard deviations,
    and further than its interval.

    Attributes:
        name: of the study.
        dates: where the days are from, "file names" or "modification times".
        treatment: that all logs have, as the study's own logs propose it.
        entries: one for each log, by device and day.
        confidence: family-wise level of the tests of drift.
    """

    name: str
    dates: str
    treatment: Treatment
    entries: tuple[FleetEstimate, ...]
    confidence: float = LEVEL

    @property
    def failed(self) -> tuple[FleetEstimate, ...]:
        """The logs that gave nothing."""
        return tuple(one for one in self.entries if one.error)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return next((one.names for one in self.entries if not one.error), ())

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Of the parameters."""
        return next((one.units for one in self.entries if not one.error), ())

    @cached_property
    def trends(self) -> tuple[FleetTrend, ...]:
        """One for each device with a log that counts."""
        groups: dict[str, list[FleetEstimate]] = {}
        for one in self.entries:
            if not one.error:
                groups.setdefault(one.log.device, []).append(one)
        return tuple(_trend(device, group) for device, group in groups.items())

    @cached_property
    def drift_p(self) -> Array:
        """p-values of all slopes with Holm's correction over devices and parameters, (devices, k)."""
        tests = [
            np.where(np.isfinite(trend.of_slope("se")), two_sided(*_known(trend)), 1.0)
            if trend.logs >= _LEAST_LOGS
            else np.ones(len(self.names))
            for trend in self.trends
        ]
        p = np.array(tests).reshape(len(self.trends), len(self.names))
        return holm_adjusted(p.ravel()).reshape(p.shape)

    @cached_property
    def distance(self) -> Array:
        """Distance of each mean from the devices' median in robust standard deviations, (devices, k).

        Zero where it is within its own interval, and with fewer than four devices. The spread of a few means may be
        small by chance: it is taken as no less than their own standard error.
        """
        means = np.array([trend.of_mean("values") for trend in self.trends]).reshape(len(self.trends), len(self.names))
        if len(means) < _LEAST_DEVICES:
            return np.zeros(means.shape)
        away = means - np.nanmedian(means, axis=0)
        se = np.array([trend.of_mean("se") for trend in self.trends])
        half = np.array([half_width(own, [one.dof for one in t.mean]) for own, t in zip(se, self.trends, strict=True)])
        spread = np.maximum(_NORMAL_MAD * np.nanmedian(np.abs(away), axis=0), np.nanmedian(se, axis=0))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(np.abs(away) > half, np.nan_to_num(away / spread, posinf=np.inf, neginf=-np.inf), 0.0)

    @cached_property
    def ranked(self) -> tuple[int, ...]:
        """Devices, as indices of `trends`: those that drift by the surest, then those that differ by the furthest."""
        surest = self.drift_p.min(axis=1, initial=1.0)
        furthest = np.abs(self.distance).max(axis=1, initial=0.0)
        drifts, differs = surest < 1 - self.confidence, furthest > _UNUSUAL
        keys = (np.where(differs, -furthest, 0.0), ~differs, np.where(drifts, surest, 1.0), ~drifts)
        return tuple(np.lexsort(keys).tolist())  # by name where they are alike, as they come

    @property
    def sentences(self) -> tuple[str, ...]:
        """What failed, drifts and differs, the most significant first."""
        return (*self._failures(), *self._misfits(), *self._drifts(), *self._unusual())

    @cached_property
    def misfits(self) -> tuple[FleetEstimate, ...]:
        """The logs whose fits are worse than those of the others, the worst first.

        Logarithms of errors further above their median than 3.5 robust standard deviations, and errors above twice the
        median: in such a log the model does not hold, and its parameters count in means and drift like all others.
        """
        if len(self._fits) < _LEAST_FITS:
            return ()
        size = np.log([one.error_percent for one in self._fits])
        away = size - np.median(size)
        limit = max(_UNUSUAL * _NORMAL_MAD * float(np.median(np.abs(away))), float(np.log(_WORSE)))
        return tuple(self._fits[k] for k in np.argsort(-away) if away[k] > limit)

    @cached_property
    def _fits(self) -> tuple[FleetEstimate, ...]:
        return tuple(one for one in self.entries if not one.error and one.error_percent > 0)

    def _failures(self) -> Iterator[str]:
        good, devices = len(self.entries) - len(self.failed), len({one.log.device for one in self.entries})
        yield f"{good} of {len(self.entries)} logs of {devices} devices are identified; days by their {self.dates}."
        for one in self.failed[:5]:
            yield f"{one.log.device}/{one.log.path.name}: {one.error}"
        if len(self.failed) > 5:
            yield f"{len(self.failed) - 5} more logs failed: logs.csv has their errors."

    def _misfits(self) -> Iterator[str]:
        usual = np.median([one.error_percent for one in self._fits] or [0.0])
        for one in self.misfits[:5]:
            yield (
                f"{one.log.device}/{one.log.path.name}: the error of its fit is {one.error_percent:.3g} %, in the "
                f"median of the logs {usual:.3g} %. Its parameters may be wrong, and count in the means of "
                f"{one.log.device}: find out why (haptid advise), and take it out of the folder if nothing repairs it."
            )
        if len(self.misfits) > 5:
            yield f"{len(self.misfits) - 5} more logs fit badly: logs.csv has their errors."

    def _drifts(self) -> Iterator[str]:
        found = np.argwhere(self.drift_p < 1 - self.confidence)
        for d, k in found[np.argsort(self.drift_p[tuple(found.T)])][:10]:
            trend = self.trends[d]
            slope, se = trend.of_slope("values")[k], trend.of_slope("se")[k]
            half = float(half_width(se, trend.dof[k], self.confidence))
            yield (
                f"{trend.device}: {self.names[k]} drifts by {slope:.3g} {self.units[k]} in a day "
                f"(interval {slope - half:.2g} .. {slope + half:.2g}, p = {self.drift_p[d, k]:.1e})."
            )
        if not len(found):
            told = sum(trend.logs >= _LEAST_LOGS and np.isfinite(trend.of_slope("se")).any() for trend in self.trends)
            if told:
                yield f"No parameter drifts at {100 * self.confidence:g} % confidence for all {told} devices together."
            else:
                yield f"Drift is not told: no device has {_LEAST_LOGS} logs of different times."
        elif len(found) > 10:
            yield f"{len(found) - 10} more parameters drift: devices.csv has them."

    def _unusual(self) -> Iterator[str]:
        found = np.argwhere(np.abs(self.distance) > _UNUSUAL)
        for d, k in found[np.argsort(-np.abs(self.distance[tuple(found.T)]))][:10]:
            means = [trend.of_mean("values")[k] for trend in self.trends]
            yield (
                f"{self.trends[d].device} is unusual: {self.names[k]} is {means[d]:.3g}, the median of the devices "
                f"{np.nanmedian(means):.3g} {self.units[k]}."
            )
        if len(found) > 10:
            yield f"{len(found) - 10} more means are unusual: devices.csv has them."
        if len(self.trends) < _LEAST_DEVICES:
            yield (
                f"Whether a device is unusual is not told: {_LEAST_DEVICES} devices are needed, and {len(self.trends)} "
                "have logs that count. Two results of haptid identify are compared by haptid compare."
            )

    def log_table(self) -> list[list[str]]:
        """Every log: device, file, day, status, error of the fit, parameters and standard errors."""
        heads = [head for name in self.names for head in (name, f"se {name}")]
        rows = [["device", "log", "recorded", "status", "error of the fit, %", *heads, "problem"]]
        for one in self.entries:
            when = datetime.fromtimestamp(one.log.day * SECONDS_IN_DAY, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            pairs = [f"{x:.9g}" for pair in zip(one.values, one.se, strict=True) for x in pair] or [""] * len(heads)
            error = "" if one.error else f"{one.error_percent:.4g}"
            rows.append([one.log.device, one.log.path.name, when, one.status, error, *pairs, one.error])
        return rows

    def device_table(self) -> list[list[str]]:
        """Every device and parameter: mean, spread between logs, drift, and distance; devices as `ranked`."""
        head = "device,logs,parameter,unit,mean,se,between logs,slope in a day,se of the slope,p (Holm),distance"
        rows = [head.split(",")]
        for d in self.ranked:
            trend = self.trends[d]
            for k, name in enumerate(self.names):
                numbers = (
                    trend.of_mean("values")[k],
                    trend.of_mean("se")[k],
                    trend.mean[k].between,
                    trend.of_slope("values")[k],
                    trend.of_slope("se")[k],
                    self.drift_p[d, k],
                    self.distance[d, k],
                )
                cells = [f"{x:.6g}" if np.isfinite(x) else "" for x in numbers]
                rows.append([trend.device, str(trend.logs), name, self.units[k], *cells])
        return rows

    def summary(self) -> str:
        """A table of the devices: logs, drifting and unusual parameters, as `ranked`; then the sentences."""
        rows = [["device", "logs", "drifting", "unusual"]]
        for d in self.ranked[:_SHOWN]:
            trend, p, away = self.trends[d], self.drift_p[d], self.distance[d]
            drifting = [name for name, one in zip(self.names, p, strict=True) if one < 1 - self.confidence]
            odd = [name for name, one in zip(self.names, away, strict=True) if abs(one) > _UNUSUAL]
            told = trend.logs >= _LEAST_LOGS and bool(np.isfinite(trend.of_slope("se")).any())
            compared = len(self.trends) >= _LEAST_DEVICES
            cells = [listed(drifting, 4) or ("-" if told else "?"), listed(odd, 4) or ("-" if compared else "?")]
            rows.append([trend.device, str(trend.logs), *cells])
        more = len(self.trends) - _SHOWN
        return "\n".join(
            [*aligned(rows), *([f"{more} more devices: devices.csv"] if more > 0 else []), "", *self.sentences]
        )


@dataclass(frozen=True)
class _OneLog:
    """Identification of one log, sent to the workers once."""

    study: Study
    proposal: Proposal

    @cached_property
    def _model(self) -> DynamicModel:
        return DynamicModel(read_device(self.study.device))

    def __call__(self, log: FleetLog) -> FleetEstimate:
        entry = replace(self.study.logs[0], path=str(log.path), time_range=None, episodes=None, exclude=())
        try:
            recorded = read_entry(entry, Path(), silent)
            observation = observe(self._model, treat(recorded, self.proposal.carried_by(recorded)))
            found = estimate(observation, self.study.method, self.study.intervals)
            found = with_all_uncertainty(found, self.proposal, None)
            return _entry(log, found)
        except HaptidError as error:
            return FleetEstimate(log, error=" ".join(str(error).split()))


def _entry(log: FleetLog, found: Estimate) -> FleetEstimate:
    free = found.unconstrained
    (motion,) = found.observation.motions
    sha = motion.log.sha256 if motion.log else ""
    percent = fit_errors(found, found.observation).relative
    return FleetEstimate(log, "", found.status, percent, free.names, free.units, free.values, free.se, free.dof, sha)


def identify_fleet(
    study: Study,
    folder: Path,
    data: str | Path | None = None,
    progress: _Progress | None = None,
    workers: Executor | None = None,
    kept: FleetResults | None = None,
) -> Fleet:
    """Identify every log below a folder by itself, with the device, channels, method and treatment of a study.

    All logs have the treatment that the study's own logs propose, so that estimates differ by the devices and not by
    filters. What it leaves uncertain, such as the delay, is theirs too: it is in every standard error, and since all
    logs share it, standard errors of a drift are upper bounds. A log that cannot be read or identified is an entry
    with its error, and stops nothing.

    Args:
        study: whose first log's channels all logs have.
        folder: see `fleet_logs`.
        data: where the study's relative log paths start; the study's own folder where None.
        progress: called with the name of a step and the share of it done.
        workers: executor of the logs; this process where None.
        kept: results of an interrupted run, to which those of this one are added; of files with the same content, and
            of the same study, device and version of haptid, they are not computed again.

    Raises:
        HaptidError: any error of the study and of its own logs; the folder has no logs.
    """
    progress = progress or silent
    check_kind(study)
    model = DynamicModel(read_device(study.device))
    if study.calibration is not None or model.device.searched or any(entry.body for entry in study.logs):
        raise fault(
            study.path,
            "device" if model.device.searched else "logs",
            "has nonlinear constants, zeros of encoders or payloads to find, which a fleet does not",
            advice="Fix them in the device file, or identify each log by itself and compare the results.",
        )
    study = study.on(model.device)
    logs, dates = fleet_logs(folder)
    own = [read_entry(entry, Path(data or study.path.parent), progress) for entry in study.logs]
    progress("choosing a treatment", 0.0)
    proposal = propose(model, *logs_to_propose_from(study, own), **study.treatment)
    key, found = fleet_fingerprint(study, model, own, proposal.treatment), dict[int, FleetEstimate]()
    if kept is not None and kept.count():
        before = (FleetEstimate.of_kept(log, kept.read(key, log.path)) for log in logs)
        found |= {k: one for k, one in enumerate(before) if one is not None}
    missing = [k for k in range(len(logs)) if k not in found]
    work = _OneLog(study, proposal)
    for k, entry in (workers or SerialExecutor()).map(work, [logs[k] for k in missing]):
        found[missing[k]] = entry
        if kept is not None and entry.sha256:
            kept.write(key, entry.sha256, entry.to_keep())
        progress("identifying logs", len(found) / len(logs))
    return Fleet(study.name, dates, proposal.treatment, tuple(found[k] for k in range(len(logs))))


def _trend(device: str, group: Sequence[FleetEstimate]) -> FleetTrend:
    days = np.array([one.log.day for one in group])
    ones = np.ones((len(group), 1))
    line = np.column_stack([ones, days - days.mean()])
    values, se, dof = (np.array([getattr(one, name) for one in group]) for name in ("values", "se", "dof"))
    if len(group) == 1:  # its mean is that of the log
        mean = tuple(RandomEffects(*one, np.nan) for one in zip(values.T, se.T, dof[0], strict=True))
    else:
        mean = tuple(random_effects(v, s, ones) for v, s in zip(values.T, se.T, strict=True))
    slope = tuple(random_effects(v, s, line) for v, s in zip(values.T, se.T, strict=True))
    return FleetTrend(device, len(group), mean, slope)


def _known(trend: FleetTrend) -> tuple[Array, Array, Array]:
    """Slopes with their standard errors and degrees of freedom, undetermined ones as zero."""
    slope, se = trend.of_slope("values"), trend.of_slope("se")
    known = np.isfinite(se)
    return np.where(known, slope, 0.0), np.where(known, se, 1.0), np.where(known, trend.dof, 1.0)
