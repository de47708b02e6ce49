"""Devices: what is known of a mechanism before any data, read from a TOML file."""

from haptid.device.device import Combination, Cut, Device, Frame, Handle, Joint, Motor, Prior
from haptid.device.geometry import poses
from haptid.device.loops.cut_joint import CutJoint
from haptid.device.loops.linear import Closure, Followed
from haptid.device.loops.newton import NewtonClosure
from haptid.device.parameters import INERTIAL, StandardParameters, Symmetry
from haptid.device.terms.term import Counterbalance, TermColumn
from haptid.device.toml.reader import read_device
from haptid.device.toml.schema import device_schema
from haptid.device.toml.summary import summary_lines
from haptid.device.toml.tables import shipped_devices

__all__ = [
    "INERTIAL",
    "Closure",
    "Combination",
    "Counterbalance",
    "Cut",
    "CutJoint",
    "Device",
    "Followed",
    "Frame",
    "Handle",
    "Joint",
    "Motor",
    "NewtonClosure",
    "Prior",
    "StandardParameters",
    "Symmetry",
    "TermColumn",
    "device_schema",
    "poses",
    "read_device",
    "shipped_devices",
    "summary_lines",
]
