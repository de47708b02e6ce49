"""A reduced tree as the text of a device file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.geometry import angles, least_turn
from haptid.device.parameters import INERTIAL
from haptid.device.parts import Joint
from haptid.device.priors import PriorBody, inertial_parameters
from haptid.device.toml.reader import BASE
from haptid.robot_files.loops import Hinge, OpenLoops, opened_loops
from haptid.robot_files.moving_tree import Moving, MovingTree
from haptid.robot_files.tree import Drive, Inertial, Note
from haptid.robot_files.xml import refused

# Longest name that a device file allows, and longest line of a comment.
_LONGEST_NAME, _WIDTH = 40, 116
# Standard deviation of bodies that the source computes from shapes and a density, per cent.
GUESSED_PERCENT = 50.0
# Limits of this size or more are none, in SI: descriptions write 1e16 for it.
_UNLIMITED = 1e9
# Most collision shapes of a device file.
_MOST_SHAPES = 500
# Numbers below this share of a description's size are rounding.
_ROUNDING = 1e-15
_STEMS = {"armature": "IA", "damping": "FV", "friction": "FC", "stiffness": "K"}
_KINDS = {"armature": "rotor-inertia", "damping": "viscous", "friction": "coulomb", "stiffness": "spring"}


@dataclass(frozen=True)
class DeviceText:
    """The text of a device file, and what became of the source's names.

    Attributes:
        text: TOML.
        names: names in the device of the source's joints.
        notes: all notes, those of the loops included.
    """

    text: str
    names: Mapping[str, str]
    notes: tuple[Note, ...]


def device_text(
    of: MovingTree, priors: bool = True, torque_constant: Mapping[str, float] | float | None = None
) -> DeviceText:
    """The device file of what moves of a tree.

    Args:
        of: the tree.
        priors: whether bodies, friction and springs of the source become prior values.
        torque_constant: torque at each joint per ampere, by the source's names or one for all; None: commands are
            torques.

    Raises:
        RobotFileError: a joint has no torque constant, one names no driven joint, or it is zero or not finite.
    """
    loops = opened_loops(of)
    hinges = [hinge.name for hinge in loops.hinges]
    names = clean_names([*hinges, *(f"tendon {x.name}" for x in of.tendons)])
    notes = (*of.tree.notes, *_drive_notes(of, loops))
    writer = _Writer(of, loops, names)
    motors = writer.motors(torque_constant)
    body = [*writer.joints(), *writer.relations(), *writer.cuts(), *motors, *writer.terms()]
    body += [*writer.symmetry(), *writer.collision()]
    if priors:
        body += writer.priors()
    head = [*_heading(of, notes), *writer.top()]
    return DeviceText("\n".join([*head, *body]).rstrip() + "\n", {name: names[name] for name in hinges}, notes)


def clean_names(names: Iterable[str]) -> dict[str, str]:
    """Names of a device file for names of a source: other characters replaced, shortened, unique.

    No parameter of one joint gets the name of another joint's: `MX` of joint `1` is not `M` of joint `X1`.
    """
    made: dict[str, str] = {}
    taken: set[str] = set()
    stems = (*INERTIAL, *_STEMS.values())
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_")[:_LONGEST_NAME] or "joint"
        found, k = plain, 2
        while found == BASE or any(stem + found in taken for stem in stems):
            found, k = f"{plain[: _LONGEST_NAME - 4]}_{k}", k + 1
        taken |= {stem + found for stem in stems}
        made[name] = found
    return made


def _heading(of: MovingTree, notes: Sequence[Note]) -> list[str]:
    file = of.tree.file.replace("\\", "/").rpartition("/")[2]
    made = [f"# Imported from {plain_text(file)} ({of.tree.form})."]
    for grade in ("approximate", "left out", "exact"):
        said = [note for note in notes if note.grade == grade]
        if said:
            made += ["#", f"# {grade.capitalize()}:"]
        for note in said:
            at = "" if note.line is None else f"line {note.line}: "
            made.append(f"# - {at}{plain_text(note.text)}"[: 10 * _WIDTH])
    return [*made, ""]


def plain_text(text: str) -> str:
    """Text on one line without control characters."""
    return "".join(c if c.isprintable() else " " for c in text)


def quoted(text: str) -> str:
    """A basic string of TOML."""
    return json.dumps(plain_text(text), ensure_ascii=False)


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _angle(value: float) -> str:
    """An angle as a number, or as arithmetic where it is a multiple of a quarter turn."""
    quarters = round(value / (math.pi / 2))
    if quarters and abs(value - quarters * math.pi / 2) < 4e-16:
        text = {1: "pi/2", 2: "pi"}.get(abs(quarters), f"{abs(quarters)}*pi/2")
        return f'"{"-" if quarters < 0 else ""}{text}"'
    return _number(value)


def _vector(values: Iterable[float]) -> str:
    return "[" + ", ".join(map(_number, values)) + "]"


def _without_rounding(values: Array, size: float) -> Array:
    return np.where(np.abs(values) < _ROUNDING * size, 0.0, values)


def _placement(frame: Array) -> list[str]:
    made: list[str] = []
    if frame[:3, 3].any():
        made.append(f"xyz = {_vector(frame[:3, 3])}")
    rpy = angles(_without_rounding(frame[:3, :3], 1.0))
    if any(rpy):
        made.append(f"rpy = [{', '.join(map(_angle, rpy))}]")
    return made


def _drive_notes(of: MovingTree, loops: OpenLoops) -> list[Note]:
    said: list[Note] = []
    known = any(one.joint.actuated for one in of.moving)
    moved = loops.passive | {relation.joint for relation in of.follows}
    idle = [x.joint.name for x in of.moving if known and not x.joint.actuated and x.joint.name not in moved]
    if idle:
        text = (
            f"the source has no motor for {', '.join(idle)}; the device measures their torques too. Where nothing "
            'drives them, write torque = "zero" in their [[joints]], and delete their [[motors]] if the file has any'
        )
        said.append(Note("approximate", text))
    return said


class _Writer:
    """Writes the tables of one device file."""

    def __init__(self, of: MovingTree, loops: OpenLoops, names: Mapping[str, str]) -> None:
        self.of, self.loops, self.names = of, loops, names
        self.moving = {one.joint.name: one for one in of.moving}
        self.dh = all(one.joint.keys is not None for one in of.moving)
        self.passive = loops.passive | {relation.joint for relation in of.follows}

    def top(self) -> list[str]:
        """Keys above all tables."""
        tree = self.of.tree
        gravity = self.of.base[:3, :3].T @ tree.gravity
        gravity = _without_rounding(gravity, float(np.abs(gravity).max()))
        lengths = [f"{name} = {quoted(x) if isinstance(x, str) else _number(x)}" for name, x in tree.lengths.items()]
        return [
            "schema = 1",
            f"name = {quoted(tree.name[:200])}",
            f"gravity = {_vector(gravity)}",
            f'convention = "{"modified-dh" if self.dh else "placement"}"',
            "",
            *(["[lengths]", *lengths, ""] if lengths else []),
        ]

    def joints(self) -> list[str]:
        """[[joints]]."""
        made: list[str] = []
        for hinge in self.loops.hinges:
            made += [*self._joint(hinge, self.moving.get(hinge.name)), ""]
        return made

    def _joint(self, hinge: Hinge, one: Moving | None) -> list[str]:
        name = self.names[hinge.name]
        made = ["[[joints]]", f'name = "{name}"']
        if one is not None and one.joint.name != name:
            made.append(f"alias = {quoted(hinge.name[:2000])}")
        made.append(f'parent = "{self._body(hinge.parent)}"')
        if hinge.prismatic:
            made.append('type = "prismatic"')
        if self.dh and one is not None and one.joint.keys is not None:
            made += [f"{key} = {quoted(x) if isinstance(x, str) else _number(x)}" for key, x in one.joint.keys.items()]
        else:
            made += [*_placement(hinge.placement), f"axis = {_vector(_without_rounding(hinge.axis, 1.0))}"]
        if one is None or one.massless:
            made.append("body = false")
        limits: list[str] = []
        if one is not None:
            if one.joint.limits is not None and max(map(abs, one.joint.limits)) < _UNLIMITED:
                limits.append(f"position = {_vector(one.joint.limits)}")
            limits += [
                f"{key} = {_number(value)}"
                for key, value in (("velocity", one.joint.velocity), ("torque", one.joint.effort))
                if value is not None and value < _UNLIMITED
            ]
        return [*made, *([f"limits = {{ {', '.join(limits)} }}"] if limits else [])]

    def _body(self, index: int) -> str:
        return BASE if index < 0 else self.names[self.loops.hinges[index].name]

    def relations(self) -> list[str]:
        """[[loops]] of joints that follow others."""
        made: list[str] = []
        for relation in self.of.follows:
            terms = [f"{_number(factor)}*q{self.names[name]}" for name, factor in relation.factors.items()]
            first = self.names[next(iter(relation.factors))] if relation.factors else ""
            terms += [f"{_number(factor)}*q{first}**{k}" for k, factor in enumerate(relation.powers, 2) if factor]
            terms += [_number(relation.offset)] if relation.offset or not terms else []
            text = f"q{self.names[relation.joint]} = {' + '.join(terms)}".replace("+ -", "- ")
            made += ["[[loops]]", f'relations = ["{text}"]', ""]
        return made

    def cuts(self) -> list[str]:
        """[[loops]] with cuts."""
        made: list[str] = []
        at = {
            hinge.name: hinge.reference
            for hinge in self.loops.hinges
            if hinge.name not in self.passive and hinge.reference
        }
        references = {hinge.name: hinge.reference for hinge in self.loops.hinges}
        for loop in self.loops.loops:
            guess = {name: references[name] for name in loop.passive}
            made += ["[[loops]]", f"passive = [{', '.join(quoted(self.names[x]) for x in loop.passive)}]"]
            for key, values in (("guess", guess), ("at", at)):
                if values:
                    inside = ", ".join(f"{self.names[name]} = {_number(x)}" for name, x in values.items())
                    made.append(f"{key} = {{ {inside} }}")
            made += ["[loops.cut]", f'type = "{loop.kind}"']
            for letter, body, frame in (("a", loop.body_a, loop.frame_a), ("b", loop.body_b, loop.frame_b)):
                made.append(f'body_{letter} = "{self._body(body)}"')
                made.append(f"frame_{letter} = {{ {', '.join(_placement(frame))} }}")
            made.append("")
        return made

    def motors(self, constant: Mapping[str, float] | float | None) -> list[str]:
        """[[motors]], if any has a gear, turns several joints or is commanded in A; others drive a joint directly."""
        drives = [x for x in self.of.tree.drives if self._drivable(x)]
        if constant is None and all(drive.gear_ratio == 1 and len(drive.factors) == 1 for drive in drives):
            return []
        driven = {name for drive in drives for name in drive.factors}
        active = [hinge.name for hinge in self.loops.hinges if hinge.name not in self.passive]
        drives += [Drive(name, {name: 1.0}) for name in active if name not in driven]
        drives.sort(key=lambda drive: min(active.index(name) for name in drive.factors))
        names = _motor_names(drives, self.names)
        made: list[str] = []
        for drive, name in zip(drives, names, strict=True):
            made += ["[[motors]]", f'name = "{name}"']
            factors = ", ".join(f"{self.names[joint]} = {_number(x)}" for joint, x in drive.factors.items())
            if factors != f"{name} = 1.0":
                made.append(f"drives = {{ {factors} }}")
            made.append(f"gear_ratio = {_number(drive.gear_ratio)}")
            if constant is not None:
                at_joint = self._constant(constant, next(iter(drive.factors)), drive)
                made += [f"torque_constant = {_number(at_joint / drive.gear_ratio)}", 'command_unit = "A"']
            made.append("")
        if isinstance(constant, Mapping) and (unknown := set(constant) - {x for one in drives for x in one.factors}):
            found = f"no motor drives {sorted(unknown)[0]!r}, which has a torque constant"
            raise refused(self.of.tree.file, found, f"Driven joints: {', '.join(active)}.")
        return made

    def _constant(self, given: Mapping[str, float] | float, joint: str, drive: Drive) -> float:
        value = given.get(joint) if isinstance(given, Mapping) else given
        if value is None or not 0 < abs(value) < math.inf:
            found = f"the motor of joint {joint!r} has {'no torque constant' if value is None else f'{value:g} N m/A'}"
            raise refused(self.of.tree.file, found, "Give one number for all joints, or one for each.", drive.line)
        return value

    def _drivable(self, drive: Drive) -> bool:
        return all(name in self.moving and name not in self.passive for name in drive.factors)

    def terms(self) -> list[str]:
        """[[terms]]: what the source has values for, and friction of the active joints, which every robot has."""
        made: list[str] = []
        symoro = self.of.tree.form == "symoro"
        for key, kind in (("armature", "rotor-inertia"), ("damping", "viscous"), ("friction", "coulomb")):
            joints = [x for x in self.moving if getattr(self.moving[x].joint, key)]
            joints += [x for x in self.of.tree.open_terms.get(kind, ()) if x in self.moving and x not in joints]
            if kind != "rotor-inertia" and not symoro:
                joints += [x for x in self.moving if x not in self.passive and x not in joints]
            if joints:
                listed = ", ".join(quoted(self.names[name]) for name in joints)
                made += ["[[terms]]", f'kind = "{kind}"', f"joints = [{listed}]", ""]
            if kind == "rotor-inertia":
                made += self._rotors([x for x in self.moving if x not in self.passive and x not in joints])
        for name, one in self.moving.items():
            if one.joint.stiffness:
                made += ["[[terms]]", 'kind = "spring"', f'joints = ["{self.names[name]}"]']
                made += [f"rest = {_number(one.joint.rest)}", ""]
        for tendon in self.of.tendons:
            name = self.names[f"tendon {tendon.name}"]
            factors = ", ".join(f"{self.names[joint]} = {_number(x)}" for joint, x in tendon.factors.items())
            made += ["[[coordinates]]", f'name = "{name}"', f"joints = {{ {factors} }}", ""]
            for key, kind in _KINDS.items():
                if getattr(tendon, key):
                    made += ["[[terms]]", f'kind = "{kind}"', f'coordinates = ["{name}"]']
                    made += [f"rest = {_number(tendon.rest)}"] if kind == "spring" else []
                    made.append("")
        return made

    def _rotors(self, joints: Sequence[str]) -> list[str]:
        """The term of rotor inertia at joints of which the source has none, to uncomment."""
        if not joints:
            return []
        listed = ", ".join(quoted(self.names[name]) for name in joints)
        return [
            "# The description has no rotor inertia of these joints: that of the motor, times the square of its gear",
            "# ratio. haptid identifies it with this term, which geared motors need; without it, it is in the links.",
            *("# [[terms]]", '# kind = "rotor-inertia"', f"# joints = [{listed}]", ""),
        ]

    def symmetry(self) -> list[str]:
        """[[symmetry]] of rods that may spin: parameters that no torque shows."""
        made: list[str] = []
        for name in sorted(self.of.spinning):
            joint = next(x for x in self.of.tree.joints if x.name == name)
            k, frame = self.of.frames[joint.child]
            if k < 0:
                continue
            one = self.of.moving[k].joint
            line = least_turn(one.axis)[:3, :3].T @ frame[:3, :3] @ joint.axis
            along = "XYZ"[int(np.argmax(np.abs(line)))]
            others = [letter for letter in "XYZ" if letter != along]
            link = self.names[one.name]
            zero = [kind + link for kind in ("XY", "XZ", "YZ", along * 2, *(f"M{x}" for x in others))]
            made += ["[[symmetry]]", f'reason = "a rod that spins freely about its line, {along} of link {link}"']
            made += [f"zero = {json.dumps(zero)}", f"equal = {json.dumps([[x * 2 + link for x in others]])}", ""]
        return made

    def collision(self) -> list[str]:
        """[[collision]]: shapes of all links that are kept, those of the base too."""
        made: list[str] = []
        at = {hinge.name: k for k, hinge in enumerate(self.loops.hinges)}
        others = [name for name in self.of.frames if self.of.tree.links[name].other_shapes]
        if others:
            text = (
                f"# Collision meshes (or shapes without a size) are not imported, of: {plain_text(', '.join(others))}"
            )
            made += [text[: 10 * _WIDTH], "# Describe these links by shapes or hulls of points of your own.", ""]
        count = sum(len(self.of.tree.links[name].shapes) for name in self.of.frames)
        if count > _MOST_SHAPES:
            text = f"# {count} collision shapes are not imported: a device file has at most {_MOST_SHAPES}."
            return [*made, text, ""]
        for name, (moving, frame) in self.of.frames.items():
            for shape in self.of.tree.links[name].shapes:
                link = BASE if moving < 0 else self._body(at[self.of.moving[moving].joint.name])
                made += ["[[collision]]", f'link = "{link}"', f'kind = "{shape.kind}"']
                if shape.kind == "box":
                    made.append(f"size = {_vector(shape.sizes)}")
                else:
                    keys = zip(("radius", "length"), shape.sizes, strict=False)
                    made += [f"{key} = {_number(value)}" for key, value in keys]
                made += [*_placement(frame @ shape.frame), ""]
        return made

    def priors(self) -> list[str]:
        """[prior] and [[prior.bodies]]."""
        values = {
            stem + self.names[name]: float(getattr(one.joint, key))
            for key, stem in _STEMS.items()
            for name, one in self.moving.items()
            if getattr(one.joint, key)
        }
        values |= {
            stem + self.names[f"tendon {tendon.name}"]: float(getattr(tendon, key))
            for key, stem in _STEMS.items()
            for tendon in self.of.tendons
            if getattr(tendon, key)
        }
        bodies: list[str] = []
        for name, one in self.moving.items():
            if one.body is None or one.massless:
                continue
            if not _is_body(one.body):
                values |= _entries(one, self.names[name])
                continue
            J, mass = one.body.inertia, one.body.mass
            bodies += ["[[prior.bodies]]", f'link = "{self.names[name]}"', f"mass = {_number(mass)}"]
            bodies.append(f"com = {_vector(one.body.com)}")
            bodies.append(f"inertia = {_vector((J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]))}")
            bodies += [f"std_percent = {GUESSED_PERCENT}"] if one.body.guessed else []
            bodies.append("")
        named = ["[prior]", *(f"{name} = {_number(value)}" for name, value in values.items()), ""] if values else []
        return [*named, *bodies]


def _is_body(body: Inertial) -> bool:
    """Whether a device file accepts it: a mass, and no negative principal moment."""
    least = float(np.linalg.eigvalsh(body.inertia)[0])
    return body.mass > 0 and least >= -1e-10 * float(np.trace(np.abs(body.inertia)))


def _entries(one: Moving, name: str) -> dict[str, float]:
    """Standard parameters by name, of what no rigid body has: they are priors one by one."""
    assert one.body is not None
    R = least_turn(one.joint.axis)[:3, :3].T
    zero = np.zeros(3)
    joint = Joint(name, -1, False, np.eye(3), zero, True, None, None, None, R, zero)
    body = PriorBody(one.body.mass, one.body.com, one.body.inertia)
    return {kind + name: float(x) for kind, x in zip(INERTIAL, inertial_parameters(body, joint), strict=True)}


def _motor_names(drives: Sequence[Drive], names: Mapping[str, str]) -> list[str]:
    """Names of motors: of the joint that one drives alone, else the source's."""
    made: list[str] = []
    for drive in drives:
        single = len(drive.factors) == 1
        name = names[next(iter(drive.factors))] if single else next(iter(clean_names([drive.name]).values()))
        while name in made or (not single and name in names.values()):
            name = f"{name[: _LONGEST_NAME - 2]}_m"
        made.append(name)
    return made
