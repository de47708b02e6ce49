"""SYMORO (.par): trees and closed chains by modified Denavit-Hartenberg parameters.

Source: Khalil and Creusot (1997), SYMORO+, Robotica 15(2); loops are cut at joints that are listed twice, the second
time with sigma = 2.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Literal, NoReturn

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.numerals import whole_number
from haptid.device.expressions import number
from haptid.device.geometry import modified_dh
from haptid.device.toml.errors_at import Place
from haptid.errors import DeviceFileError
from haptid.robot_files.tree import (
    ClosingJoint,
    Inertial,
    Note,
    RobotLink,
    RobotTree,
    TreeJoint,
    snapped_angle,
)
from haptid.robot_files.xml import refused

_KEYS = ("gamma", "b", "alpha", "d", "theta", "r")
_ANGLES = ("gamma", "alpha", "theta")
_LONGEST = 1_000_000
# Angles of a SYMORO file have six digits or so: nearer than this to a quarter turn, they are one.
_WRITTEN = 1e-5
_TERMS = {"IA": "rotor-inertia", "FV": "viscous", "FS": "coulomb"}
_ENTRIES = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
# Characters of an entry, and names of lengths that a message lists.
_LONGEST_ENTRY, _MOST_LISTED = 200, 10
# Possessive, so that none is tried again within a long word that does not match.
_WORD = re.compile(r"[A-Za-z_]\w*+")
_EXPONENT = re.compile(r"(?<![\d.])[\d.]++[eE][+-]?\d++")
_COMMENT = re.compile(r"\(\*.*?(?:\*\)|\Z)", re.DOTALL)
_ASSIGNED = re.compile(r"\b(\w++)\s*+=\s*+(\{[^{}]*+\}|[^\s{]++)")


def read_symoro(content: bytes, file: str, lengths: Mapping[str, float], snap: float = 0.0) -> RobotTree:
    """The tree of a SYMORO file.

    Args:
        content: of the file.
        file: its name in errors.
        lengths: values of the lengths that the file names, m.
        snap: angles nearer than this to a quarter turn are made one, rad; at least 1e-5.

    Raises:
        RobotFileError: what is wrong, or which lengths need a value.
    """
    return _Par(content[:_LONGEST].decode("utf-8", errors="replace"), file, lengths, max(snap, _WRITTEN)).tree()


class _Par:
    """Reads one file."""

    def __init__(self, text: str, file: str, lengths: Mapping[str, float], snap: float) -> None:
        self.file, self.given, self.snap = file, dict(lengths), snap
        plain = _COMMENT.sub("", text)
        self.title = next((x.strip() for x in re.findall(r"\(\*\s*Robotname\s*=\s*'([^']*)'", text)), "") or "robot"
        self.values: dict[str, list[str] | str] = {}
        for key, value in _ASSIGNED.findall(plain):
            self.values[key] = [x.strip() for x in value[1:-1].split(",")] if value[0] == "{" else value.strip()
        self.bodies, self.joint_count, self.frame_count = (self._count(key) for key in ("NL", "NJ", "NF"))
        if not self.bodies <= self.joint_count <= self.frame_count or self.frame_count > 1000 or self.bodies < 1:
            self._refuse("its NL, NJ and NF are not links, joints and frames of a mechanism", "NL <= NJ <= NF.")
        if self.frame_count != 2 * self.joint_count - self.bodies:
            self._refuse("it has not one frame for each joint and a second one for each loop", "NF = 2 NJ - NL.")
        self.used: dict[str, float] = {}
        self.missing: set[str] = set()
        self.notes: list[Note] = []

    def _refuse(self, found: str, advice: str) -> NoReturn:
        raise refused(self.file, found, advice)

    def _count(self, key: str) -> int:
        value = self.values.get(key)
        count = whole_number(value, 4) if isinstance(value, str) else None
        if count is None:
            raise refused(self.file, f"it has no whole number {key}", f"Write {key} = ..., as SYMORO does.")
        return count

    def _list(self, key: str, least: int, default: str | None = None) -> list[str]:
        value = self.values.get(key)
        if value is None and default is not None:
            return [default] * least
        if not isinstance(value, list) or len(value) < least:
            raise refused(self.file, f"its {key} has fewer than {least} entries", f"Write {key} = {{...}}.")
        return value

    def _number(self, text: str, what: str) -> float:
        """A number, or arithmetic over named lengths."""
        if len(text) > _LONGEST_ENTRY:
            found = f"an entry of {what} has {len(text)} characters, more than {_LONGEST_ENTRY}"
            self._refuse(found, f"It begins with {text[:40]!r}: correct it.")
        for name in _WORD.findall(_EXPONENT.sub("0", text)):
            if name in self.given:
                self.used[name] = self.given[name]
            elif name.lower() != "pi":
                self.missing.add(name)
        if self.missing:
            return 0.0
        try:
            return number(text.replace("Pi", "pi"), self.given, Place(self.file, what))
        except DeviceFileError as error:
            raise refused(
                self.file, f"its {what} is {text[:60]!r}, which is no number ({error.found})", "Correct it."
            ) from None

    def tree(self) -> RobotTree:
        """The tree."""
        frames = self.frame_count
        ant = self._list("Ant" if "Ant" in self.values else "ant", frames)
        sigma = self._list("Sigma" if "Sigma" in self.values else "sigma", frames)
        columns = {key: self._list(key if key in self.values else key.capitalize(), frames, "0") for key in _KEYS}
        above = [self._parent(text, k) for k, text in enumerate(ant)]
        placed = [self._frame(k, columns, sigma[k]) for k in range(frames)]
        gravity = [self._gravity(text) for text in self._list("G", 3, "0")[:3]]
        if self.missing:
            missing = sorted(self.missing)[:_MOST_LISTED]
            more = len(self.missing) - len(missing)
            listed = ", ".join(missing) + (f" and {more} more" if more else "")
            advice = "Give each a value: " + " ".join(f"--length {name}=..." for name in missing) + "."
            self._refuse(f"it names the lengths {listed} without a value", advice)
        moving = self._list("mu" if "mu" in self.values else "Mu", self.joint_count, "1")
        names = [str(k + 1) for k in range(self.joint_count)]
        links = {"base": RobotLink("base")}
        joints = []
        for k in range(self.bodies):
            frame, keys = placed[k]
            name = names[k]
            links[name] = RobotLink(name, self._body(k))
            if sigma[k] not in ("0", "1"):
                self._refuse(f"joint {name} has sigma = {sigma[k]}", "0 is revolute, 1 is prismatic.")
            joints.append(
                TreeJoint(
                    name,
                    "prismatic" if sigma[k] == "1" else "revolute",
                    "base" if above[k] < 0 else names[above[k]],
                    name,
                    frame,
                    np.array([0.0, 0.0, 1.0]),
                    actuated=moving[k] == "1",
                    keys=keys,
                    armature=self._plain("IA", k),
                    damping=self._plain("FV", k),
                    friction=self._plain("FS", k),
                )
            )
        closing = [self._loop(k, above, placed, sigma, names) for k in range(self.bodies, self.joint_count)]
        return RobotTree(
            name=self.title,
            file=self.file,
            form="symoro",
            gravity=np.array(gravity),
            links=links,
            joints=tuple(joints),
            closing=tuple(closing),
            notes=tuple(self.notes),
            lengths=dict(self.used),
            open_terms={kind: self._open(key, moving) for key, kind in _TERMS.items()},
        )

    def _parent(self, text: str, k: int) -> int:
        value = whole_number(text, 4)
        if value is None or value > self.bodies:
            self._refuse(f"frame {k + 1} has the antecedent {text!r}", f"Write a number from 0 to {self.bodies}.")
        return value - 1

    def _frame(self, k: int, columns: Mapping[str, list[str]], sigma: str) -> tuple[Array, dict[str, float | str]]:
        """Placement at q = 0 and its keys; the joint's own variable is not one of them."""
        variable = {"0": "theta", "1": "r"}.get(sigma, "")
        values: dict[str, float] = {}
        keys: dict[str, float | str] = {}
        for key in _KEYS:
            text = columns[key][k]
            own = key == variable and _WORD.fullmatch(text) is not None
            value = 0.0 if own else self._number(text, f"{key} of frame {k + 1}")
            values[key] = snapped_angle(value, self.snap) if key in _ANGLES else value
            if own or (not value and not _WORD.search(text)):
                continue
            if key in _ANGLES and not _WORD.search(text):
                quarters = round(values[key] / (math.pi / 2))
                exact = quarters and values[key] == quarters * math.pi / 2
                keys[key] = f"{quarters}*pi/2" if exact else values[key]
            else:
                keys[key] = text.replace("Pi", "pi") if _WORD.search(text) else values[key]
        return modified_dh(**values), keys

    def _gravity(self, text: str) -> float:
        sign = -1.0 if text.startswith("-") else 1.0
        if re.fullmatch(r"-?(G3|GZ|g)", text):
            self.notes.append(Note("approximate", f"gravity: {text} has no value in the file; its size is 9.81 m/s^2"))
            return -9.81 if sign > 0 else 9.81
        return self._number(text, "G")

    def _body(self, k: int) -> Inertial | None:
        texts = [self._list(key, self.bodies, key)[k] for key in _ENTRIES]
        if any(_WORD.search(_EXPONENT.sub("0", text)) for text in texts):
            return None
        xx, xy, xz, yy, yz, zz, mx, my, mz, m = (self._number(text, f"body {k + 1}") for text in texts)
        if m < 0:
            self._refuse(f"link {k + 1} has the mass {m:g} kg", "A mass is zero or above.")
        if m == 0:
            return None
        com = np.array([mx, my, mz]) / m
        J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return Inertial(m, com, J - m * (com @ com * np.eye(3) - np.outer(com, com)))

    def _plain(self, key: str, k: int) -> float:
        text = self._list(key, self.bodies, "0")[k]
        return 0.0 if _WORD.search(_EXPONENT.sub("0", text)) else self._number(text, f"{key}{k + 1}")

    def _open(self, key: str, moving: list[str]) -> tuple[str, ...]:
        values = self._list(key, self.bodies, "0")
        return tuple(
            str(k + 1) for k in range(self.bodies) if _WORD.search(values[k]) and (key != "IA" or moving[k] == "1")
        )

    def _loop(
        self,
        k: int,
        above: list[int],
        placed: list[tuple[Array, dict[str, float | str]]],
        sigma: list[str],
        names: list[str],
    ) -> ClosingJoint:
        second = k + self.joint_count - self.bodies
        ends = ["base" if above[i] < 0 else names[above[i]] for i in (k, second)]
        kind: Literal["prismatic", "revolute"] = "prismatic" if sigma[k] == "1" else "revolute"
        return ClosingJoint(names[k], kind, ends[0], placed[k][0], ends[1], placed[second][0])
