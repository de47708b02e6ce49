"""The chapter on redesign: counterweights that null the gravity terms of the normal mounting, and their price."""

from __future__ import annotations

import numpy as np

from haptid.demos.phantom_configurations.results import Results, published_beta
from haptid.end_effector.characterisation import GivenParameters
from haptid.end_effector.redesign import Balance, balance_front
from haptid.inference.targets import target_map
from haptid.report.chart import Chart, axis, chart_series, packed, plot
from haptid.report.document import DocumentSection, TextTable

# Mounting that is balanced, and the one with the paper's own counterweights.
_FROM, _THEIRS = "normal", "gc"
# Cells of the grid over the workspace.
_POSES = 2000
# Share of the static torque below which it counts as nulled.
NULLED = 0.01


def fronts(results: Results) -> tuple[Balance, ...]:
    """Balances of the published normal column over the first workspace, at several prices."""
    like = next(iter(results.fits.values()))["encoders"].targets
    known = GivenParameters(results.model, published_beta(results.demo, like, _FROM))
    return balance_front(known, results.demo.workspaces[0].of(results.model).grid(_POSES))


def redesign_section(results: Results) -> DocumentSection:
    """The chapter of the page."""
    front = fronts(results)
    # Many weights have the same moments: of the balances that leave next to nothing, the lightest at the handle.
    best = min(
        (balance for balance in front if balance.static_after <= NULLED * balance.static_before),
        key=lambda balance: balance.mass_after,
    )
    weights = " and ".join(f"{w.mass:.3f} kg on {w.link} at {1e3 * w.com[0]:.1f} mm" for w in best.weights)
    text = (
        f"Counterweights that null the gravity terms of the published Normal column, within the places of the device "
        f"file: {weights}. The root mean square of the static torque over the workspace falls from "
        f"{best.static_before:.3g} to {best.static_after:.2g} N m, and the largest effective mass at the handle rises "
        f"from {best.mass_before:.4f} to {best.mass_after:.4f} kg in the mean. Both terms are negative in that column, "
        f"so the weights go in front of the joints.",
        "The paper's mounting GC differs: it carries a gimbal at the tip, which adds to every term and most to pi_4, "
        "and its counterweights balance the gimbal and not the device. Its pi_7 is not small, 0.0735 for -0.0525 "
        "before, and its price in pi_4 to pi_6 is that of the gimbal with its weights.",
    )
    return DocumentSection(
        "redesign", "Counterweights", text, (_parameters(results, best), _front_table(front)), (_chart(front),)
    )


def _parameters(results: Results, best: Balance) -> TextTable:
    """Published columns and that with the weights, in units of command."""
    like = next(iter(results.fits.values()))["encoders"].targets
    per_command = np.linalg.norm(like.in_command().C, axis=1) / np.linalg.norm(like.C, axis=1)
    targets = target_map(results.model) @ best.identified.beta * per_command
    normal, theirs = (np.nan_to_num(results.demo.parameters.column(name)) for name in (_FROM, _THEIRS))
    cells = [["", "Normal", "with the weights", "price", "GC, published", "GC minus Normal"]]
    for row in zip(
        results.demo.parameters.rows, normal, targets, targets - normal, theirs, theirs - normal, strict=True
    ):
        cells.append([row[0], *(f"{value:z.4f}" for value in row[1:])])
    return TextTable("Parameters, units of command", cells)


def _front_table(front: tuple[Balance, ...]) -> TextTable:
    cells = [["price", "static torque, N m", "largest effective mass, kg", "weights"]]
    for balance in front:
        weights = "; ".join(f"{w.link} {w.mass:.3f} kg at {1e3 * w.com[0]:.1f} mm" for w in balance.weights)
        cells.append(
            [f"{balance.price:g}", f"{balance.static_after:.2g}", f"{balance.mass_after:.4f}", weights or "none"]
        )
    return TextTable("Static torque against effective mass", cells)


def _chart(front: tuple[Balance, ...]) -> Chart:
    x, y = packed([balance.mass_after for balance in front]), packed([balance.static_after for balance in front])
    curves = [chart_series("front", "line", "blue", x=x, y=y), chart_series("weights", "points", "blue", x=x, y=y)]
    none = {"x": packed([front[0].mass_before]), "y": packed([front[0].static_before])}
    curves.append(chart_series("no weights", "points", "vermillion", **none))
    drawing = plot(axis("largest effective mass", "kg"), axis("static torque", "N m", zero=True), curves, height=240)
    caption = f"From {front[0].static_before:.3g} N m and {front[0].mass_before:.4f} kg without weights."
    alt = "Static torque against effective mass for several prices of mass."
    return Chart("redesign", "Static torque against effective mass", alt, caption, drawing)
