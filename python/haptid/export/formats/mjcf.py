"""MJCF export, `export_mjcf(model, folder)`: the identified device for MuJoCo, as the virtual bench simulates it."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, fromstring, indent, tostring

from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.mjcf import mjcf, numbers
from haptid.export.formats.bodies import heading, standard_parameters_of
from haptid.export.output import Export, default_name, write
from haptid.export.provenance import ExportSource, provenance
from haptid.validation.validation import Validation


def export_mjcf(
    identified: ExportSource,
    folder: str | Path,
    *,
    validation: Validation | None = None,
    largest_error: float | None = None,
    anyway: bool = False,
) -> Export:
    """Write a model as MJCF: bodies with the identified base parameters, loops, rotors, friction, springs, motors.

    Only base parameters are identifiable from torque; the bodies nearest to the prior that have them are written.
    Joints have the limits of the device file. Actuators are as in `haptid.experiment.bench.mjcf`.

    Args:
        identified, validation, largest_error, anyway: as in `export_c`.
        folder: output folder of NAME.xml.

    Raises:
        UnvalidatedModelError: the model does not meet its validation criterion.
        PhysicalConsistencyError: the base parameters are not physically consistent.
        ExportError: a term or loop without counterpart in MuJoCo.
        OutputFolderError: the folder cannot be written.
    """
    source = provenance(identified, validation, largest_error, anyway)
    model = source.model
    chi = standard_parameters_of(model, source.beta)
    root = fromstring(mjcf(model, chi))
    _limit(root, model)
    _rename(root, model)
    indent(root)
    text = f"{heading(source, chi)}\n{tostring(root, encoding='unicode')}\n"
    return write(folder, {f"{default_name(model.device.name)}.xml": text}, source.verdict)


def _limit(root: Element, model: DynamicModel) -> None:
    """Set position ranges and maximum torques of the joints."""
    joints = {joint.name: joint for joint in model.device.joints}
    for element in root.findall("./worldbody//body/joint"):
        joint = joints[element.attrib["name"]]
        if joint.position_limits is not None:
            element.set("range", numbers(joint.position_limits))
        if joint.torque_limit is not None:
            element.set("actuatorfrcrange", numbers((-joint.torque_limit, joint.torque_limit)))


def _rename(root: Element, model: DynamicModel) -> None:
    """Give joints the names that they have in the robot description, also where tendons and actuators name them."""
    aliases = {joint.name: joint.alias for joint in model.device.joints if joint.alias}
    for element in root.iter():
        keys = ("name", "joint") if element.tag == "joint" else ("joint", "joint1", "joint2")
        for key in keys:
            if (name := element.get(key)) in aliases:
                element.set(key, aliases[name])
