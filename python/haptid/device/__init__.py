"""Devices: what is known of a mechanism before any data, read from a TOML file."""

from haptid.device.closure import Closure, Followed
from haptid.device.cuts import CutJoint
from haptid.device.geometry import poses
from haptid.device.mechanism import MechanismArguments, mechanism, mechanism_arguments
from haptid.device.model import Combination, Cut, Device, Frame, Handle, Joint, Motor, Prior
from haptid.device.newton import NewtonClosure
from haptid.device.parameters import INERTIAL, StandardParameters, Symmetry
from haptid.device.reading import read_device
from haptid.device.schema import device_schema
from haptid.device.summary import summary_lines
from haptid.device.tables import shipped_devices
from haptid.device.terms import Counterbalance, TermColumn

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
