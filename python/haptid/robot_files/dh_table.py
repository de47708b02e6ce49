"""Tables of Denavit-Hartenberg parameters as CSV: one row for each joint, columns by their header.

A table says which of three conventions it is in, since the same four columns mean different things.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.expressions import number
from haptid.device.geometry import modified_dh, shift, turn_x, turn_z
from haptid.device.toml.errors_at import Place
from haptid.errors import DeviceFileError, suggestion
from haptid.robot_files.tree import JointKind, Note, RobotLink, RobotTree, TreeJoint, snapped_angle
from haptid.robot_files.xml import refused

_GRAVITY = (0.0, 0.0, -9.81)
_CONVENTIONS = {
    "dh": "Rz(theta) Tz(d) Tx(a) Rx(alpha)",
    "craig": "Rx(alpha) Tx(a) Rz(theta) Tz(d), alpha and a of the joint before",
    "modified-dh": "Rz(gamma) Tz(b) Rx(alpha) Tx(d) Rz(theta) Tz(r)",
}
_ANGLES = ("theta", "alpha", "gamma")
_LENGTHS = ("a", "d", "r", "b")
_TEXT = ("name", "parent", "type", "convention")
_LIMITS = ("lower", "upper", "velocity", "effort")
_BODY = ("mass", "cx", "cy", "cz", "ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_MOST_ROWS = 1000
_HEADER = re.compile(r"\s*(\w+?)\s*(?:[\[(_]\s*(deg|rad|m|mm)\s*[\])]?)?\s*", re.IGNORECASE)
# A joint's own variable in a cell, `q1`, `theta_2 + pi/2`, `90 + q3`, `*`: what is added to it is the offset.
_OWN = r"(?:(?:q|θ|ϑ|th|theta)_?\{?\d*\}?(?:\(t\))?|\*|var(?:iable)?)"
_VARIABLE = re.compile(rf"(?:(?P<before>[^+]+)\+)?\s*{_OWN}\s*(?P<after>[+-].+)?", re.IGNORECASE)
_ALIASES = {"joint": "name", "link": "name", "sigma": "type", "j": "name", "i": "name"}


def read_dh_table(content: bytes, file: str, lengths: Mapping[str, float], snap: float = 0.0) -> RobotTree:
    """The tree of a table.

    A comment line `# convention: dh` (or craig, or modified-dh), or a column of that name, says the convention; a
    column r says modified-dh. Headers of angles say deg or rad: `alpha_deg`, `theta [rad]`.

    Raises:
        RobotFileError: row and column, what was found and what to do.
    """
    table = _Table(content, file, lengths, snap)
    return table.tree()


@dataclass(frozen=True)
class _Column:
    key: str
    factor: float


class _Table:
    """Reads one table."""

    def __init__(self, content: bytes, file: str, lengths: Mapping[str, float], snap: float) -> None:
        self.file, self.lengths, self.snap = file, dict(lengths), snap
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise refused(file, "it is not UTF-8 text", "Save it as UTF-8.") from None
        lines = [(k + 1, line) for k, line in enumerate(text.splitlines())]
        said = [re.match(r"\s*#\s*convention\s*[:=]\s*([\w-]+)", line, re.IGNORECASE) for _, line in lines]
        self.convention = next((found[1].lower() for found in said if found), "")
        kept = [(k, line) for k, line in lines if line.strip() and not line.lstrip().startswith("#")]
        if len(kept) < 2:
            raise refused(file, "it has no header and row", "Write a header such as name,alpha_deg,a,theta_deg,d.")
        delimiter = max(",;\t", key=kept[0][1].count)
        try:
            cells = [next(csv.reader([line], delimiter=delimiter, strict=True)) for _, line in kept]
        except csv.Error as error:
            raise refused(file, f"it is not CSV ({error})", "Correct its quotes.") from None
        self.lines = [k for k, _ in kept][1:]
        self.columns = [self._column(text) for text in cells[0]]
        keys = [column.key for column in self.columns]
        if len(set(keys)) < len(keys):
            raise refused(file, "two columns have one name", "Rename one of them.", kept[0][0])
        if len(cells) - 1 > _MOST_ROWS:
            raise refused(file, f"it has more than {_MOST_ROWS} rows", "A table has one row for each joint.")
        self.rows = []
        for line, row in zip(self.lines, cells[1:], strict=True):
            if len(row) != len(keys):
                raise refused(file, f"it has {len(row)} cells, {len(keys)} are required", "Correct the row.", line)
            self.rows.append(dict(zip(keys, (cell.strip() for cell in row), strict=True)))
        self._choose(keys)

    def _column(self, text: str) -> _Column:
        found = _HEADER.fullmatch(text)
        key = (found[1] if found else text).lower().strip()
        key = _ALIASES.get(key, key)
        unit = (found[2] or "").lower() if found else ""
        known = (*_ANGLES, *_LENGTHS, *_TEXT, *_LIMITS, *_BODY)
        if key not in known:
            raise refused(self.file, f"it has the column {text.strip()[:40]!r}", suggestion(key, known))
        if key in _ANGLES and unit not in ("deg", "rad"):
            raise refused(
                self.file, f"column {text.strip()!r} does not say deg or rad", f"Write {key}_deg or {key}_rad."
            )
        return _Column(key, {"deg": math.pi / 180, "mm": 1e-3}.get(unit, 1.0))

    def _choose(self, keys: list[str]) -> None:
        if "convention" in keys:
            self.convention = self.rows[0]["convention"].lower()
        if not self.convention and ("r" in keys or "gamma" in keys or "b" in keys):
            self.convention = "modified-dh"
        if self.convention not in _CONVENTIONS:
            shown = "; ".join(f"{name} is {meaning}" for name, meaning in _CONVENTIONS.items())
            found = f"its convention is {self.convention!r}" if self.convention else "it does not say its convention"
            raise refused(self.file, found, f"Write a first line such as `# convention: dh`: {shown}.")
        allowed = {"modified-dh": ("gamma", "b", "alpha", "d", "theta", "r")}.get(
            self.convention, ("theta", "d", "a", "alpha")
        )
        for key in keys:
            if key in (*_ANGLES, *_LENGTHS) and key not in allowed:
                advice = f"Its columns are {', '.join(allowed)}."
                raise refused(self.file, f"column {key!r} does not belong to the convention {self.convention}", advice)

    def _number(self, row: Mapping[str, str], key: str, line: int, default: float | None = 0.0) -> float | None:
        text = row.get(key, "")
        if not text:
            return default
        factor = next(column.factor for column in self.columns if column.key == key)
        try:
            return factor * number(_value(text), self.lengths, Place(self.file, key))
        except DeviceFileError:
            found = f"{key} is {text[:60]!r}, which is neither a number nor arithmetic over pi and known lengths"
            raise refused(self.file, found, "Correct it, or give --length NAME=VALUE.", line) from None

    def _offsets(self, row: dict[str, str]) -> dict[str, str]:
        """The row with the offset in place of the joint's own variable; the type by the column that has it."""
        made = dict(row)
        for key, kind in (("theta", "revolute"), *((length, "prismatic") for length in ("d", "r"))):
            found = _VARIABLE.fullmatch(row.get(key, ""))
            given = row.get("type", "")
            if not found or row[key] in self.lengths or (given and self._kind(given, 0) != kind):
                continue
            if kind == "prismatic" and not re.search(r"q|\*|var", row[key], re.IGNORECASE):
                continue
            made[key] = f"{found['before'] or ''}{found['after'] or ''}".strip().removeprefix("+") or "0"
            made["type"] = kind
            break
        return made

    def tree(self) -> RobotTree:
        """The tree."""
        links = {"base": RobotLink("base")}
        joints: list[TreeJoint] = []
        carried = np.eye(4)  # standard convention: what of the row before comes after its joint
        after: dict[str, Array] = {"base": np.eye(4)}
        previous = "base"
        for k, (line, cells) in enumerate(zip(self.lines, self.rows, strict=True)):
            row = self._offsets(cells)
            name = row.get("name") or str(k + 1)
            if name in links:
                raise refused(self.file, f"two joints are named {name!r}", "Rename one of them.", line)
            parent = row.get("parent") or previous
            parent = "base" if parent in ("0", "base", "world") and parent not in links else parent
            if parent not in links:
                raise refused(self.file, f"the parent {parent!r} is no joint above", "Name one above this row.", line)
            kind = self._kind(row.get("type", ""), line)
            value = {key: float(self._number(row, key, line) or 0.0) for key in (*_ANGLES, *_LENGTHS)}
            for key in _ANGLES:
                value[key] = snapped_angle(value[key], self.snap)
            before, carried = self._frames(value)
            links[name] = RobotLink(name, None, line=line)
            joints.append(
                TreeJoint(
                    name,
                    kind,
                    parent,
                    name,
                    after[parent] @ before,
                    np.array([0.0, 0.0, 1.0]),
                    limits=self._limits(row, line),
                    velocity=self._number(row, "velocity", line, None),
                    effort=self._number(row, "effort", line, None),
                    line=line,
                )
            )
            after[name] = carried
            previous = name
        return RobotTree(
            name=self.file.replace("\\", "/").rpartition("/")[2].removesuffix(".csv") or "robot",
            file=self.file,
            form="dh",
            gravity=np.array(_GRAVITY),
            links=links,
            joints=tuple(joints),
            notes=(Note("approximate", f"gravity: {' '.join(map(str, _GRAVITY))} m/s^2 was taken"),),
        )

    def _frames(self, x: Mapping[str, float]) -> tuple[Array, Array]:
        """Placement of a joint's frame, z its axis, and of what follows its own motion."""
        if self.convention == "modified-dh":
            return modified_dh(x["gamma"], x["b"], x["alpha"], x["d"], x["theta"], x["r"]), np.eye(4)
        if self.convention == "craig":
            return modified_dh(0.0, 0.0, x["alpha"], x["a"], x["theta"], x["d"]), np.eye(4)
        return turn_z(x["theta"]) @ shift(z=x["d"]), shift(x=x["a"]) @ turn_x(x["alpha"])

    def _kind(self, text: str, line: int) -> JointKind:
        known: dict[str, JointKind] = dict.fromkeys(("", "0", "r", "revolute"), "revolute")
        known.update(dict.fromkeys(("1", "p", "prismatic"), "prismatic"))
        if text.lower() not in known:
            raise refused(self.file, f"the type is {text[:40]!r}", "Write revolute or prismatic.", line)
        return known[text.lower()]

    def _limits(self, row: Mapping[str, str], line: int) -> tuple[float, float] | None:
        low, high = (self._number(row, key, line, None) for key in ("lower", "upper"))
        if low is None or high is None:
            return None
        if not low < high:
            raise refused(self.file, f"its limits are {low:g} and {high:g}", "Write the lower one first.", line)
        return low, high


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
