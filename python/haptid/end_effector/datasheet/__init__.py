"""The data sheet of a device: its figures in the terms of haptics, each with interval and method."""

from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.datasheet.rows import SheetRow
from haptid.end_effector.datasheet.sheet import DataSheet, data_sheet
from haptid.end_effector.datasheet.z_width import StepDevice, passive_stiffness, stable_stiffness, stepped_stiffness

__all__ = [
    "DataSheet",
    "DeviceInstruments",
    "SheetRow",
    "StepDevice",
    "data_sheet",
    "passive_stiffness",
    "stable_stiffness",
    "stepped_stiffness",
]
