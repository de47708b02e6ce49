"""URDF export, `export_urdf(model, folder)`: the identified device, with what URDF cannot express in its heading.

URDF describes trees. A joint that closes a loop is given to Gazebo as an SDF joint in a `<gazebo>` element, which other
readers skip; a passive joint that depends linearly on one other joint is a `<mimic>`. Rotors are in `<transmission>`,
as Drake reads them. Names are identifiers, as ROS and USD require.

Source: http://wiki.ros.org/urdf/XML, and Drake's "Parsing URDF", section on drake:rotor_inertia.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Unpack
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import Cut, Joint
from haptid.device.geometry import angles
from haptid.dynamics.counterparts import with_stiff_springs
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.bodies import Effect, SimulatedBody, bodies, effects
from haptid.experiment.bench.mjcf import numbers
from haptid.export.formats.bodies import heading, standard_parameters_of
from haptid.export.output import Export, default_name, write
from haptid.export.provenance import ExportCriterion, ExportSource, counterpart_source, provenance

DRAKE = "http://drake.mit.edu"
# Value of an unknown limit where URDF requires one, SI; `haptid import` takes it as unknown.
UNLIMITED = 1e9


@dataclass(frozen=True, eq=False)
class _Names:
    """Names of joints and links as identifiers, unique: letters, digits and underscores, no digit first."""

    model: DynamicModel

    @cached_property
    def joints(self) -> tuple[str, ...]:
        given = [joint.alias or joint.name for joint in self.model.device.joints]
        made: list[str] = []
        for name in given:
            plain = re.sub(r"\W", "_", name, flags=re.ASCII)
            plain = plain if re.match(r"[A-Za-z_]", plain) else f"joint_{plain}"
            while plain in made or (plain != name and plain in given):
                plain += "_"
            made.append(plain)
        return tuple(made)

    def link(self, j: int) -> str:
        return "base" if j < 0 else f"link_{self.joints[j].removeprefix('joint_')}"

    def changed(self) -> Iterator[str]:
        """Joints that have another name here, as texts."""
        for joint, name in zip(self.model.device.joints, self.joints, strict=True):
            if (given := joint.alias or joint.name) != name:
                yield f"{given!r} is {name}"


def export_urdf(identified: ExportSource, folder: str | Path, **criterion: Unpack[ExportCriterion]) -> Export:
    """Write a model as URDF: bodies with the identified base parameters, damping, dry friction, rotors.

    Args:
        identified, criterion: as in `export_c`.
        folder: output folder of NAME.urdf.

    Raises:
        UnvalidatedModelError, OutputFolderError: as in `export_c`.
        PhysicalConsistencyError: the base parameters are not physically consistent.
        ExportError: a term without counterpart in rigid-body simulators.
    """
    bent = provenance(identified, **criterion)
    source = counterpart_source(bent, with_stiff_springs(bent.model))
    model = source.model
    chi = standard_parameters_of(model, source.beta)
    made = bodies(model, chi)
    acts = effects(model, chi, made)
    root = _robot(model, made, acts)
    indent(root)
    stiff = [] if bent is source else ["URDF has no springs between joints: motors are rigid, as below the resonances."]
    heading_text = heading(source, chi, *stiff, *_missing(model, acts), *_unknown(model), *_renamed(model))
    text = f'<?xml version="1.0"?>\n{heading_text}\n{tostring(root, encoding="unicode")}\n'
    return write(folder, {f"{default_name(model.device.name)}.urdf": text}, source.verdict)


def _robot(model: DynamicModel, made: tuple[SimulatedBody, ...], acts: tuple[Effect, ...]) -> Element:
    root = Element("robot", {"name": default_name(model.device.name), "xmlns:drake": DRAKE})
    names = _Names(model)
    _base(root, model)
    for j, body in enumerate(made):
        _link(root, names.link(j), body)
        _joint(root, model, names, j, acts[j])
    if model.device.handle is not None:
        SubElement(root, "link", name="handle")
        above = names.link(model.device.handle.link)
        _fixed(root, "handle_mount", above, "handle", model.device.handle.rotation, model.device.handle.translation)
    for act, name in zip(acts, names.joints, strict=False):
        if act.armature:
            _rotor(root, name, act.armature)
    for k, cut in enumerate(model.device.closure.cuts):
        _cut(root, names, f"cut_{k + 1}", cut)
    return root


def _base(root: Element, model: DynamicModel) -> None:
    """A world with gravity along -z, as in simulators, and the device's base in it."""
    SubElement(root, "link", name="world")
    SubElement(root, "link", name="base")
    _fixed(root, "base_mount", "world", "base", upright(model.device.gravity), np.zeros(3))


def _link(root: Element, name: str, body: SimulatedBody) -> None:
    link = SubElement(root, "link", name=name)
    if body.weightless:
        return
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=numbers(body.com), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(body.mass))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    SubElement(inertial, "inertia", {name: repr(float(body.inertia[at])) for name, at in entries.items()})


def _joint(root: Element, model: DynamicModel, names: _Names, j: int, act: Effect) -> None:
    joint = model.device.joints[j]
    element = SubElement(root, "joint", name=names.joints[j], type=_kind(joint))
    SubElement(element, "parent", link=names.link(joint.parent))
    SubElement(element, "child", link=names.link(j))
    SubElement(element, "origin", xyz=numbers(joint.translation), rpy=numbers(angles(joint.rotation)))
    SubElement(element, "axis", xyz="0 0 1")
    if _limited(joint):
        written = {name: repr(UNLIMITED if value is None else float(value)) for name, value in _limits(joint).items()}
        SubElement(element, "limit", written)
    if act.viscous or act.coulomb:
        SubElement(element, "dynamics", damping=repr(act.viscous), friction=repr(act.coulomb))
    _mimic(element, model, names, j)


def _kind(joint: Joint) -> str:
    if joint.prismatic:
        return "prismatic"
    return "continuous" if joint.position_limits is None else "revolute"


def _limited(joint: Joint) -> bool:
    """Whether the joint has a <limit>: a continuous joint of which no limit is known needs none."""
    known = (joint.position_limits, joint.torque_limit, joint.velocity_limit)
    return _kind(joint) != "continuous" or any(one is not None for one in known)


def _limits(joint: Joint) -> dict[str, float | None]:
    """Attributes of a <limit>; None where the limit is not known and URDF requires one."""
    bounds = {"effort": joint.torque_limit, "velocity": joint.velocity_limit}
    if joint.position_limits is not None:
        bounds["lower"], bounds["upper"] = joint.position_limits
    elif joint.prismatic:
        bounds["lower"], bounds["upper"] = -UNLIMITED, None
    return bounds


def _mimic(element: Element, model: DynamicModel, names: _Names, j: int) -> None:
    """A passive joint that depends linearly on one active joint, where no cut joint closes the loop."""
    if j in model.device.active or model.device.closure.cuts:
        return
    row = model.device.closure.constant[j]
    followed = np.flatnonzero(row)
    if len(followed) == 1:
        other = names.joints[model.device.active[int(followed[0])]]
        share, offset = float(row[followed[0]]), float(model.device.closure.offset[j])
        SubElement(element, "mimic", joint=other, multiplier=repr(share), offset=repr(offset))


def _rotor(root: Element, joint: str, inertia: float) -> None:
    """Rotor inertia reflected to the joint."""
    made = SubElement(root, "transmission", name=f"rotor_{joint}")
    SubElement(made, "type").text = "transmission_interface/SimpleTransmission"
    SubElement(made, "joint", name=joint)
    actuator = SubElement(made, "actuator", name=f"motor_{joint}")
    SubElement(actuator, "drake:rotor_inertia", value=repr(inertia))
    SubElement(actuator, "drake:gear_ratio", value="1.0")


def _fixed(root: Element, name: str, parent: str, child: str, rotation: Array, translation: Array) -> None:
    joint = SubElement(root, "joint", name=name, type="fixed")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=numbers(translation), rpy=numbers(angles(rotation)))


def _cut(root: Element, names: _Names, name: str, cut: Cut) -> None:
    """A cut joint, which closes a loop, as SDF."""
    kind = "ball" if cut.kind == "spherical" else cut.kind
    joint = SubElement(SubElement(root, "gazebo"), "joint", name=name, type=kind)
    SubElement(joint, "parent").text = names.link(cut.frame_a.link)
    SubElement(joint, "child").text = names.link(cut.frame_b.link)
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
    rotors = [
        f"{name} {act.armature:.6g}" for act, name in zip(acts, _Names(model).joints, strict=False) if act.armature
    ]
    if rotors:
        made.append(
            "Rotor inertias are in <transmission>, as Drake reads them. MuJoCo and Pinocchio read none from "
            f"URDF: set the armature of each joint there, kg m^2 or kg ({', '.join(rotors)}), or take MJCF."
        )
    for act in acts:
        single = np.count_nonzero(act.joints) == 1
        lost = {"a spring, N m/rad or N/m": act.stiffness, "an offset, N m or N": act.offset}
        if not single:
            lost |= {"rotor inertia": act.armature, "viscous friction": act.viscous, "dry friction": act.coulomb}
        where = f"{act.name} (several joints)" if not single else f"joint {act.name}"
        made += [f"Not in this file: {what} of {value!r} on {where}." for what, value in lost.items() if value]
    return made


def _unknown(model: DynamicModel) -> list[str]:
    """Limits that URDF requires and the device file lacks, in a sentence."""
    lacking: dict[str, list[str]] = {}
    for joint, name in zip(model.device.joints, _Names(model).joints, strict=True):
        for limit, value in _limits(joint).items():
            if value is None and _limited(joint):
                lacking.setdefault("position" if limit == "upper" else limit, []).append(name)
    if not lacking:
        return []
    listed = "; ".join(f"{limit} of {', '.join(names)}" for limit, names in lacking.items())
    return [f"Limits that are not known, {UNLIMITED:g} here because URDF requires a number: {listed}."]


def _renamed(model: DynamicModel) -> list[str]:
    """Joints with another name than in the device file, in a sentence."""
    changed = list(_Names(model).changed())
    return [f"Names of joints as ROS and USD require them: {', '.join(changed)}."] if changed else []


def upright(gravity: Array) -> Array:
    """Rotation of the base in a world in which this gravity points along -z, (3, 3)."""
    size = float(np.linalg.norm(gravity))
    down = gravity / size if size else np.array([0.0, 0.0, -1.0])
    if down[2] > 0:  # turned over first: the rotation below is singular where gravity points up
        over = np.diag([1.0, -1.0, -1.0])
        return np.asarray(upright(over @ gravity) @ over)
    skew = np.cross(np.eye(3), np.cross(down, [0.0, 0.0, -1.0]))
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 - down[2]))
