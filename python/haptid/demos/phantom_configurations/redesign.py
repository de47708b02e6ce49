"""The chapter on redesign: counterweights that null the gravity terms of the normal mounting, and other drives."""

from __future__ import annotations

import numpy as np

from haptid.demos.phantom_configurations.results import Results, published_beta
from haptid.end_effector.characterisation import GivenParameters
from haptid.end_effector.redesign import Balance, Redesign, Wishes, redesigned
from haptid.inference.targets import target_map
from haptid.report.document import DocumentSection, TextTable
from haptid.report.redesign import (
    DRIVES_TEXT,
    change_text,
    drives_chart,
    drives_table,
    weight_text,
    weights_chart,
    weights_table,
)

# Mounting that is balanced, and the one with the paper's own counterweights.
_FROM, _THEIRS = "normal", "gc"
# Cells of the grid over the workspace.
_POSES = 2000
# Half as much force again as the device has, with an eighth less mass.
_WISHES = Wishes(most_mass=0.06, least_force=10.0)


def found_for(results: Results) -> Redesign:
    """Weights, and motors, gears and lengths, for the published normal column over the first workspace."""
    like = next(iter(results.fits.values()))["encoders"].targets
    known = GivenParameters(results.model, published_beta(results.demo, like, _FROM))
    return redesigned(known, results.demo.workspaces[0].of(results.model).grid(_POSES), _WISHES)


def redesign_section(results: Results) -> DocumentSection:
    """The chapter of the page."""
    found = found_for(results)
    best, present, chosen = found.best, found.present, found.chosen
    if best is None or present is None or chosen is None:
        raise RuntimeError("the device file of the PHANToM has places of counterweights, limits and rotors")
    weights = " and ".join(map(weight_text, best.weights))
    text = (
        f"Counterweights that null the gravity terms of the published Normal column, within the places of the device "
        f"file: {weights}. The root mean square of the static torque over the workspace falls from "
        f"{best.static_before:.3g} to {best.static_after:.2g} N m, and the largest effective mass at the handle rises "
        f"from {best.mass_before:.4f} to {best.mass_after:.4f} kg in the mean. Both terms are negative in that column, "
        f"so the weights go in front of the joints.",
        "The paper's mounting GC differs: it carries a gimbal at the tip, which adds to every term and most to pi_4, "
        "and its counterweights balance the gimbal and not the device. Its pi_7 is not small, 0.0735 for -0.0525 "
        "before, and its price in pi_4 to pi_6 is that of the gimbal with its weights.",
        f"{DRIVES_TEXT}: {present.poses}. As it is, the device "
        f"has {present.mass:.4f} kg and {present.force:.3g} N by the peak torques. "
        f"The least change to at most {_WISHES.most_mass:g} kg with at least {_WISHES.least_force:g} N: "
        f"{change_text(chosen)}. Longer motors give force without the price of a larger ratio, whose rotors count by "
        f"its square.",
    )
    tables = (_parameters(results, best), weights_table(found.balances), drives_table(present, found.front, chosen))
    pictures = (
        weights_chart(found.balances),
        drives_chart(present, found.changes, chosen, _WISHES.most_mass, _WISHES.least_force),
    )
    return DocumentSection("redesign", "Counterweights, motors, gears and lengths", text, tables, pictures)


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
