"""Devices: what is known of a mechanism before any data, read from a TOML file."""

from haptid.device.loops.linear import Closure, Followed
from haptid.device.loops.cut_joint import CutJoint
from haptid.device.geometry import poses
from haptid.dynamics.mechanism import MechanismArguments, mechanism, mechanism_arguments
from haptid.device.device import Combination, Cut, Device, Frame, Handle, Joint, Motor, Prior
from haptid.device.loops.newton import NewtonClosure
from haptid.device.parameters import INERTIAL, StandardParameters, Symmetry
from haptid.device.toml.reader import read_device
from haptid.device.toml.schema import device_schema
from haptid.device.toml.summary import summary_lines
from haptid.device.toml.tables import shipped_devices
from haptid.device.terms.term import Counterbalance, TermColumn

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
    "MechanismArguments",
    "Motor",
    "NewtonClosure",
    "Prior",
    "StandardParameters",
    "Symmetry",
    "TermColumn",
    "device_schema",
    "mechanism",
    "mechanism_arguments",
    "poses",
    "read_device",
    "shipped_devices",
    "summary_lines",
]
