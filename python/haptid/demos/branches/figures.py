"""The paper's figures of two branches, with the demonstration's own numbers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from haptid.demos.branches.finding import Results
from haptid.demos.branches.fits import FrictionTest
from haptid.demos.branches.plan import Drawn, Sweep
from haptid.demos.drawing import BLACK, BLUE, GREEN, ORANGE, picture
from haptid.demos.kind import Tell
from haptid.validation.prediction import predict

# One colour for each mass, largest first; one style of line for each branch.
COLOURS, STYLES = (BLUE, ORANGE, GREEN), ("-", "--", ":", "-.")


def draw_all(found: Results, folder: Path, tell: Tell) -> None:
    """Friction tests, torques, masses along the sweeps, and compensation."""
    jobs: list[tuple[str, Callable[[Path], None]]] = [
        ("friction.png", partial(draw_friction, found)),
        *((drawn.file, partial(draw_torque, found, drawn)) for drawn in found.demo.drawn),
        ("fig07.png", partial(draw_sweeps, found)),
        ("compensation.png", partial(draw_compensation, found)),
    ]
    for k, (name, draw) in enumerate(jobs):
        tell("drawing", k / len(jobs))
        draw(folder / name)
    tell("drawing", 1.0)


def draw_friction(found: Results, path: Path) -> None:
    """Friction torque against velocity, one panel for each motor."""
    figure = picture("Friction at constant velocities", (10, 3.6))
    first = next(iter(found.friction.values()))
    panels = figure.subplots(1, len(first.curve.joints), sharey=True)
    for (key, test), colour in zip(found.friction.items(), (BLUE, ORANGE), strict=False):
        _friction(panels, test, found.found[key].branch.title, colour)
    for panel, joint in zip(panels, first.curve.joints, strict=True):
        panel.set_title(joint.label, fontsize="medium")
        panel.set_xlabel("velocity, rad/s")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel(f"friction torque, {first.curve.joints[0].unit}")
    panels[0].legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _friction(panels: np.ndarray, test: FrictionTest, title: str, colour: str) -> None:
    for panel, joint in zip(panels, test.curve.joints, strict=True):
        low, high = joint.conf_int().T
        panel.errorbar(
            joint.velocity,
            joint.torque,
            yerr=[joint.torque - low, high - joint.torque],
            fmt="o",
            markersize=3,
            capsize=2,
            color=colour,
            label=title,
        )


def draw_torque(found: Results, drawn: Drawn, path: Path) -> None:
    """Measured and predicted torque of one motor, and the error below."""
    one = found.found[drawn.branch]
    made = predict(one.reduced, one.unseen if drawn.unseen else one.fit)
    row, shown = one.model.device.row_names.index(drawn.motor), made.t < made.t[0] + drawn.seconds
    t, measured, predicted = made.t[shown], made.measured[row, shown], made.predicted[row, shown]
    figure = picture(drawn.title, (10, 5.2))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.5, 1))
    upper.plot(t, measured, color=BLACK, linewidth=2.0, label="measured")
    upper.plot(t, predicted, color=BLUE, linewidth=1.2, label="predicted")
    upper.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize="small", frameon=False)
    upper.set_ylabel(f"torque of {made.motors[row]}, {made.units[row]}")
    error, used = measured - predicted, made.used[row, shown]
    lower.plot(t, error, color="0.7", linewidth=1.0, label="at reversals")
    lower.plot(t, np.where(used, error, np.nan), color=ORANGE, linewidth=1.2, label="rows that count")
    lower.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2, fontsize="small", frameon=False)
    lower.set_ylabel(f"error, {made.units[row]}")
    lower.set_xlabel("time, s")
    for panel in (upper, lower):
        panel.margins(x=0)
        panel.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def draw_sweeps(found: Results, path: Path) -> None:
    """Masses along the published sweeps with their intervals; published ranges are shaded."""
    figure = picture("Fig. 7: masses that the hand feels; shaded: ranges of the published figure", (10, 5.0))
    panels = figure.subplots(1, len(found.demo.sweeps), sharey=True)
    for panel, sweep in zip(np.atleast_1d(panels), found.demo.sweeps, strict=True):
        for (low, high), colour in zip(sweep.published, COLOURS, strict=True):
            panel.axhspan(low, high, color=colour, alpha=0.13, linewidth=0)
        _masses(panel, found, sweep)
        panel.set_title(sweep.title, fontsize="medium")
        panel.set_xlabel(sweep.label)
        panel.set_ylim(bottom=0)
        panel.margins(x=0)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("apparent mass, kg")
    panels[-1].legend(fontsize="small", loc="upper left")
    figure.savefig(path, dpi=120)


def _masses(panel: Axes, found: Results, sweep: Sweep) -> None:
    for style, (key, handle) in zip(STYLES, found.handles.items(), strict=False):
        mass = handle.sweeps[sweep.key].mass
        band = mass.conf_int()
        for k, colour in enumerate(COLOURS):
            label = found.found[key].branch.title if k == 0 else None
            panel.plot(sweep.plotted, mass.values[:, k], color=colour, linestyle=style, label=label)
            if band is not None:
                panel.fill_between(sweep.plotted, *band[:, k].T, color=colour, alpha=0.3, linewidth=0)


def draw_compensation(found: Results, path: Path) -> None:
    """Largest mass along a sweep, without the law, with it, and as promised."""
    made, asked = found.compensated, found.demo.compensation
    sweep = found.demo.sweep(asked.sweep)
    mass = found.handles[asked.branch].sweeps[sweep.key].mass.values[:, 0]
    figure = picture(f"Largest mass that a hand feels at {asked.shaken_hz:g} Hz on the bench", (7, 4.2))
    panel = figure.subplots()
    panel.plot(sweep.plotted, mass, color=BLACK, linewidth=1.0, label="model")
    panel.plot(made.degrees, made.before, "o", color=BLUE, label="felt, weight carried")
    panel.plot(made.degrees, made.promised, "_", color=BLACK, markersize=14, label="promised with the law")
    panel.plot(
        made.degrees, made.after, "s", color=ORANGE, label=f"felt, {100 * asked.share:.0f} % of the mass carried"
    )
    panel.plot(made.degrees, made.even, "^", color=GREEN, label=f"felt, towards {made.target:.2f} kg")
    panel.set_xlabel(sweep.label)
    panel.set_ylabel("mass, kg")
    panel.set_ylim(bottom=0)
    panel.grid(alpha=0.3)
    panel.legend(fontsize="small")
    figure.savefig(path, dpi=120)
