"""Files of a friction test: points of the curves (CSV), model comparison (JSON values) and a plot."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.escaping import write_csv
from haptid._internal.extras import needing
from haptid.experiment.friction_test.choice import LARGER, MODELS, FrictionChoice, FrictionFit, JointChoice
from haptid.experiment.friction_test.curve import FrictionCurve, JointFriction

with needing("drawing pictures"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

# Colour-blind safe palette (Okabe and Ito 2008): points, the chosen model, others.
POINTS, CHOSEN, _OTHERS = "#000000", "#0072B2", ("#E69F00", "#009E73", "#CC79A7")
# Points per direction of a drawn curve.
DRAWN = 200


def model_torque(fit: FrictionFit, v: Array) -> Array:
    """Torque of a fitted model at velocities, (n,), N m or N."""
    friction_model = next(one for one in MODELS if one.name == fit.friction_model)
    return np.asarray(friction_model.columns(v, fit.values.get("VS", 1.0)) @ fit.parameters.values)


def write_points(curve: FrictionCurve, path: Path) -> None:
    """Write the points of the curves as CSV."""
    rows: list[list[object]] = [["joint", "velocity", "torque", "se", "ci_low", "ci_high", "unit"]]
    for joint in curve.joints:
        for v, tau, se, (low, high) in zip(joint.velocity, joint.torque, joint.se, joint.conf_int(), strict=True):
            rows.append([joint.label, *(float(x) for x in (v, tau, se, low, high)), joint.unit])
    write_csv(path, rows)


def choice_values(choice: FrictionChoice) -> dict[str, Any]:
    """The model comparison as plain values, for `friction.json`."""
    return {
        "criterion": "AICc: n ln(S / n) + 2 K + 2 K (K + 1) / (n - K - 1); a larger model must be lower by 2, and "
        f"one larger than Coulomb and viscous friction be significant at {LARGER:g} by an F test (p, by Holm over all)",
        "viscous_and_coulomb_are_enough": choice.enough,
        "joints": [
            {
                "joint": joint.label,
                "chosen": joint.chosen.friction_model,
                "models": [_fit_values(fit, p) for fit, p in zip(joint.fits, joint.p, strict=True)],
            }
            for joint in choice.joints
        ],
    }


def _fit_values(fit: FrictionFit, p: float | None) -> dict[str, Any]:
    return {
        "model": fit.friction_model,
        "values": fit.values,
        "conf_int": {name: list(ends) for name, ends in fit.conf_int().items()},
        "p": p,
        "aicc": fit.aicc if math.isfinite(fit.aicc) else None,
        "relative_error_percent": fit.error,
    }


def plot_friction(curve: FrictionCurve, choice: FrictionChoice, title: str, path: Path) -> None:
    """Plot one panel per joint: points with 95 % intervals, the chosen model, and the others in thin lines."""
    figure = Figure(figsize=(1.0 + 4.0 * len(curve.joints), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, parse_math=False)
    panels = np.atleast_1d(figure.subplots(1, len(curve.joints)))
    for panel, joint, made in zip(panels, curve.joints, choice.joints, strict=True):
        _draw(panel, joint, made)
    panels[0].legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _draw(panel: Axes, joint: JointFriction, made: JointChoice) -> None:
    low, high = joint.conf_int().T
    errors = [joint.torque - low, high - joint.torque]
    panel.errorbar(joint.velocity, joint.torque, errors, fmt=".", color=POINTS, capsize=2, label="measured", zorder=3)
    fastest = float(np.abs(joint.velocity).max())
    colours = iter(_OTHERS)
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
