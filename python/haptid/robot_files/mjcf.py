"""MJCF: checked for replication and outside files, compiled by MuJoCo in a child process, read joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.numerals import whole_number
from haptid.device.geometry import shift
from haptid.robot_files.limited import run_limited
from haptid.robot_files.paths import Roots
from haptid.robot_files.tree import (
    ClosingJoint,
    Drive,
    Follows,
    Inertial,
    JointKind,
    LinkShape,
    Note,
    RobotLink,
    RobotTree,
    Tendon,
    TreeJoint,
    motion,
    snapped_axis,
)
from haptid.robot_files.xml import Element, checked_ratio, parse, read_bytes, refused

# Most elements that <replicate> may make, and most files that are included.
MOST_REPLICATES, MOST_INCLUDES = 20_000, 200
_WORLD = "world"
_KINDS: Mapping[str, JointKind] = {"hinge": "revolute", "slide": "prismatic", "ball": "spherical", "free": "floating"}


def read_mjcf(path: Path, roots: Roots, snap: float = 0.0) -> RobotTree:
    """The tree of an MJCF.

    Args:
        path: of the file.
        roots: folders that it may include files from.
        snap: rotations nearer than this to quarter turns are made such, rad.

    Raises:
        MissingDependencyError: MuJoCo is not installed.
        RobotFileError: what is wrong, as found here or by MuJoCo.
    """
    lines = _scan(path, roots)
    request = {"path": str(path.resolve()), "folders": [str(folder) for folder in roots.allowed]}
    compiled = run_limited("mjcf", request, roots.allowed, roots.file, "robots")
    return _Walk(compiled, lines, roots.file, path.stem, snap).tree()


def _scan(path: Path, roots: Roots) -> dict[tuple[str, str], int]:
    """Lines of named elements of the main file; refuses includes outside the roots, and replicates that explode."""
    lines: dict[tuple[str, str], int] = {}
    waiting, seen = [path.resolve()], set[Path]()
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        if len(seen) > MOST_INCLUDES:
            raise refused(roots.file, f"it includes more than {MOST_INCLUDES} files", "Include fewer.")
        root = parse(read_bytes(file), roots.file if file == path.resolve() else str(file))
        _count(root)
        for element in root.walk():
            if file == path.resolve() and "name" in element.attributes:
                lines.setdefault((element.tag, element.attributes["name"]), element.line)
            if element.tag in ("include", "model") and (name := element.attributes.get("file")):
                waiting.append(roots.resolved(name, path.resolve().parent, element.line))
    return lines


def _count(root: Element) -> None:
    """Refuse replicates that make more elements than any robot has."""
    total, stack = 0, [(root, 1)]
    while stack:
        element, copies = stack.pop()
        if element.tag in ("replicate", "composite", "flexcomp"):
            for word in element.attributes.get("count", "1").split():
                count = whole_number(word)
                copies *= MOST_REPLICATES + 1 if count is None else max(1, count)
        total += copies
        if copies > MOST_REPLICATES or total > 50 * MOST_REPLICATES:
            element.refuse(f"makes {copies} copies; at most {MOST_REPLICATES} are read", "Replicate less.")
        stack.extend((child, copies) for child in element.children)


class _Walk:
    """Walks a compiled model."""

    def __init__(
        self, compiled: Mapping[str, Any], lines: Mapping[tuple[str, str], int], file: str, title: str, snap: float
    ) -> None:
        self.of, self.lines, self.file, self.title, self.snap = compiled, lines, file, title, snap
        self.x = {name: np.array(values) for name, values in compiled["arrays"].items()}
        self.enums = {kind: {int(k): v for k, v in names.items()} for kind, names in compiled["enums"].items()}
        self.notes: list[Note] = []
        self.links: dict[str, RobotLink] = {_WORLD: RobotLink(_WORLD)}
        self.joints: list[TreeJoint] = []
        self.joint_names: dict[int, str] = {}
        self.follows: list[Follows] = []
        self.closing: list[ClosingJoint] = []
        self.body_links: list[tuple[str, Array]] = [(_WORLD, np.eye(4))]  # link of a body, and the body's frame in it

    def tree(self) -> RobotTree:
        """The tree."""
        driven, armature, damping = self._actuated()
        self._bodies(driven, armature, damping)
        self._shapes()
        self._equalities()
        self._left_out()
        gravity = np.zeros(3) if self.of["disabled"]["gravity"] else np.array(self.of["gravity"])
        return RobotTree(
            name=self.of["name"] or self.title,
            file=self.file,
            form="mjcf",
            gravity=gravity,
            links=self.links,
            joints=tuple(self.joints),
            follows=tuple(self.follows),
            closing=tuple(self.closing),
            drives=tuple(self._drives()),
            tendons=tuple(self._tendons()),
            notes=tuple(self.notes),
        )

    def _name(self, kind: str, k: int) -> str:
        return str(self.of["names"][kind][k]) or f"{kind} {k}"

    def _line(self, kind: str, k: int) -> int | None:
        name = self.of["names"][kind][k]
        tags = {"joint": ("joint", "freejoint"), "equality": ("connect", "weld", "joint", "tendon")}.get(kind, (kind,))
        if kind == "tendon":
            tags = ("fixed", "spatial")
        if kind == "actuator":
            tags = (
                "motor",
                "position",
                "velocity",
                "general",
                "intvelocity",
                "damper",
                "cylinder",
                "muscle",
                "adhesion",
            )
        return next((self.lines[tag, name] for tag in tags if (tag, name) in self.lines), None)

    def _bodies(self, driven: set[int], armature: Array, damping: Array) -> None:
        guessed = set(self.of["guessed"])
        told: list[str] = []
        for b in range(1, len(self.x["body_parentid"])):
            above, at = self.body_links[self.x["body_parentid"][b]]
            frame = at @ self._frame(self.x["body_pos"][b], self.x["body_quat"][b])
            name = self._name("body", b)
            first = int(self.x["body_jntadr"][b])
            count = int(self.x["body_jntnum"][b])
            for i in range(count):
                j = first + i
                link = name if i == count - 1 else f"{name} after {self._name('joint', j)}"
                self.links[link] = RobotLink(link, massless=i < count - 1)
                pos = self.x["jnt_pos"][j]
                self.joints.append(self._joint(j, above, link, frame @ shift(*pos), driven, armature, damping))
                above, frame = link, shift(*(-pos))
            if not count:
                self.links[name] = RobotLink(name)
                self.joints.append(TreeJoint(f"{name} mount", "fixed", above, name, frame, np.array([0.0, 0.0, 1.0])))
                above, frame = name, np.eye(4)
            mass = float(self.x["body_mass"][b])
            if mass > 0:
                local = self._frame(self.x["body_ipos"][b], self.x["body_iquat"][b], snap=0.0)
                body = Inertial(mass, np.zeros(3), np.diag(self.x["body_inertia"][b]), b in guessed)
                line = self._line("body", b)
                self.links[above] = RobotLink(above, body.moved(frame @ local), line=line, own_frame=frame)
                told += [name] if b in guessed else []
            self.body_links.append((above, frame))
            if self.x["body_gravcomp"][b]:
                text = f"gravity compensation of body {name}; its weight is modelled in full"
                self.notes.append(Note("left out", text, self._line("body", b)))
        if told:
            text = f"inertia of {', '.join(told)}: computed from shapes and a density, not from CAD"
            self.notes.append(Note("approximate", text))

    def _joint(
        self, j: int, above: str, link: str, frame: Array, driven: set[int], armature: Array, damping: Array
    ) -> TreeJoint:
        kind = _KINDS[self.enums["joint"][int(self.x["jnt_type"][j])]]
        name = self._name("joint", j)
        self.joint_names[j] = name
        at, dof = int(self.x["jnt_qposadr"][j]), int(self.x["jnt_dofadr"][j])
        axis = snapped_axis(np.array(self.x["jnt_axis"][j]), self.snap)
        axis = axis / np.linalg.norm(axis)
        common: dict[str, Any] = {"name": name, "kind": kind, "parent": above, "child": link, "axis": axis}
        if kind in ("spherical", "floating"):
            if kind == "floating":  # its frame is the body's own: qpos0 has the pose in the world
                frame = self._frame(self.x["qpos0"][at : at + 3], self.x["qpos0"][at + 3 : at + 7])
            return TreeJoint(**common, placement=frame, line=self._line("joint", j))
        ref = float(self.x["qpos0"][at])
        unmoved = TreeJoint(**common, placement=frame)
        off = self.of["disabled"]
        if np.any(self.x["jnt_stiffnesspoly"][j]) or np.any(self.x["dof_dampingpoly"][dof]):
            text = f"nonlinear stiffness or damping of joint {name}"
            self.notes.append(Note("left out", text, self._line("joint", j)))
        limited = bool(self.x["jnt_limited"][j])
        low, high = (float(v) for v in self.x["jnt_range"][j])
        effort = float(np.abs(self.x["jnt_actfrcrange"][j]).max()) if self.x["jnt_actfrclimited"][j] else 0.0
        return TreeJoint(
            **common,
            placement=frame @ motion(unmoved, -ref),
            limits=(low, high) if limited and low < high else None,
            effort=effort or None,
            damping=0.0 if off["damper"] else float(self.x["dof_damping"][dof]) + float(damping[j]),
            friction=0.0 if off["frictionloss"] else float(self.x["dof_frictionloss"][dof]),
            armature=float(self.x["dof_armature"][dof]) + float(armature[j]),
            stiffness=0.0 if off["spring"] else float(self.x["jnt_stiffness"][j]),
            motor_armature=float(armature[j]),
            motor_damping=0.0 if off["damper"] else float(damping[j]),
            rest=float(self.x["qpos_spring"][at]),
            reference=ref,
            actuated=j in driven,
            line=self._line("joint", j),
        )

    def _frame(self, pos: Array, quat: Array, snap: float | None = None) -> Array:
        """A pose, (4, 4), by position and quaternion w x y z."""
        w, x, y, z = (np.asarray(quat) / np.linalg.norm(quat)).tolist()
        made = np.eye(4)
        made[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        made[:3, 3] = pos
        nearest = np.round(made[:3, :3])
        limit = self.snap if snap is None else snap
        if np.abs(nearest).sum() == 3 and 0 < np.abs(made[:3, :3] - nearest).max() < max(limit, 1e-15):
            made[:3, :3] = nearest
        return made

    def _shapes(self) -> None:
        """Collision shapes of all links; meshes and other shapes that a device file does not have are counted."""
        meshes = set(self.of["meshes"])
        found: dict[str, list[LinkShape | None]] = {}
        for g, kind in enumerate(self.x["geom_type"]):
            if not (self.x["geom_contype"][g] or self.x["geom_conaffinity"][g]):
                continue
            link, at = self.body_links[int(self.x["geom_bodyid"][g])]
            name, (a, b, c) = self.enums["geom"][int(kind)], (float(x) for x in self.x["geom_size"][g])
            sizes = {"sphere": (a,), "capsule": (a, 2 * b), "cylinder": (a, 2 * b), "box": (2 * a, 2 * b, 2 * c)}
            shape = None
            if g not in meshes and name in sizes:
                frame = at @ self._frame(self.x["geom_pos"][g], self.x["geom_quat"][g])
                shape = LinkShape(cast(Any, name), sizes[name], frame)
            found.setdefault(link, []).append(shape)
        for link, shapes in found.items():
            given = tuple(shape for shape in shapes if shape is not None)
            self.links[link] = replace(self.links[link], shapes=given, other_shapes=len(shapes) - len(given))

    def _actuated(self) -> tuple[set[int], Array, Array]:
        """Joints that actuators drive, and armature and damping that actuators add to joints."""
        driven: set[int] = set()
        count = len(self.x["jnt_type"])
        armature, damping = np.zeros(count), np.zeros(count)
        for k, kind in enumerate(self.x["actuator_trntype"]):
            target, how = int(self.x["actuator_trnid"][k][0]), self.enums["transmission"][int(kind)]
            if how in ("joint", "jointinparent"):
                driven.add(target)
                if self.enums["joint"][int(self.x["jnt_type"][target])] in ("hinge", "slide"):
                    gear = self._gear(k)
                    armature[target] += gear**2 * float(self.x["actuator_armature"][k])
                    damping[target] += gear**2 * float(self.x["actuator_damping"][k])
            elif how == "tendon":
                driven |= set(self._tendon(target) or ())
        return driven, armature, damping

    def _tendon(self, t: int) -> dict[int, float] | None:
        """Coefficients of a fixed tendon by joint; None for a spatial one."""
        first, count = int(self.x["tendon_adr"][t]), int(self.x["tendon_num"][t])
        wraps = range(first, first + count)
        if any(self.enums["wrap"][int(self.x["wrap_type"][w])] != "joint" for w in wraps):
            return None
        return {int(self.x["wrap_objid"][w]): float(self.x["wrap_prm"][w]) for w in wraps}

    def _tendons(self) -> list[Tendon]:
        """Fixed tendons with stiffness, damping, friction or inertia; other tendons with such are left out."""
        made: list[Tendon] = []
        off = self.of["disabled"]
        keys = {"stiffness": "spring", "damping": "damper", "armature": "", "frictionloss": "frictionloss"}
        for t in range(len(self.x["tendon_adr"])):
            name, line = self._name("tendon", t), self._line("tendon", t)
            value = {key: 0.0 if off.get(flag) else float(self.x[f"tendon_{key}"][t]) for key, flag in keys.items()}
            nonlinear = np.any(self.x["tendon_stiffnesspoly"][t]) or np.any(self.x["tendon_dampingpoly"][t])
            low, high = (float(x) for x in self.x["tendon_lengthspring"][t])
            factors = self._tendon(t)
            if factors is None and (nonlinear or any(value.values())):
                has = " and ".join(key for key in keys if value[key]) or "nonlinear force"
                self.notes.append(
                    Note("left out", f"{has} of tendon {name}, whose length is no sum of positions", line)
                )
                continue
            if nonlinear or (value["stiffness"] and low < high):
                text = f"stiffness of tendon {name}, which is not linear"
                self.notes.append(Note("left out", text, line))
                value["stiffness"] = 0.0
            if factors and any(value.values()):
                named = {self.joint_names[j]: x for j, x in factors.items() if x}
                stiffness, damping, armature, friction = value.values()
                made.append(Tendon(name, named, stiffness, low, damping, friction, armature, line))
        return made

    def _drives(self) -> list[Drive]:
        """Plain motors with gears. Gears of position servos and of tendons that are not fixed say nothing of torque."""
        made: list[Drive] = []
        fixed, none = self.of["plain_gain"]
        for k, kind in enumerate(self.x["actuator_trntype"]):
            plain = self.x["actuator_gaintype"][k] == fixed and self.x["actuator_biastype"][k] == none
            how, target = self.enums["transmission"][int(kind)], int(self.x["actuator_trnid"][k][0])
            factors = {target: 1.0} if how in ("joint", "jointinparent") else None
            if how == "tendon":
                factors = self._tendon(target)
            name, line = self._name("actuator", k), self._line("actuator", k)
            if factors is None or any(
                self.enums["joint"][int(self.x["jnt_type"][j])] in ("ball", "free") for j in factors
            ):
                self.notes.append(Note("left out", f"actuator {name}, which acts on a {how}", line))
            elif how == "tendon":
                text = f"actuator {name} pulls several joints; their torques are taken as measured one by one"
                self.notes.append(Note("left out", text, line))
            elif plain:
                joint = self.joint_names[target]
                made.append(Drive(joint, {joint: 1.0}, self._gear(k) or 1.0, line))
        return made

    def _gear(self, k: int) -> float:
        """Gear ratio of an actuator; 0 where it has no effect."""
        gear = float(self.x["actuator_gear"][k][0])
        return gear and checked_ratio(
            gear, f"the gear of {self._name('actuator', k)}", self.file, self._line("actuator", k)
        )

    def _equalities(self) -> None:
        if self.of["disabled"]["equality"]:
            return
        for e, kind in enumerate(self.x["eq_type"]):
            form, name, line = self.enums["equality"][int(kind)], self._name("equality", e), self._line("equality", e)
            if not self.x["eq_active0"][e]:
                self.notes.append(Note("left out", f"{form} {name}, which is not active", line))
            elif form == "joint":
                self._joint_equality(e, name, line)
            elif form == "tendon":
                self._tendon_equality(e, name, line)
            elif form == "connect":
                self._connect(e, name, line)
            else:
                self.notes.append(Note("left out", f"equality {form} {name}", line))

    def _joint_equality(self, e: int, name: str, line: int | None) -> None:
        a, b = int(self.x["eq_obj1id"][e]), int(self.x["eq_obj2id"][e])
        data = self.x["eq_data"][e]
        zero = [float(self.x["qpos0"][int(self.x["jnt_qposadr"][j])]) if j >= 0 else 0.0 for j in (a, b)]
        if b >= 0 and np.any(data[2:5]):
            # y - y0 = sum of d_k (x - x0)^k, in powers of x.
            x0 = np.polynomial.Polynomial([-zero[1], 1.0])
            offset, factor, *powers = np.asarray((np.polynomial.Polynomial(data[:5])(x0) + zero[0]).coef).tolist()
            if self.joint_names[a] in {relation.joint for relation in self.follows}:
                text = f"equality {name}: {self.joint_names[a]} follows in two ways"
                self.notes.append(Note("left out", text, line))
                return
            made = {self.joint_names[b]: float(factor)}
            self.follows.append(Follows(self.joint_names[a], made, float(offset), line, tuple(powers)))
        elif b < 0 or data[1] == 0:
            self._follow({}, a, zero[0] + float(data[0]), line)
        else:
            self._follow({b: float(data[1])}, a, zero[0] + float(data[0] - data[1] * zero[1]), line)

    def _follow(self, factors: dict[int, float], joint: int, offset: float, line: int | None) -> None:
        """A relation, turned round where the follower has a motor and the other joint has none."""
        by_name = {joint.name: joint for joint in self.joints}
        taken = {relation.joint for relation in self.follows}
        if len(factors) == 1:
            (other, factor), *_ = factors.items()
            names = self.joint_names[joint], self.joint_names[other]
            backward = by_name[names[0]].actuated and not by_name[names[1]].actuated and names[1] not in taken
            if (backward or names[0] in taken) and factor:
                joint, factors, offset = other, {joint: 1 / factor}, -offset / factor
        made = Follows(self.joint_names[joint], {self.joint_names[j]: x for j, x in factors.items()}, offset, line)
        self.follows.append(made)

    def _tendon_equality(self, e: int, name: str, line: int | None) -> None:
        a, b = int(self.x["eq_obj1id"][e]), int(self.x["eq_obj2id"][e])
        data = self.x["eq_data"][e]
        first, second = self._tendon(a), ({} if b < 0 else self._tendon(b))
        if first is None or second is None or np.any(data[2:5]):
            self.notes.append(Note("left out", f"tendon equality {name}: spatial or polynomial", line))
            return
        # c . q - L0 = d0 + d1 (c' . q - L0'), solved for one joint.
        slope = 0.0 if b < 0 else float(data[1])
        lengths = [float(self.x["tendon_length0"][t]) if t >= 0 else 0.0 for t in (a, b)]
        total = dict(first)
        for j, x in second.items():
            total[j] = total.get(j, 0.0) - slope * x
        constant = lengths[0] + float(data[0]) - slope * lengths[1]
        total = {j: x for j, x in total.items() if x}
        by_name = {joint.name: joint for joint in self.joints}
        taken = {relation.joint for relation in self.follows}
        free = [j for j in total if self.joint_names[j] not in taken]
        if not free:
            self.notes.append(Note("left out", f"tendon equality {name}: all its joints follow others", line))
            return
        joint = min(free, key=lambda j: (bool(by_name[self.joint_names[j]].actuated), -j))
        factors = {j: -x / total[joint] for j, x in total.items() if j != joint}
        named = {self.joint_names[j]: x for j, x in factors.items()}
        self.follows.append(Follows(self.joint_names[joint], named, constant / total[joint], line))

    def _connect(self, e: int, name: str, line: int | None) -> None:
        a, b = int(self.x["eq_obj1id"][e]), int(self.x["eq_obj2id"][e])
        data = self.x["eq_data"][e]
        if int(self.x["eq_objtype"][e]) == self.of["site_type"]:
            points = [(int(self.x["site_bodyid"][s]), self.x["site_pos"][s]) for s in (a, b)]
        else:
            points = [(a, data[0:3]), (b, data[3:6])]
        with np.errstate(invalid="ignore"):  # a place that is not finite is refused with those of joints
            (link_a, at_a), (link_b, at_b) = (
                (self.body_links[body][0], self.body_links[body][1] @ shift(*point)) for body, point in points
            )
        self.closing.append(ClosingJoint(name, "spherical", link_a, at_a, link_b, at_b, line))

    def _left_out(self) -> None:
        if self.of["fluid"]:
            self.notes.append(Note("left out", "forces of the medium (option density, viscosity)"))
        if self.of["flexes"]:
            self.notes.append(Note("left out", f"{self.of['flexes']} flexible bodies"))
