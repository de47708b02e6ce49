"""The page of exciting motions: each over time within its limits, and what is known of the parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import inverse_dynamics
from haptid.experiment.bench.picture import stick_figure
from haptid.experiment.excitation import Excitation, FurtherMotions, PlannedMotion
from haptid.report.chart import Chart, axis, chart_series, figure, packed, plot
from haptid.report.document import DocumentSection, TextTable, panels
from haptid.report.page import page
from haptid.report.section import PageSection
from haptid.report.sections.mechanism import scene, sliders_of

# Samples of each curve; instants at which the links are drawn, of all motions together.
_SAMPLES, _INSTANTS = 800, 120
# How much further apart than along the motion shapes are looked for, m: the motion is looked at in steps.
_NEAR = 1e-3


def motion_page(motions: Mapping[str, PlannedMotion], further: FurtherMotions | None = None) -> str:
    """An HTML document: positions, velocities, accelerations and torques of each motion within their limits.

    Args:
        motions: by name, at least one, of one device.
        further: the campaign that they belong to; without one, the first motion of the search is compared with the one
            that was found.
    """
    sections: list[PageSection] = [_swept(motions)]
    searched = [motion for motion in motions.values() if isinstance(motion, Excitation)]
    if searched:
        sections.append(_information(searched[0], further))
    for k, (name, motion) in enumerate(motions.items()):
        sections += _motion(motion, k, "The motion" if len(motions) == 1 else name)
    device = next(iter(motions.values())).model.device
    about = f"{len(motions)} motion{'s' if len(motions) > 1 else ''} of {device.name}"
    return page(f"Planned motion: {device.name}", about, sections)


@dataclass(frozen=True)
class _SweptSection:
    """The device in three dimensions with all places that its links come to; sliders move it."""

    template: ClassVar[str] = "swept"
    key: ClassVar[str] = "swept"
    title: ClassVar[str] = "In three dimensions"
    joints: list[dict[str, Any]]
    text: tuple[str, ...]
    charts: tuple[Chart, ...]


def _swept(motions: Mapping[str, PlannedMotion]) -> _SweptSection:
    """Stick figures and collision shapes at instants of all motions, and where shapes come nearest in each."""
    bounds = next(iter(motions.values())).bounds
    model, collision = bounds.model, bounds.collision
    positions = [motion.trajectory(motion.seconds / _SAMPLES).q for motion in motions.values()]
    drawn = np.concatenate(positions)[:: max(1, sum(map(len, positions)) // _INSTANTS)]
    bars = stick_figure(model, drawn)[0].reshape(-1, 2, 3)
    widths = np.zeros(len(bars))
    text = ["Blue: the links along all motions. The sliders move the device; they change no motion."]
    if collision is not None:
        axes, radii = collision.capsules(model.device.closure.positions(drawn.T).T)
        bars = np.concatenate([bars, axes.reshape(-1, 2, 3)])
        widths = np.concatenate([widths, 2 * np.tile(radii, len(drawn))])
        text[0] += " Collision shapes are drawn as the capsules about them."
    near = {name: _nearest(motion) for name, motion in motions.items()}
    text += [f"Red, {name}: {motion.clearance}." for name, motion in motions.items() if near[name] is not None]
    sliders = sliders_of(model, np.concatenate(positions).T, margin=0.0)
    lines = [ends for ends in near.values() if ends is not None]
    return _SweptSection(sliders, tuple(text), (scene(model, None, positions[0].T, sliders, (bars, widths), lines),))


def _nearest(motion: PlannedMotion) -> Array | None:
    """The nearest points of the two shapes that come nearest in a motion, (2, 3), m; None without shapes."""
    collision, least = motion.bounds.collision, motion.clearance
    if collision is None or least is None:
        return None
    trajectory = motion.trajectory(1e-3)
    q = trajectory.q[min(round(least.time / trajectory.dt), len(trajectory) - 1)]
    distances = collision.near(motion.model.device.closure.positions(q[:, None]).T, least.distance + _NEAR)
    if not len(distances.distance):
        return None
    k = int(np.argmin(distances.distance))
    return np.stack([distances.first[k], distances.second[k]])


def _information(excitation: Excitation, further: FurtherMotions | None) -> DocumentSection:
    """What is known of each parameter before and after."""
    if further is None:
        names, before, after = excitation.after.names, excitation.before.relative_se, excitation.after.relative_se
        heads = ("parameter", "first motion within the limits", "motion found")
        noise = ", ".join(dict.fromkeys(f"{x:.3g}" for x in excitation.noise.tolist()))
        assumed = f"white noise of {noise} N m (or N), which is assumed, in each of {excitation.after.rows} rows"
        text: tuple[str, ...] = (f"Relative standard error of each parameter, per cent of its value: {assumed}.",)
        label = "relative standard error"
    else:
        rows = further.table()
        names = tuple(name for name, _, _ in rows)
        before, after = (np.array([row[k] for row in rows]) for k in (1, 2))
        heads = ("parameter", "logs so far", "with the motion")
        text = ("Half width of the 95 % interval of each parameter, per cent of its value.", *further.sentences)
        label = "half width of the interval"
    order = np.argsort(-np.nan_to_num(after, posinf=1e300), kind="stable")
    cells = [heads, *((names[k], *(figure(float(x[k])) for x in (before, after))) for k in order.tolist())]
    place = np.arange(1, len(names) + 1, dtype=float)
    drawn = [
        chart_series(name, "points", colour, x=packed(place), y=packed(np.where(x[order] > 0, x[order], np.nan)))
        for name, colour, x in ((heads[1], "vermillion", before), (heads[2], "blue", after))
    ]
    drawing = plot(axis("parameter, in the order of the table"), axis(label, "%", log=True), drawn, height=240)
    caption = _largest(heads[1:], before, after)
    alt = f"{label} of each parameter, {heads[1]} and {heads[2]}."
    chart = Chart("information", "Information on each parameter", alt, caption, drawing)
    return DocumentSection("information", "Information", text, (TextTable("", cells),), (chart,))


def _largest(heads: tuple[str, ...], before: Array, after: Array) -> str:
    """The largest figures of those that are known, and how many are not: without a prior value there is no per cent."""
    known = np.isfinite(before) & np.isfinite(after)
    unknown = f" {np.count_nonzero(~known)} of {len(known)} are unknown." if not known.all() else ""
    if not known.any():
        return unknown.strip()
    largest = (f"{head} {figure(float(x[known].max()))} %" for head, x in zip(heads, (before, after), strict=True))
    return f"Largest: {', '.join(largest)}.{unknown}"


def _motion(motion: PlannedMotion, k: int, title: str) -> Iterator[DocumentSection]:
    """One motion over time."""
    bounds, device = motion.bounds, motion.model.device
    trajectory = motion.trajectory(motion.seconds / _SAMPLES)
    joints = [device.joints[j] for j in device.active]
    labels = [f"joint {joint.name}" for joint in joints]
    units = ["m" if joint.prismatic else "rad" for joint in joints]
    tau = inverse_dynamics(
        motion.model, bounds.beta, *(np.ascontiguousarray(x.T) for x in (trajectory.q, trajectory.qd, trajectory.qdd))
    )
    charts: list[Chart] = []
    for key, quantity, values, limits, per in (
        ("q", "Position", trajectory.q.T, bounds.position, ""),
        ("qd", "Velocity", trajectory.qd.T, _both(bounds.speed), "/s"),
        ("qdd", "Acceleration", trajectory.qdd.T, _both(bounds.acceleration), "/s^2"),
    ):
        for j, label in enumerate(labels):
            charts += _panel(f"{key}-{k}-{j}", quantity, label, f"{units[j]}{per}", trajectory.t, values[j], limits[j])
    for j, (label, unit) in enumerate(zip(device.row_labels, device.torque_units, strict=True)):
        limit = _both(bounds.actuation.torque)[j]
        charts += _panel(f"tau-{k}-{j}", "Torque", label, unit, trajectory.t, tau[j], limit)
    text = [f"{motion.seconds:.4g} s."]
    if isinstance(motion, Excitation):
        raw, scaled = motion.after.raw, motion.after.scaled
        text = [
            f"{motion.seconds:.4g} s, {motion.tried} motions evaluated, condition number {raw:.4g}, "
            f"{scaled:.4g} with unit columns."
        ]
    if motion.clearance is not None:
        text.append(f"{motion.clearance}.")
    yield DocumentSection(f"motion-{k + 1}", title, tuple(text), (), tuple(charts))


def _both(most: Array) -> Array:
    """Lower and upper limits, (n, 2)."""
    return np.column_stack([-most, most])


def _panel(key: str, title: str, label: str, unit: str, t: Array, values: Array, limits: Array) -> list[Chart]:
    """A curve with its limits, where it has some."""
    curves = {"planned": ("blue", values[None])}
    for name, limit in zip(("lower limit", "upper limit"), limits.tolist(), strict=True):
        if np.isfinite(limit):
            curves[name] = ("vermillion", np.full((1, len(t)), limit))
    return panels(key, title, [label], unit, t, curves)
