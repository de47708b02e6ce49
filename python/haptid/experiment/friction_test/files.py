"""A friction test written down: its points, the models that were compared, and a picture of both."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from haptid._internal.arrays import Array
from haptid.experiment.friction_test.choice import MODELS, FrictionChoice, FrictionFit, JointChoice
from haptid.experiment.friction_test.curve import FrictionCurve, JointFriction

# Colours that colour-blind readers tell apart (Okabe and Ito 2008): points, the model that is used, others.
POINTS, CHOSEN, OTHERS = "#000000", "#0072B2", ("#E69F00", "#009E73", "#CC79A7")
# Points of a drawn curve in each direction.
DRAWN = 200


def model_torque(fit: FrictionFit, v: Array) -> Array:
    """Torque of a fitted model at velocities, (n,), N m or N."""
    friction_model = next(one for one in MODELS if one.name == fit.friction_model)
    beta = np.array([fit.values[name] for name in friction_model.parameters])
    return np.asarray(friction_model.columns(v, fit.values.get("VS", 1.0)) @ beta)


def write_points(curve: FrictionCurve, path: Path) -> None:
    """Write the curves' points as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["joint", "velocity", "torque", "sd", "low95", "high95", "unit"])
        for joint in curve.joints:
            for v, tau, se, (low, high) in zip(joint.velocity, joint.torque, joint.se, joint.interval95, strict=True):
                table.writerow([joint.label, *(float(x) for x in (v, tau, se, low, high)), joint.unit])


def choice_values(choice: FrictionChoice) -> dict[str, Any]:
    """The comparison as plain values: `friction.json`."""
    return {
        "criterion": "AICc: n ln(S / n) + 2 K + 2 K (K + 1) / (n - K - 1); a larger model must be lower by 2",
        "viscous_and_coulomb_are_enough": choice.enough,
        "joints": [
            {
                "joint": joint.label,
                "chosen": joint.chosen.friction_model,
                "models": [_fit_values(fit) for fit in joint.fits],
            }
            for joint in choice.joints
        ],
    }


def _fit_values(fit: FrictionFit) -> dict[str, Any]:
    return {
        "model": fit.friction_model,
        "values": fit.values,
        "interval95": {name: list(ends) for name, ends in fit.intervals.items()},
        "aicc": fit.aicc if math.isfinite(fit.aicc) else None,
        "relative_error_percent": fit.error,
    }


def plot_friction(curve: FrictionCurve, choice: FrictionChoice, title: str, path: Path) -> None:
    """One panel for each joint: points with their intervals, the model that is used, and the others thin."""
    figure = Figure(figsize=(1.0 + 4.0 * len(curve.joints), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, parse_math=False)
    panels = np.atleast_1d(figure.subplots(1, len(curve.joints)))
    for panel, joint, made in zip(panels, curve.joints, choice.joints, strict=True):
        _draw(panel, joint, made)
    panels[0].legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _draw(panel: Axes, joint: JointFriction, made: JointChoice) -> None:
    low, high = joint.interval95.T
    errors = [joint.torque - low, high - joint.torque]
    panel.errorbar(joint.velocity, joint.torque, errors, fmt=".", color=POINTS, capsize=2, label="measured", zorder=3)
    fastest = float(np.abs(joint.velocity).max())
    colours = iter(OTHERS)
    for fit in made.fits:
        used = fit is made.chosen
        style: dict[str, Any] = (
            {"color": CHOSEN, "linewidth": 1.8} if used else {"color": next(colours), "linewidth": 0.8}
        )
        for k, sign in enumerate((-1.0, 1.0)):
            v = sign * np.linspace(fastest * 1e-3, fastest, DRAWN)
            panel.plot(v, model_torque(fit, v), label=None if k else fit.friction_model, **style)
    panel.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
    panel.set_title(f"{joint.label}: {made.chosen.friction_model}", fontsize="medium", parse_math=False)
    panel.set_xlabel("velocity, " + ("m/s" if joint.unit == "N" else "rad/s"))
    panel.set_ylabel(f"friction, {joint.unit}")
    panel.grid(alpha=0.3)
