"""`export_mjcf(model, folder)`: the identified device for MuJoCo, as the virtual bench would simulate it."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, fromstring, indent, tostring

from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.mjcf import mjcf, numbers
from haptid.export.formats.bodies import departure, standard_parameters
from haptid.export.output import Export, default_name, write
from haptid.export.provenance import IdentifiedModel, about, provenance
from haptid.validation.validation import Validation


def export_mjcf(
    identified: IdentifiedModel,
    folder: str | Path,
    *,
    validation: Validation | None = None,
    largest_error: float | None = None,
    anyway: bool = False,
) -> Export:
    """Write a model as MJCF: bodies that have the identified base parameters, loops, rotors, friction, springs, motors.

    Torque tells base parameters only; of all bodies that have them, those nearest to the prior are written. Joints have
    the limits of the device file. Actuators are as in `haptid.experiment.bench.mjcf`.

    Args:
        identified, validation, largest_error, anyway: as in `export_c`.
        folder: where NAME.xml goes.

    Raises:
        FailedValidationError, UnvalidatedError: the model may not pass.
        ImpossibleModelError: no bodies have its base parameters.
        UnsimulatedTermError, UnsimulatedLoopError: what MuJoCo has no counterpart for.
        OutputError: the folder cannot be written.
    """
    source = provenance(identified, validation, largest_error, anyway)
    model = source.model
    chi = standard_parameters(model, source.beta)
    root = fromstring(mjcf(model, chi))
    _limit(root, model)
    indent(root)
    lines = [
        *about(source),
        "Of all bodies with the identified base parameters, those nearest to the prior, or to a ball without one.",
        f"They have the base parameters to {departure(model, source.beta, chi):.0e} of their size.",
    ]
    text = f"{xml_comment(lines)}\n{tostring(root, encoding='unicode')}\n"
    return write(folder, {f"{default_name(model.device.name)}.xml": text}, source.verdict)


def xml_comment(lines: list[str]) -> str:
    """Lines as a comment that they cannot end."""
    text = "\n".join(lines).replace("--", "- -")
    return f"<!--\n{text}\n-->"


def _limit(root: Element, model: DynamicModel) -> None:
    """Ranges of joints, and the greatest torque on them."""
    joints = {joint.name: joint for joint in model.device.joints}
    for element in root.findall("./worldbody//body/joint"):
        joint = joints[element.attrib["name"]]
        if joint.position_limits is not None:
            element.set("range", numbers(joint.position_limits))
        if joint.torque_limit is not None:
            element.set("actuatorfrcrange", numbers((-joint.torque_limit, joint.torque_limit)))
