"""A device file as checked tables: TOML, then keys and kinds of values; each fault becomes one error."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from haptid._internal.toml_tables import Fault, Syntax
from haptid.device.toml.place import Place
from haptid.device.toml.schema import CONVENTIONS, AnyDevice
from haptid.errors import (
    DeviceFileError,
    DeviceKeyError,
    DeviceSyntaxError,
    DeviceValueError,
    UnknownDeviceNameError,
    suggestion,
)

# A device file is some kilobytes; a file beyond this is something else.
LARGEST_FILE = 1_000_000


def shipped_devices() -> tuple[str, ...]:
    """Names of the devices that come with haptid."""
    folder = files("haptid.device") / "library"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def read_tables(path: str | Path) -> tuple[AnyDevice, str]:
    """The checked tables of a device file, or of a shipped device by name; and how errors call the file."""
    file, content = _content(path)
    return checked(_parsed(file, content), file)


def checked(data: dict[str, Any], file: str) -> tuple[AnyDevice, str]:
    """The checked tables of what a device file says, and the name by which errors call the file.

    Raises:
        DeviceError: in one of its kinds; see `read_device`.
    """
    convention = data.get("convention", "modified-dh")
    if not isinstance(convention, str) or convention not in CONVENTIONS:
        raise DeviceValueError(
            f"{file}: convention",
            f"found {convention!r}",
            f"Write one of {', '.join(f'{c!r}' for c in CONVENTIONS)}.",
        )
    try:
        return CONVENTIONS[convention].model_validate(data), file
    except ValidationError as error:
        raise _first_error(error, file, data, CONVENTIONS[convention]) from None


def _content(path: str | Path) -> tuple[str, bytes]:
    if "\0" in str(path):
        raise DeviceFileError(repr(str(path)), "has a zero byte in it", "Give the path of a device's TOML file.")
    source: Any = Path(path)
    if isinstance(path, str) and not source.exists() and not source.suffix and "/" not in path:
        if path not in shipped_devices():
            raise DeviceFileError(
                path,
                "there is no such file, nor a shipped device of that name",
                suggestion(path, shipped_devices()),
            )
        source = files("haptid.device") / "library" / f"{path}.toml"
    try:
        with source.open("rb") as stream:
            content: bytes = stream.read(LARGEST_FILE + 1)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise DeviceFileError(
            str(path), f"cannot be opened ({reason})", "Give the path of a device's TOML file."
        ) from None
    if len(content) > LARGEST_FILE:
        raise DeviceFileError(
            str(path),
            f"has more than {LARGEST_FILE} bytes",
            "A device file is some kilobytes: is this a log?",
        )
    return str(path), content


def _parsed(file: str, content: bytes) -> dict[str, Any]:
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise DeviceFileError(
            file, f"byte {error.start} is not UTF-8 text", "Save the file as UTF-8 in your editor."
        ) from None
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        at = Syntax.of(error, text)
        raise DeviceSyntaxError(file, at.line, at.column, at.found, at.text) from None


def _first_error(error: ValidationError, file: str, data: Any, model: type[BaseModel]) -> Exception:
    """The one fault that a user should read first, as an error of a device file."""
    fault = Fault.of(error, model, data)
    place, steps = str(Place(file).at(*fault.steps)), fault.steps
    if fault.kinds and fault.kind == "union_tag_invalid":
        return UnknownDeviceNameError(place, "kind of term", str(fault.found), fault.kinds)
    if fault.kinds:
        return DeviceKeyError(place, "this key is missing", f"Write kind = ..., one of {', '.join(fault.kinds)}.")
    if fault.kind == "extra_forbidden":
        key = str(steps[-1])
        return DeviceKeyError(place, f'there is no key "{key}" here', suggestion(key, fault.keys))
    if fault.kind == "missing":
        return DeviceKeyError(place, "this key is missing", f"Write {steps[-1]} = ... {_table(steps[:-1])}.")
    return DeviceValueError(place, f"found {fault.shown}", f"{fault.wanted[:1].upper()}{fault.wanted[1:]}.")


def _table(steps: Sequence[str | int]) -> str:
    names = [str(step) for step in steps if isinstance(step, str)]
    if not names:
        return "at the top of the file"
    return f"in [[{'.'.join(names)}]]" if isinstance(steps[-1], int) else f"in [{'.'.join(names)}]"
