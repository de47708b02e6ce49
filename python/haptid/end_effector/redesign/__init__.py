"""Redesign from an identified model: counterweights within limits; motors, gears and lengths for a mass or a force."""

from haptid.end_effector.redesign.counterweights import (
    Balance,
    Counterweight,
    WeightPlace,
    balance,
    balance_front,
    places,
    weighed,
    with_counterweights,
)
from haptid.end_effector.redesign.drives import MOTORS, DriveChange, MotorOption, drive_changes, least_change, pareto
from haptid.end_effector.redesign.redesigned import Redesign, Wishes, redesigned

__all__ = [
    "MOTORS",
    "Balance",
    "Counterweight",
    "DriveChange",
    "MotorOption",
    "Redesign",
    "WeightPlace",
    "Wishes",
    "balance",
    "balance_front",
    "drive_changes",
    "least_change",
    "pareto",
    "places",
    "redesigned",
    "weighed",
    "with_counterweights",
]
