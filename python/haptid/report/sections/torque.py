"""Measured and predicted torque by log and motor, and a table of the errors."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from haptid._internal.late import dataclass
from haptid.report.chart import MEASURED, PREDICTED, RESIDUAL, Chart, axis, envelope, figure, plot, shaded
from haptid.report.section import Section
from haptid.report.source import ReportSource, Track
from haptid.validation.validation import MotorError, Validation

# Bins of all curves together, and the limits for one curve: a file stays well below 15 MB.
ALL_BINS, MOST_BINS, _LEAST_BINS = 60_000, 6000, 400


@dataclass(frozen=True)
class TorqueSection(Section):
    """Torque along time.

    Attributes:
        logs: for each log its name, kind of rows, a sentence on the resolution, and the indices of its charts.
    """

    key: ClassVar[str] = "torque"
    title: ClassVar[str] = "Measured and predicted torque"
    logs: list[dict[str, Any]]

    @classmethod
    def of(cls, source: ReportSource) -> TorqueSection:
        curves = sum(len(track.labels) for track in source.tracks)
        bins = int(np.clip(ALL_BINS // curves, _LEAST_BINS, MOST_BINS))
        charts: list[Chart] = []
        logs = []
        for k, track in enumerate(source.tracks):
            own = [chart for motor in track.motors_used for chart in _charts(track, k, motor, bins)]
            logs.append(
                {
                    "name": track.name,
                    "seen": track.seen,
                    "kind": track.kind,
                    "drawn": _drawn(track, bins),
                    "charts": list(range(len(charts), len(charts) + len(own))),
                }
            )
            charts += own
        return cls(charts=tuple(charts), logs=logs)


def _drawn(track: Track, bins: int) -> str:
    """Resolution of the curves, in a sentence."""
    width = -(-track.rows // bins)
    if width <= 2:
        return f"All {track.rows} treated rows are drawn."
    return (
        f"Of {track.rows} treated rows the minimum and maximum of every {width} ({width * track.step:.3g} s) are "
        f"drawn: no peak is lost."
    )


def _charts(track: Track, k: int, motor: int, bins: int) -> tuple[Chart, Chart]:
    """Torque of one motor and its residual; the time axes of a log are linked."""
    label, unit = track.labels[motor], track.units[motor]
    measured, predicted, residual = track.measured[motor], track.predicted[motor], track.residual[motor]
    shade = shaded(track.t0, track.step, ~track.used[motor], bins)
    time, group = axis("time", "s"), f"log-{k}"
    torque = [
        envelope("measured", MEASURED, track.t0, track.step, measured, bins) | {"width": 4.2},
        envelope("predicted", PREDICTED, track.t0, track.step, predicted, bins) | {"width": 1.8},
    ]
    left = [envelope("residual", RESIDUAL, track.t0, track.step, residual, bins)]
    rms, size = (float(np.sqrt(np.nanmean(y**2))) for y in (residual, measured))
    used = 100 * float(track.used[motor].mean())
    caption = (
        f"RMS of the measured torque {figure(size)} {unit}, of the residual {figure(rms)} {unit}; largest residual "
        f"{figure(float(np.nanmax(np.abs(residual))))} {unit}. {used:.0f} % of {track.rows} rows are used"
        + ("; grey: unused rows." if shade else ".")
    )
    alt = f"Torque of {label} against time, measured and predicted, {track.kind} of {track.name}."
    return (
        Chart(
            f"torque-{k}-{motor}",
            f"{label}: torque",
            alt,
            caption,
            plot(time, axis("torque", unit), torque, group=group, height=190, shade=shade, zoom=True),
        ),
        Chart(
            f"residual-{k}-{motor}",
            f"{label}: residual",
            f"Measured minus predicted torque of {label} against time, {track.name}.",
            f"RMS {figure(rms)} {unit}, {100 * rms / size if size else 0:.2f} % of the torque's.",
            plot(time, axis("residual", unit), left, group=group, height=120, shade=shade, zoom=True),
        ),
    )


@dataclass(frozen=True)
class ErrorsSection(Section):
    """The table of errors.

    Attributes:
        motors: labels.
        rows: for each validation the log, the kind of rows, the error over all motors and of each, per cent.
        rmse: for each of the same rows the RMSE of each motor with its unit.
    """

    key: ClassVar[str] = "errors"
    title: ClassVar[str] = "Errors"
    motors: list[str]
    rows: list[dict[str, Any]]

    @classmethod
    def of(cls, source: ReportSource) -> ErrorsSection:
        runs = source.identification.runs
        pairs = [(run.entry.path, v) for run in runs for v in (run.fit_errors, *run.unseen) if v is not None]
        labels = [motor.label for motor in runs[0].observation.motors]
        rows = [_errors(path, v) for path, v in pairs]
        rows += [_errors(path, v.reference, reference=True) for path, v in pairs if v.reference is not None]
        return cls(charts=(), motors=labels, rows=rows)


def _errors(path: str, validation: Validation, reference: bool = False) -> dict[str, Any]:
    return {
        "log": path,
        "seen": validation.seen,
        "all_rows": reference,
        "relative": validation.relative,
        "each": [_error(motor) for motor in validation.motors],
    }


def _error(motor: MotorError) -> dict[str, Any]:
    return {"relative": motor.relative, "rmse": motor.rmse, "unit": motor.unit, "rows": motor.rows}
