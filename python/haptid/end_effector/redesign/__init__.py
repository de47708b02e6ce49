"""Redesign from an identified model: counterweights within limits, and gears and lengths for a wanted mass or force."""

from haptid.end_effector.redesign.counterweights import (
    Balance,
    Counterweight,
    WeightPlace,
    balance,
    balance_front,
    places,
    with_counterweights,
)
from haptid.end_effector.redesign.drives import DriveChange, drive_changes, pareto

__all__ = [
    "Balance",
    "Counterweight",
    "DriveChange",
    "WeightPlace",
    "balance",
    "balance_front",
    "drive_changes",
    "pareto",
    "places",
    "with_counterweights",
]
