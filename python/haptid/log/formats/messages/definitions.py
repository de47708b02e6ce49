"""ROS message definitions: the text that travels with a log, parsed, and common types for logs without it.

Source: ROS 2 interface definition (design.ros2.org/articles/interface_definition.html), ROS 1 msg format
(wiki.ros.org/msg); definitions of sensor_msgs, std_msgs, control_msgs and geometry_msgs.
"""

from __future__ import annotations

import re

from haptid._internal.late import dataclass

# Primitive type -> NumPy type, little endian.
PRIMITIVES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
# Nested types, and fields of one type, that are accepted.
DEEPEST, MOST_FIELDS = 16, 1000
_LINE = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)
_BREAK = re.compile(r"^=+\s*$", re.MULTILINE)


@dataclass(frozen=True)
class Field:
    """A field of a message type.

    Attributes:
        name: of the field.
        kind: a primitive's NumPy type, "string", "time", or the key of another type.
        length: of an array of fixed length; -1 of a sequence; None where it is a single value.
    """

    name: str
    kind: str
    length: int | None


Types = dict[str, tuple[Field, ...]]


def parse(definition: str, main: str) -> Types:
    """Types of a definition by name, the main one under "".

    Raises:
        ValueError: a type is missing, contains itself, or nests too deep.
    """
    texts: dict[str, str] = {}
    for k, part in enumerate(_BREAK.split(definition)):
        head, _, body = part.lstrip().partition("\n")
        if k == 0:
            texts[_plain(main)] = part
        elif head.startswith("MSG:"):
            texts[_plain(head[4:].strip())] = body
        elif head.startswith("IDL:"):
            raise ValueError("the type is defined in IDL, which is not read; only .msg definitions are")
    types: Types = {}
    _resolve(_plain(main), texts, types, ())
    types[""] = types[_plain(main)]
    return types


def _plain(name: str) -> str:
    return name.replace("/msg/", "/")


def _resolve(name: str, texts: dict[str, str], types: Types, outer: tuple[str, ...]) -> None:
    if name in types:
        return
    if name in outer:
        raise ValueError(f"type {name} contains itself")
    if len(outer) >= DEEPEST:
        raise ValueError(f"types are nested more than {DEEPEST} deep")
    if name not in texts:
        raise ValueError(f"type {name} is not defined")
    fields = []
    for line in texts[name].splitlines():
        match = _LINE.match(line.strip())
        if line.strip().startswith("#") or match is None:
            continue
        rest = match["rest"].split("#")[0].strip()
        if rest.startswith("="):
            continue  # a constant
        array = match["array"]
        length = None if array is None else -1 if array == "[]" or "<=" in array else int(array[1:-1])
        fields.append(Field(match["name"], _kind(match["type"], name, texts), length))
    if len(fields) > MOST_FIELDS:
        raise ValueError(f"type {name} has {len(fields)} fields")
    for field in fields:
        if field.kind not in ("string", "time") and field.kind not in PRIMITIVES.values():
            _resolve(field.kind, texts, types, (*outer, name))
    types[name] = tuple(fields)


def _kind(written: str, inside: str, texts: dict[str, str]) -> str:
    name = _plain(written)
    if name in PRIMITIVES:
        return PRIMITIVES[name]
    if name in ("time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"):
        return "time"
    if name == "string":
        return name
    if "/" not in name:
        name = "std_msgs/Header" if name == "Header" else f"{inside.rpartition('/')[0]}/{name}"
    if name not in texts:  # ROS 1 may leave the package out of a nested type
        last = [known for known in texts if known.rpartition("/")[2] == name.rpartition("/")[2]]
        name = last[0] if len(last) == 1 else name
    return name


_HEADER = "\n====\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_LAYOUT = (
    "\n====\nMSG: std_msgs/MultiArrayLayout\nMultiArrayDimension[] dim\nuint32 data_offset\n"
    "====\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n"
)
_VECTOR = "====\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_WRENCH = f"\n====\nMSG: geometry_msgs/Wrench\nVector3 force\nVector3 torque\n{_VECTOR}"
# Types that a log without definitions may have, as their text would travel along.
COMMON = {
    "sensor_msgs/JointState": (
        f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort{_HEADER}"
    ),
    "std_msgs/Float64": "float64 data\n",
    "std_msgs/Float32": "float32 data\n",
    "std_msgs/Float64MultiArray": f"MultiArrayLayout layout\nfloat64[] data{_LAYOUT}",
    "std_msgs/Float32MultiArray": f"MultiArrayLayout layout\nfloat32[] data{_LAYOUT}",
    "geometry_msgs/Wrench": f"Vector3 force\nVector3 torque\n{_VECTOR}",
    "geometry_msgs/WrenchStamped": f"std_msgs/Header header\nWrench wrench{_WRENCH}{_HEADER.lstrip()}",
    "control_msgs/DynamicJointState": (
        f"std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values{_HEADER}"
        "====\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
    ),
}
