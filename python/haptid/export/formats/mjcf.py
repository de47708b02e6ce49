"""MJCF export, `export_mjcf(model, folder)`: the identified device for MuJoCo, by the writer of the virtual bench."""

from __future__ import annotations

from pathlib import Path
from typing import Unpack
from xml.etree.ElementTree import Element, fromstring, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from haptid._internal.arrays import Array
from haptid.device import FormulaClosure
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.experiment.bench.mjcf import Physics, mjcf, numbers, polynomial_equality
from haptid.export.formats.bodies import heading, standard_parameters_of
from haptid.export.output import Export, Simulator, default_name, write
from haptid.export.provenance import ExportCriterion, ExportSource, provenance


def export_mjcf(
    identified: ExportSource,
    folder: str | Path,
    simulator: Simulator | None = None,
    **criterion: Unpack[ExportCriterion],
) -> Export:
    """Write a model as MJCF: bodies with the identified base parameters, loops, rotors, friction, springs, motors.

    Only base parameters are identifiable from torque; the bodies nearest to the prior that have them are written.
    Joints have the limits of the device file; loops are closed at the start. Actuators are as in
    `haptid.experiment.bench.mjcf`.

    Args:
        identified, criterion: as in `export_c`.
        folder: output folder of NAME.xml.
        simulator: time step, and whether there are contacts; the default where None.

    Raises:
        UnvalidatedModelError, OutputFolderError: as in `export_c`.
        PhysicalConsistencyError: the base parameters are not physically consistent.
        ExportError: a term or loop without counterpart in MuJoCo.
    """
    source = provenance(identified, **criterion)
    model = source.model
    chi = standard_parameters_of(model, source.beta)
    settings = simulator or Simulator()
    root = fromstring(mjcf(model, chi, Physics(settings.step)))
    if settings.contacts:
        _touch(root)
    _limit(root, model)
    _close(root, model)
    _rename(root, model)
    indent(root)
    text = f"{heading(source, chi)}\n{tostring(root, encoding='unicode')}\n"
    return write(folder, {f"{default_name(model.device.name)}.xml": text}, source.verdict)


def _touch(root: Element) -> None:
    """Contacts between the device and other bodies, which have MuJoCo's default bits 1 and 1; none among its links."""
    flag, geom = root.find("./option/flag"), root.find("./default/geom")
    assert flag is not None
    assert geom is not None
    del flag.attrib["contact"]
    geom.attrib |= {"contype": "2", "conaffinity": "1"}


def _limit(root: Element, model: DynamicModel) -> None:
    """Set position ranges and maximum torques of the joints."""
    joints = {joint.name: joint for joint in model.device.joints}
    for element in root.findall("./worldbody//body/joint"):
        joint = joints[element.attrib["name"]]
        if joint.position_limits is not None:
            element.set("range", numbers(joint.position_limits))
        if joint.torque_limit is not None:
            element.set("actuatorfrcrange", numbers((-joint.torque_limit, joint.torque_limit)))


def _close(root: Element, model: DynamicModel) -> None:
    """Begin at a pose with closed loops: bodies are placed as there, and `ref` holds the positions of the joints."""
    start = _closed_pose(model)
    if start is None or not np.any(start):
        return
    elements = {element.attrib["name"]: element for element in root.iter("body")}
    for joint, q in zip(model.device.joints, start, strict=True):
        body, at = elements[joint.name], joint.translation
        turned = joint.rotation
        if joint.prismatic:
            at = at + q * joint.rotation[:, 2]
        else:
            turned = joint.rotation @ Rotation.from_rotvec([0.0, 0.0, q]).as_matrix()
        body.attrib |= {"pos": numbers(at), "xyaxes": numbers([*turned[:, 0], *turned[:, 1]])}
        moved = body.find("joint")
        assert moved is not None
        moved.set("ref", repr(float(q)))
    for relation in root.findall("./equality/tendon"):
        relation.set("polycoef", numbers([0.0] * 5))  # of the change of length since this pose
    closure = model.device.closure
    for j in closure.polynomials if isinstance(closure, FormulaClosure) else ():
        found = root.find(f"./equality/joint[@name='relation {model.device.joints[j].name}']")
        assert found is not None
        found.attrib |= polynomial_equality(model, j, start)


def _closed_pose(model: DynamicModel) -> Array | None:
    """Positions of all joints at a pose with closed loops, in the joints' limits where one is found, (joints,)."""
    limits = [model.device.joints[j].position_limits or (-np.pi, np.pi) for j in model.device.active]
    low, high = np.array(limits).reshape(-1, 2).T
    some = [np.clip(0.0, low, high), 0.5 * (low + high), *np.random.default_rng(0).uniform(low, high, (100, len(low)))]
    best: Array | None = None
    for qa in some:
        try:
            q = model.device.closure.positions(qa[:, None])[:, 0]
        except HaptidError:
            continue
        best = q if best is None else best
        bounds = [joint.position_limits or (-np.inf, np.inf) for joint in model.device.joints]
        if all(a <= value <= b for value, (a, b) in zip(q, bounds, strict=True)):
            return q
    return best


def _rename(root: Element, model: DynamicModel) -> None:
    """Give joints the names that they have in the robot description, also where tendons and actuators name them."""
    aliases = {joint.name: joint.alias for joint in model.device.joints if joint.alias}
    for element in root.iter():
        keys = ("name", "joint") if element.tag == "joint" else ("joint", "joint1", "joint2")
        for key in keys:
            if (name := element.get(key)) in aliases:
                element.set(key, aliases[name])
