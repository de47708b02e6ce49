"""import_robot: a robot description as a device file, checked against the description."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.errors import DeviceError, OutputFolderError, RobotFileError, suggestion
from haptid.robot_files.balls import with_ball_hinges, without_spin
from haptid.robot_files.check import Check, check, device_from
from haptid.robot_files.device_file import clean_names, device_text
from haptid.robot_files.loops import opened_loops
from haptid.robot_files.moving_tree import MovingTree, moving_tree
from haptid.robot_files.newton_euler import tree_torque
from haptid.robot_files.oracles import ask_others
from haptid.robot_files.read import read_robot
from haptid.robot_files.tree import Note, RobotTree
from haptid.robot_files.xml import refused

# Most joints of a device.
MOST_JOINTS = 120


@dataclass(frozen=True, eq=False)
class ImportedRobot:
    """A robot description as a device.

    Attributes:
        text: of the device file.
        device: that it describes.
        names: names in the device of the source's joints.
        notes: what is approximate, left out, or written in another way.
        check: comparison with the source.
        source: what moves of the source.
        snapped: change of the greatest torque by snapping angles, relative to it; None without snapping.
    """

    text: str
    device: Device
    names: Mapping[str, str]
    notes: tuple[Note, ...]
    check: Check
    source: MovingTree
    snapped: float | None

    @property
    def is_exact(self) -> bool:
        """Whether nothing of the source is approximate or left out."""
        return all(note.grade == "exact" for note in self.notes)

    @property
    def without_rotor(self) -> tuple[str, ...]:
        """Active joints that have no term of rotor inertia."""
        there = {term.on for term in self.device.terms if term.kind == "rotor"}
        names = (self.device.joints[k].name for k in self.device.active)
        return tuple(name for name in names if f"joint {name}" not in there)

    def to_dict(self) -> dict[str, Any]:
        """Notes, names and check as JSON values."""
        return {
            "source": self.source.tree.file,
            "format": self.source.tree.form,
            "exact": self.is_exact,
            "joints": {name: self.names[name] for name in self.names},
            "active": [self.device.joints[k].name for k in self.device.active],
            "notes": [{"grade": note.grade, "text": note.text, "line": note.line} for note in self.notes],
            "check": {
                "states": self.check.states,
                "torque": self.check.torque,
                "gap_m": self.check.gap,
                "others": dict(self.check.others),
            },
            "snapped": self.snapped,
        }

    def save(self, path: str | Path) -> None:
        """Write the device file; an existing file is replaced in one step.

        Raises:
            OutputFolderError: it cannot be written.
        """
        path = Path(path)
        try:
            if path.is_dir():
                raise IsADirectoryError(21, "it is a folder")
            with tempfile.NamedTemporaryFile("w", dir=path.resolve().parent, delete=False, encoding="utf-8") as stream:
                stream.write(self.text)
            os.chmod(stream.name, 0o644)
            os.replace(stream.name, path)
        except OSError as error:
            raise OutputFolderError(
                f"{path}: the device file cannot be written ({error.strerror or error}).",
                where=str(path),
                advice="Choose a path in an existing folder that you may write to.",
            ) from None


def import_robot(
    path: str | Path,
    *,
    root: str | None = None,
    tip: str | None = None,
    hold: Mapping[str, float] | None = None,
    only: Collection[str] | None = None,
    packages: Mapping[str, str | Path] | None = None,
    xacro_arguments: Mapping[str, str] | None = None,
    lengths: Mapping[str, float] | None = None,
    snap: float = 0.0,
    priors: bool = True,
    torque_constant: Mapping[str, float] | float | None = None,
    ask: bool = False,
) -> ImportedRobot:
    """A robot description as a device, compared with the description's own inverse dynamics.

    Args:
        path, packages, xacro_arguments, lengths, snap: as for `read_robot`.
        root: link that is the base; the description's root link if None.
        tip: last link of a chain; all joints that are not on the way to it are held.
        hold: positions at which joints are held, by name, of the description or of the device file, rad or m.
        only: joints that move, by name: all others are held, at zero where `hold` has no position; all move if None.
        priors: whether bodies, friction and springs of the description become prior values.
        torque_constant: torque at each joint per ampere of its motor's current, N m/A or N/A, one for all or by the
            names of the description: commands are then currents.
        ask: compare torques with MuJoCo or Pinocchio too, where they can read the file.

    Raises:
        RobotFileError: file and line, what was found and what to do; or the device differs from the description.
        LoopClosureError, SingularityError: its loops do not close, or are singular where it is drawn.
        MissingDependencyError: the format, or `ask`, needs an optional package.
    """
    given: dict[str, Any] = {"packages": packages, "xacro_arguments": xacro_arguments, "lengths": lengths}
    tree = read_robot(path, **given, snap=snap)
    own = _names_in(tree)
    hold = {own.get(name, name): position for name, position in hold.items()} if hold else hold
    hold = _but(tree, only and [own.get(name, name) for name in only], hold)
    of = _moving(tree, root, tip, hold)
    if len(of.moving) > MOST_JOINTS:
        found = f"{len(of.moving)} joints move; a device has at most {MOST_JOINTS}"
        raise refused(str(path), found, "Import a part of it, with a root and a tip, or hold joints.")
    made = device_text(of)
    try:
        device = device_from(made.text, f"{path} as a device")
        done, states = check(of, device, made.names)
    except RobotFileError:
        raise
    except DeviceError as error:
        error.add_note(f"{path} was read; the device that it describes cannot be built.")
        raise
    snapped = None
    if snap > 0:
        exact = _moving(read_robot(path, **given), root, tip, hold)
        torques = [tree_torque(x, states.q, states.qd, states.qdd) for x in (of, exact)]
        snapped = float(np.abs(torques[0] - torques[1]).max() / (np.abs(torques[1]).max() or 1.0))
    if ask and snap > 0:  # other programs do not snap
        unsnapped = device_text(exact)
        _, states = check(exact, device_from(unsnapped.text), unsnapped.names)
        done = replace(done, others=ask_others(Path(path), exact, states))
    elif ask:
        done = replace(done, others=ask_others(Path(path), of, states))
    if not priors or torque_constant is not None:
        made = device_text(of, priors, torque_constant)
        device = device_from(made.text, str(path))
    return ImportedRobot(made.text, device, made.names, made.notes, done, of, snapped)


def _names_in(tree: RobotTree) -> dict[str, str]:
    """Names of a description's joints by those that they get in the device file, where these are none of its own."""
    names = [joint.name for joint in with_ball_hinges(tree, ()).joints]
    return {clean: name for name, clean in clean_names(names).items() if clean not in names}


def _but(tree: RobotTree, only: Collection[str] | None, hold: Mapping[str, float] | None) -> Mapping[str, float] | None:
    """Positions of all joints that are held, where only these move, and what follows them."""
    if only is None:
        return hold
    hinges = with_ball_hinges(tree, hold or {}).joints
    names = [joint.name for joint in hinges]
    for name in only:
        if name not in names:
            raise refused(tree.file, f"it has no joint {name!r} to move", suggestion(name, names))
    moved = {*only, *(relation.joint for relation in tree.follows)}
    return {joint.name: 0.0 for joint in hinges if joint.moves and joint.name not in moved} | {**(hold or {})}


def _moving(tree: RobotTree, root: str | None, tip: str | None, hold: Mapping[str, float] | None) -> MovingTree:
    """What moves; spins of rods between ball joints, which nothing determines, are held."""
    for joint in tree.joints:
        if not (np.isfinite(joint.placement).all() and np.isfinite(joint.axis).all()):
            found = f"joint {joint.name} has an axis or a place that is not finite"
            raise refused(tree.file, found, "Correct its numbers.", joint.line)
    for cut in tree.closing:
        if not (np.isfinite(cut.frame_a).all() and np.isfinite(cut.frame_b).all()):
            found = f"the connection {cut.name} that closes a loop has a place that is not finite"
            raise refused(tree.file, found, "Correct its numbers.", cut.line)
    tree = with_ball_hinges(tree, hold or {})
    of = moving_tree(tree, root, tip, hold)
    loops = opened_loops(of)
    loose = [tendon for tendon in of.tendons if loops.passive & set(tendon.factors)]
    if loose:
        more = [Note("left out", f"tendon {x.name}, on joints that loops move", x.line) for x in loose]
        kept = tuple(tendon for tendon in tree.tendons if tendon.name not in {x.name for x in loose})
        return _moving(replace(tree, tendons=kept, notes=(*tree.notes, *more)), root, tip, hold)
    idle = loops.idle
    if not idle:
        return of
    thin, spinning = without_spin(tree, of.frames, {one.joint.name: k for k, one in enumerate(of.moving)}, idle)
    return replace(moving_tree(thin, root, tip, hold, idle), spinning=spinning)
