"""Write identified parameters back into a user's own URDF or MJCF, `export_into(model, folder, file, "urdf")`.

Only inertias, damping and dry friction of joints (in MJCF also armature and springs) are replaced; every other byte of
the file stays as it is. Of all bodies with the identified base parameters, those nearest to the prior are written,
which for an imported device are the file's own. A link that moves takes the whole body of all links fixed to it, which
lose theirs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.dynamics.inverse import core_torque
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExportError
from haptid.experiment.bench.bodies import Effect, SimulatedBody, bodies, effects
from haptid.experiment.bench.mjcf import numbers
from haptid.export.formats.bodies import heading, standard_parameters_of
from haptid.export.output import Export, write
from haptid.export.provenance import ExportSource, provenance
from haptid.robot_files.moving_tree import MovingTree, moving_tree
from haptid.robot_files.newton_euler import tree_torque
from haptid.robot_files.read import is_xacro, read_robot
from haptid.robot_files.tree import Inertial, inverse
from haptid.robot_files.xml import Element, parse, read_bytes

# Largest difference of placements between device and file, m or of unit vectors, and of torques, relative.
SAME_GEOMETRY, SNAPPED_GEOMETRY, SAME_TORQUE = 1e-9, 2e-3, 1e-9
_STATES = 20
_MJCF_KEYS = {"damping": "viscous", "frictionloss": "coulomb", "armature": "armature", "stiffness": "stiffness"}


def export_into(
    identified: ExportSource, folder: str | Path, file: str | Path, form: str, *, anyway: bool = False
) -> Export:
    """Write a copy of a robot description with identified parameters.

    Args:
        identified, anyway: as in `export_c`; the device was imported from this file, or has its joints' names.
        folder: output folder; the copy has the file's name.
        file: URDF or MJCF.
        form: "urdf" or "mjcf".

    Raises:
        ExportError: the file has not the device's joints or geometry, or cannot be edited.
        RobotFileError: the file cannot be read.
        UnvalidatedModelError, PhysicalConsistencyError, OutputFolderError: as for `export_urdf`.
    """
    source, path = provenance(identified, None, None, anyway), Path(file)
    model = source.model
    tree = read_robot(path)
    content = read_bytes(path)
    root = parse(content, str(path))
    if tree.form != form or (form == "urdf" and is_xacro(path, content)):
        raise _cannot(
            path, f"it is not plain {form.upper()}", f"Give the {form.upper()} that the device was imported from."
        )
    if content[:3] == b"\xef\xbb\xbf" or content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise _cannot(path, "it starts with a byte order mark", "Save it as UTF-8 without one.")
    index = {joint.alias or joint.name: j for j, joint in enumerate(model.device.joints)}
    moving = {joint.name for joint in tree.joints if joint.moves}
    absent = [name for name, j in index.items() if name not in moving and model.device.joints[j].body]
    if absent:
        raise _cannot(path, f"it has no moving joint {absent[0]!r}", "Give the file that the device was imported from.")
    of = moving_tree(tree, hold=dict.fromkeys(sorted(moving - set(index)), 0.0))
    apart = _geometry(of, model.device, index)
    if apart > SNAPPED_GEOMETRY:
        found = f"its placements differ from the device's by {apart:.1e}"
        raise _cannot(path, found, "Import it again without --hold at other positions, and identify that device.")
    chi = standard_parameters_of(model, source.beta)
    made = bodies(model, chi)
    acts = effects(model, chi, made)
    editor = _Editor(root, content, of, index, form)
    for one in of.moving:
        editor.joint(one.joint.name, one.joint.child, _own(model.device, index[one.joint.name], made), acts)
    notes = [*_lost(acts, form, len(model.device.joints)), *editor.notes]
    if apart > SAME_GEOMETRY:
        notes.append(f"Placements of this file differ from the device's by {apart:.0e}, as after --snap.")
    comment = heading(source, chi, *notes)
    text = editor.result(comment)
    written = write(folder, {path.name: text.decode()}, source.verdict)
    if apart <= SAME_GEOMETRY:
        _verify(model, chi, made, of, index, path)
    return written


def _cannot(path: Path, found: str, advice: str) -> ExportError:
    return ExportError(f"{path}: nothing can be written into it: {found}.", where=str(path), found=found, advice=advice)


def _file_frame(device: Device, j: int) -> Array:
    """The file's link frame in the normal form, (4, 4)."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = device.joints[j].frame_rotation, device.joints[j].frame_translation
    return made


def _geometry(of: MovingTree, device: Device, index: Mapping[str, int]) -> float:
    """Greatest difference of a placement between file and device; first joints are placed on bases of their own."""
    worst = 0.0
    for one in of.moving:
        j = index[one.joint.name]
        joint = device.joints[j]
        above = -1 if one.parent < 0 else index[of.moving[one.parent].joint.name]
        if above != joint.parent or (one.joint.kind == "prismatic") != joint.prismatic:
            return float("inf")
        axis = _file_frame(device, j)[:3, :3].T @ np.array([0.0, 0.0, 1.0])
        worst = max(worst, float(np.abs(axis - one.joint.axis).max()))
        if above >= 0:
            placed = np.eye(4)
            placed[:3, :3], placed[:3, 3] = joint.rotation, joint.translation
            own = np.linalg.inv(_file_frame(device, above)) @ placed @ _file_frame(device, j)
            worst = max(worst, float(np.abs(own - one.placement).max()))
    return worst


def _own(device: Device, j: int, made: Sequence[SimulatedBody]) -> Inertial:
    """The body of a link in the file's link frame."""
    frame, body = _file_frame(device, j), made[j]
    return Inertial(body.mass, np.asarray(body.com), np.asarray(body.inertia)).moved(inverse(frame))


def _lost(acts: Sequence[Effect], form: str, joints: int) -> list[str]:
    """What the format cannot say of the model, in sentences."""
    made: list[str] = []
    for k, act in enumerate(acts):
        lost = {"an offset": act.offset}
        if form == "urdf" or k >= joints:
            lost |= {"rotor inertia": act.armature, "a spring": act.stiffness}
        if k >= joints:
            lost |= {"viscous friction": act.viscous, "dry friction": act.coulomb}
        made += [f"Not in this file: {what} of {value!r} (SI) on {act.name}." for what, value in lost.items() if value]
    return made


@dataclass(frozen=True)
class _Edit:
    start: int
    end: int
    text: str


class _Editor:
    """Collects edits of a file's bytes."""

    def __init__(self, root: Element, content: bytes, of: MovingTree, index: Mapping[str, int], form: str) -> None:
        self.root, self.content, self.of, self.index, self.form = root, content, of, index, form
        self.edits: list[_Edit] = []
        self.notes: list[str] = []
        tags = ("link", "joint") if form == "urdf" else ("body", "joint")
        found = [x for x in (root.children if form == "urdf" else root.walk()) if x.tag in tags]
        self.elements = {(x.tag, x.attributes.get("name", "")): x for x in found if x.attributes.get("name")}

    def joint(self, name: str, link: str, body: Inertial, acts: Sequence[Effect]) -> None:
        """Replace the body of a joint's link, of links fixed to it, and the joint's own constants."""
        here = next(k for k, one in enumerate(self.of.moving) if one.joint.name == name)
        if not self.of.moving[here].massless:
            self._body(link, body)
            for other, (at, _) in self.of.frames.items():
                if at == here and other != link:
                    self._body(other, None)
        act = acts[self.index[name]]
        element = self._element("joint", name)
        if self.form == "urdf":
            given = element.first("dynamics")
            text = f'<dynamics damping="{act.viscous!r}" friction="{act.coulomb!r}"/>'
            if given is not None:
                self.edits.append(_Edit(given.start, given.end, text))
            elif act.viscous or act.coulomb:
                self._insert(element, text)
        else:
            values = {key: float(getattr(act, attribute)) for key, attribute in _MJCF_KEYS.items()}
            joint = self.of.moving[here].joint
            for key, part in (("armature", joint.motor_armature), ("damping", joint.motor_damping)):
                if part > values[key]:
                    self.notes.append(f"The actuator of joint {name} has more {key} than the model: {part!r} (SI).")
                values[key] = max(values[key] - part, 0.0)
            if act.stiffness:
                values["springref"] = float(act.rest)
            self._attributes(element, values)

    def _element(self, tag: str, name: str) -> Element:
        found = self.elements.get((tag, name))
        if found is None:
            what = f"its <{tag}> of {name!r} is not in this file by that name"
            raise _cannot(Path(self.root.file), what, "Name it, and write included files and replicates out.")
        return found

    def _body(self, link: str, body: Inertial | None) -> None:
        """Replace, add or remove the inertial of a link."""
        source = self.of.tree.links[link]
        if self.form == "mjcf" and body is None and source.inertial is None:
            return
        element = self._element("link" if self.form == "urdf" else "body", link)
        old = element.first("inertial")
        if body is None or body.mass == 0:
            if old is not None and self.form == "urdf":
                self.edits.append(_Edit(old.start, old.end, ""))
                self.notes.append(f"The inertia of link {link} is in that of the link it is fixed to.")
            if self.form == "urdf":
                return
            body = Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
        own = body.moved(inverse(source.own_frame))
        text = _urdf_inertial(own) if self.form == "urdf" else _mjcf_inertial(own)
        if old is not None:
            self.edits.append(_Edit(old.start, old.end, text))
        else:
            self._insert(element, text)

    def _insert(self, element: Element, text: str) -> None:
        """Add a child to an element, after its start tag."""
        line = self.content[: element.start].rpartition(b"\n")[2].decode(errors="replace")
        indent = "\n" + line[: len(line) - len(line.lstrip())] + "  "
        tag = self.content[element.start : element.end]
        if tag.endswith(b"/>") and not element.children:
            inside = tag[:-2].decode().rstrip()
            self.edits.append(
                _Edit(element.start, element.end, f"{inside}>{indent}{text}{indent[:-2]}</{element.tag}>")
            )
        else:
            at = element.children[0].start if element.children else element.open_end
            self.edits.append(_Edit(at, at, text + (indent if element.children else "")))

    def _attributes(self, element: Element, values: Mapping[str, float]) -> None:
        """Set attributes of a start tag."""
        end = min([child.start for child in element.children] + [element.end])
        tag = self.content[element.start : end].decode()
        for key, value in values.items():
            pattern = re.compile(rf"""(\s){key}\s*=\s*("[^"]*"|'[^']*')""")
            if pattern.search(tag):
                tag = pattern.sub(rf'\g<1>{key}="{value!r}"', tag, count=1)
            elif value or self.form == "mjcf":  # defaults of a class would hold otherwise
                tag = re.sub(rf"^<{element.tag}\b", f'<{element.tag} {key}="{value!r}"', tag, count=1)
        self.edits.append(_Edit(element.start, end, tag))

    def result(self, comment: str) -> bytes:
        """The file with all edits, and a comment above its root."""
        at = self.root.start
        made = sorted([*self.edits, _Edit(at, at, comment + "\n")], key=lambda edit: (edit.start, edit.end))
        parts: list[bytes] = []
        done = 0
        for edit in made:
            parts += [self.content[done : edit.start], edit.text.encode()]
            done = edit.end
        return b"".join([*parts, self.content[done:]])


def _entries(body: Inertial) -> dict[str, float]:
    J = body.inertia
    return {"xx": J[0, 0], "yy": J[1, 1], "zz": J[2, 2], "xy": J[0, 1], "xz": J[0, 2], "yz": J[1, 2]}


def _urdf_inertial(body: Inertial) -> str:
    entries = " ".join(f'i{key}="{float(value)!r}"' for key, value in _entries(body).items())
    origin = f'<origin xyz="{numbers(body.com)}" rpy="0 0 0"/>'
    return f'<inertial>{origin}<mass value="{body.mass!r}"/><inertia {entries}/></inertial>'


def _mjcf_inertial(body: Inertial) -> str:
    if body.mass == 0:
        return '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'
    entries = numbers(tuple(_entries(body).values()))
    return f'<inertial pos="{numbers(body.com)}" mass="{body.mass!r}" fullinertia="{entries}"/>'


def _verify(
    model: DynamicModel, chi: Array, made: Sequence[SimulatedBody], of: MovingTree, index: Mapping[str, int], path: Path
) -> None:
    """Compare torques of the written bodies with those of the model's links at random states.

    Raises:
        ExportError: they differ.
    """
    device = model.device
    rng = np.random.default_rng(5)
    qa = device.closure.draw(rng, _STATES)
    qda, qdda = rng.uniform(-2, 2, (2, *qa.shape))
    motion = model.tree(qa, qda, qdda)
    links = {one.joint.child: _own(device, index[one.joint.name], made) for one in of.moving if not one.massless}
    first = of.moving[0]  # gravity may have been changed in the device file; its base may have another orientation
    joint = device.joints[index[first.joint.name]]
    turn = first.placement[:3, :3] @ (joint.rotation @ joint.frame_rotation).T
    of = replace(of, tree=replace(of.tree, gravity=of.base[:3, :3] @ turn @ device.gravity))
    names = [one.joint.name for one in of.moving]
    by_name = [{name: x[index[name]] for name in names} for x in motion]
    own = tree_torque(of.with_bodies(links), by_name[0], by_name[1], by_name[2], friction=False)
    own -= np.array([one.joint.armature * by_name[2][one.joint.name] for one in of.moving])
    own -= np.array([x.stiffness * (by_name[0][x.name] - x.rest) for x in (one.joint for one in of.moving)])
    for k, name in enumerate(names):
        own[k] += made[index[name]].moved * by_name[2][name]
    G = np.broadcast_to(np.asarray(device.closure.follow(qa, qda).G), (_STATES, len(device.joints), len(device.active)))
    rows = np.einsum("ra,nja->nrj", np.linalg.inv(device.row_map).T, G[:, [index[name] for name in names]])
    found = np.einsum("nrj,jn->rn", rows, own)
    raw = np.array(device.parameters.S @ chi)
    raw[10 * len(device.joints) :] = 0.0
    c, cd, cdd = (np.ascontiguousarray(device.row_map @ x) for x in (qa, qda, qdda))
    wanted = core_torque(model, raw, c, cd, cdd)
    error = float(np.abs(found - wanted).max() / (np.abs(wanted).max() or 1.0))
    if not error < SAME_TORQUE:
        raise _cannot(path, f"torques of the written bodies differ by {error:.1e}", "Please report this with the file.")
