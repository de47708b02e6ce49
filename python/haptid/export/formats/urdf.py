"""URDF export, `export_urdf(model, folder)`: the identified device, with what URDF cannot express in its heading.

URDF describes trees. A joint that closes a loop is given to Gazebo as an SDF joint in a `<gazebo>` element, which other
readers skip; a passive joint that depends linearly on one other joint is a `<mimic>`. Rotors are in `<transmission>`,
as Drake reads them.

Source: http://wiki.ros.org/urdf/XML, and Drake's "Parsing URDF", section on drake:rotor_inertia.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Cut, Joint
from haptid.device.geometry import angles
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.bodies import Effect, SimulatedBody, bodies, effects
from haptid.experiment.bench.mjcf import numbers
from haptid.export.formats.bodies import heading, standard_parameters_of
from haptid.export.output import Export, default_name, write
from haptid.export.provenance import ExportSource, provenance
from haptid.validation.validation import Validation

DRAKE = "http://drake.mit.edu"
# Value of unknown limits, SI: URDF requires all limits of a joint that has any.
UNLIMITED = 1e3


def export_urdf(
    identified: ExportSource,
    folder: str | Path,
    *,
    validation: Validation | None = None,
    largest_error: float | None = None,
    anyway: bool = False,
) -> Export:
    """Write a model as URDF: bodies with the identified base parameters, damping, dry friction, rotors.

    Args:
        identified, validation, largest_error, anyway: as in `export_c`.
        folder: output folder of NAME.urdf.

    Raises:
        UnvalidatedModelError: the model does not meet its validation criterion.
        PhysicalConsistencyError: the base parameters are not physically consistent.
        ExportError: a term without counterpart in rigid-body simulators.
        OutputFolderError: the folder cannot be written.
    """
    source = provenance(identified, validation, largest_error, anyway)
    model = source.model
    chi = standard_parameters_of(model, source.beta)
    made = bodies(model, chi)
    acts = effects(model, chi, made)
    root = _robot(model, made, acts)
    indent(root)
    heading_text = heading(source, chi, *_missing(model, acts))
    text = f'<?xml version="1.0"?>\n{heading_text}\n{tostring(root, encoding="unicode")}\n'
    return write(folder, {f"{default_name(model.device.name)}.urdf": text}, source.verdict)


def _robot(model: DynamicModel, made: tuple[SimulatedBody, ...], acts: tuple[Effect, ...]) -> Element:
    root = Element("robot", {"name": default_name(model.device.name), "xmlns:drake": DRAKE})
    _base(root, model)
    for j, (joint, body) in enumerate(zip(model.device.joints, made, strict=True)):
        _link(root, joint, body)
        _joint(root, model, j, acts[j])
    if model.device.handle is not None:
        SubElement(root, "link", name="handle")
        above = _link_name(model, model.device.handle.link)
        _fixed(root, "handle mount", above, "handle", model.device.handle.rotation, model.device.handle.translation)
    for act, joint in zip(acts, model.device.joints, strict=False):
        if act.armature:
            _rotor(root, joint.alias or joint.name, act.armature)
    for k, cut in enumerate(model.device.closure.cuts):
        _cut(root, model, f"cut {k + 1}", cut)
    return root


def _base(root: Element, model: DynamicModel) -> None:
    """A world with gravity along -z, as in simulators, and the device's base in it."""
    SubElement(root, "link", name="world")
    SubElement(root, "link", name="base")
    _fixed(root, "base mount", "world", "base", upright(model.device.gravity), np.zeros(3))


def _link(root: Element, joint: Joint, body: SimulatedBody) -> None:
    link = SubElement(root, "link", name=f"link {joint.name}")
    if body.weightless:
        return
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=numbers(body.com), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(body.mass))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    SubElement(inertial, "inertia", {name: repr(float(body.inertia[at])) for name, at in entries.items()})


def _joint(root: Element, model: DynamicModel, j: int, act: Effect) -> None:
    joint = model.device.joints[j]
    limits = joint.position_limits
    turning = "continuous" if limits is None else "revolute"
    element = SubElement(
        root, "joint", name=joint.alias or joint.name, type="prismatic" if joint.prismatic else turning
    )
    SubElement(element, "parent", link=_link_name(model, joint.parent))
    SubElement(element, "child", link=f"link {joint.name}")
    SubElement(element, "origin", xyz=numbers(joint.translation), rpy=numbers(angles(joint.rotation)))
    SubElement(element, "axis", xyz="0 0 1")
    _limit(element, joint)
    if act.viscous or act.coulomb:
        SubElement(element, "dynamics", damping=repr(act.viscous), friction=repr(act.coulomb))
    _mimic(element, model, j)


def _limit(element: Element, joint: Joint) -> None:
    bounds = {"effort": joint.torque_limit or UNLIMITED, "velocity": joint.velocity_limit or UNLIMITED}
    if joint.position_limits is not None or joint.prismatic:
        lower, upper = joint.position_limits or (-UNLIMITED, UNLIMITED)
        bounds |= {"lower": lower, "upper": upper}
    SubElement(element, "limit", {name: repr(float(value)) for name, value in bounds.items()})


def _mimic(element: Element, model: DynamicModel, j: int) -> None:
    """A passive joint that depends linearly on one active joint, where no cut joint closes the loop."""
    if j in model.device.active or model.device.closure.cuts:
        return
    row = model.device.closure.constant[j]
    followed = np.flatnonzero(row)
    if len(followed) == 1:
        active = model.device.joints[model.device.active[int(followed[0])]]
        other = active.alias or active.name
        share, offset = float(row[followed[0]]), float(model.device.closure.offset[j])
        SubElement(element, "mimic", joint=other, multiplier=repr(share), offset=repr(offset))


def _rotor(root: Element, joint: str, inertia: float) -> None:
    """Rotor inertia reflected to the joint."""
    made = SubElement(root, "transmission", name=f"rotor {joint}")
    SubElement(made, "type").text = "transmission_interface/SimpleTransmission"
    SubElement(made, "joint", name=joint)
    actuator = SubElement(made, "actuator", name=f"motor {joint}")
    SubElement(actuator, "drake:rotor_inertia", value=repr(inertia))
    SubElement(actuator, "drake:gear_ratio", value="1.0")


def _fixed(root: Element, name: str, parent: str, child: str, rotation: Array, translation: Array) -> None:
    joint = SubElement(root, "joint", name=name, type="fixed")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=numbers(translation), rpy=numbers(angles(rotation)))


def _cut(root: Element, model: DynamicModel, name: str, cut: Cut) -> None:
    """A cut joint, which closes a loop, as SDF."""
    kind = "ball" if cut.kind == "spherical" else cut.kind
    joint = SubElement(SubElement(root, "gazebo"), "joint", name=name, type=kind)
    SubElement(joint, "parent").text = _link_name(model, cut.frame_a.link)
    SubElement(joint, "child").text = _link_name(model, cut.frame_b.link)
    SubElement(joint, "pose").text = numbers((*cut.frame_b.translation, *angles(cut.frame_b.rotation)))
    if kind != "ball":
        SubElement(SubElement(joint, "axis"), "xyz").text = "0 0 1"


def _missing(model: DynamicModel, acts: tuple[Effect, ...]) -> list[str]:
    """What URDF cannot express, in sentences."""
    gravity = numbers(model.device.gravity)
    made = [f"Gravity in the base frame is {gravity} m/s^2; that of a simulator acts along -z of the world."]
    if model.device.closure.cuts:
        made.append("URDF has no loops: cut joints are in <gazebo> elements, as SDF; other readers see a tree.")
    elif model.device.closure.relations:
        made.append(f"Passive joints depend on active ones: {'; '.join(model.device.closure.relations)}.")
    for act in acts:
        single = np.count_nonzero(act.joints) == 1
        lost = {"a spring, N m/rad or N/m": act.stiffness, "an offset, N m or N": act.offset}
        if not single:
            lost |= {"rotor inertia": act.armature, "viscous friction": act.viscous, "dry friction": act.coulomb}
        where = f"{act.name} (several joints)" if not single else f"joint {act.name}"
        made += [f"Not in this file: {what} of {value!r} on {where}." for what, value in lost.items() if value]
    return made


def upright(gravity: Array) -> Array:
    """Rotation of the base in a world in which this gravity points along -z, (3, 3)."""
    size = float(np.linalg.norm(gravity))
    down = gravity / size if size else np.array([0.0, 0.0, -1.0])
    if down[2] > 0:  # turned over first: the rotation below is singular where gravity points up
        over = np.diag([1.0, -1.0, -1.0])
        return np.asarray(upright(over @ gravity) @ over)
    skew = np.cross(np.eye(3), np.cross(down, [0.0, 0.0, -1.0]))
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 - down[2]))


def _link_name(model: DynamicModel, j: int) -> str:
    return "base" if j < 0 else f"link {model.device.joints[j].name}"
