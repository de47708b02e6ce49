"""The mechanism as data, read from a TOML file: joints, loops, motors, terms, priors, targets.

No regressor and no estimate: the equations of motion are in `haptid.dynamics`.
"""

from haptid.device.collision import CollisionShape, read_world
from haptid.device.device import Device
from haptid.device.geometry import poses
from haptid.device.loops.cut_joint import CutJoint
from haptid.device.loops.formula import FormulaClosure
from haptid.device.loops.linear import Closure, Followed
from haptid.device.loops.newton import NewtonClosure
from haptid.device.parameters import INERTIAL, Combination, StandardParameters, Symmetry
from haptid.device.parts import Cut, Frame, Gimbal, Handle, Joint, Motor, Prior
from haptid.device.terms.extension import TermExtension, TermFormula
from haptid.device.terms.spring import Counterbalance
from haptid.device.terms.term import TermColumn
from haptid.device.toml.reader import read_device, shipped_devices
from haptid.device.toml.schema import device_schema, world_schema
from haptid.device.toml.summary import summary_lines

__all__ = [
    "INERTIAL",
    "Closure",
    "CollisionShape",
    "Combination",
    "Counterbalance",
    "Cut",
    "CutJoint",
    "Device",
    "Followed",
    "FormulaClosure",
    "Frame",
    "Gimbal",
    "Handle",
    "Joint",
    "Motor",
    "NewtonClosure",
    "Prior",
    "StandardParameters",
    "Symmetry",
    "TermColumn",
    "TermExtension",
    "TermFormula",
    "device_schema",
    "poses",
    "read_device",
    "read_world",
    "shipped_devices",
    "summary_lines",
    "world_schema",
]
