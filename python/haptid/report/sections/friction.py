"""Friction of each joint: the model's curve and the measured friction torque."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import core_torque, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.end_effector.torque_decomposition import TorqueDecomposition
from haptid.errors import LogTimeError, MissingAccelerationError, NoRowsError
from haptid.experiment.friction_test.curve import JointFriction, friction_curve
from haptid.report.chart import PREDICTED, RESIDUAL, Chart, axis, chart_series, figure, packed, plot, quantised
from haptid.report.section import Section
from haptid.report.sections.residual import CLOUD, binned
from haptid.report.source import ReportSource, Track

# Points of the model's curve.
_POINTS = 201


@dataclass(frozen=True)
class FrictionSection(Section):
    """Friction curves."""

    key: ClassVar[str] = "friction"
    title: ClassVar[str] = "Friction"

    @classmethod
    def of(cls, source: ReportSource) -> FrictionSection | None:
        pairs = [(t, d) for t, d in zip(source.tracks, source.decompositions, strict=True) if d is not None]
        model = source.estimate.model
        resisted = any(term.resists for term in model.terms)
        if not pairs or not resisted:
            return None
        steady = list(_steady(source))
        used = sorted({motor for track, _ in pairs for motor in track.motors_used})
        charts = tuple(_chart(source, pairs, motor, steady) for motor in used)
        return cls(charts=charts)


def _steady(source: ReportSource) -> Iterator[JointFriction]:
    """Friction at constant velocities, where the logs contain such motion."""
    for run in source.identification.runs:
        try:
            yield from friction_curve(source.estimate.model, run.motion, source.estimate).joints
        except (NoRowsError, MissingAccelerationError, LogTimeError):  # the last one: a log with gaps
            continue


def _chart(
    source: ReportSource, pairs: list[tuple[Track, TorqueDecomposition]], motor: int, steady: list[JointFriction]
) -> Chart:
    """One motor: measured torque minus all modelled parts but friction, and the friction model."""
    first = pairs[0][0]
    label, unit, speed_unit = first.labels[motor], first.units[motor], f"{first.coordinate_units[motor]}/s"
    velocity = np.concatenate([track.velocity[motor][track.used[motor]] for track, _ in pairs])
    data = np.concatenate([(d.friction[motor] + track.residual[motor])[track.used[motor]] for track, d in pairs])
    some = np.linspace(0, len(data) - 1, min(len(data), CLOUD)).astype(int)
    centres, means = binned(velocity, data)
    speed, torque = model_curve(source, motor, float(np.abs(velocity).max()))
    curves = [
        chart_series("rows", "points", "sky", x=quantised(velocity[some]), y=quantised(data[some])),
        chart_series("mean of the rows", "line", RESIDUAL, x=packed(centres), y=packed(means), width=2.2),
        chart_series("model", "line", PREDICTED, x=packed(speed), y=packed(torque), width=2.2, dash="6 3"),
    ]
    points = [joint for joint in steady if joint.label == label]
    if points:
        curves.append(_points(points))
    top, ranges = float(torque[-1]), sum(len(p.velocity) for p in points)
    caption = (
        f"The model's friction is {figure(top)} {unit} at {figure(float(speed[-1]))} {speed_unit} and "
        f"{figure(float(torque[0]))} {unit} at the opposite velocity. Points: measured torque minus all modelled "
        f"parts but friction, {len(some)} of {len(data)} rows"
        + (
            f", and {ranges} time {'range' if ranges == 1 else 'ranges'} at constant velocity with 95 % intervals."
            if points
            else "."
        )
    )
    alt = f"Friction torque of {label} against velocity: rows, their mean, and the model's curve."
    drawing = plot(axis("velocity", speed_unit, zero=True), axis("friction", unit, zero=True), curves, height=240)
    return Chart(f"friction-{motor}", label, alt, caption, drawing)


def _points(frictions: list[JointFriction]) -> dict[str, object]:
    """Friction at constant velocities with 95 % intervals."""
    x, y = (np.concatenate([getattr(joint, name) for joint in frictions]) for name in ("velocity", "torque"))
    ends = np.concatenate([joint.conf_int() for joint in frictions])
    return chart_series(
        "constant velocity",
        "interval",
        "black",
        x=packed(x),
        y=packed(y),
        low=packed(ends[:, 0]),
        high=packed(ends[:, 1]),
    )


def model_curve(source: ReportSource, motor: int, fastest: float) -> tuple[Array, Array]:
    """Velocity of one motor's coordinate, the others at rest, and its friction at mid-log, (n,) each."""
    model, estimate = source.estimate.model, source.estimate
    row = int(np.flatnonzero(model.device.known)[motor])
    # An even number of points excludes zero, where friction is discontinuous.
    speed = np.linspace(-fastest, fastest, _POINTS - 1)
    trail = source.tracks[0].trail
    c = np.repeat(trail[:, trail.shape[1] // 2, None], len(speed), axis=1)
    cd = np.zeros_like(c)
    cd[row] = speed
    still = np.zeros_like(c)
    chi, own = friction_only(model, raw_parameters(model, estimate.beta)), external(model, c, cd, still)
    return speed, core_torque(model, chi, c, cd, still, own)[row]


def friction_only(model: DynamicModel, chi: Array) -> Array:
    """The friction parameters, all others zero, (r,)."""
    links = 10 * len(model.device.joints)
    is_friction = [False] * links + [term.resists for term in model.terms]
    return np.where(is_friction, chi, 0.0)
