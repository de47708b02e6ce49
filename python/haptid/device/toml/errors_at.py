"""Errors of a device file, each with the place in the file: a key path such as `joints[3].alpha`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from haptid._internal.late import dataclass
from haptid._internal.toml_tables import Fault
from haptid.errors import DeviceFileError, suggestion


@dataclass(frozen=True)
class Place:
    """A file and a key path in it, such as `stylus.toml: joints[3].alpha`; it makes the errors about that key."""

    file: str
    key: str = ""

    def at(self, *steps: str | int) -> Place:
        """The place `steps` further down: names and list indices."""
        key = self.key
        for step in steps:
            key += f"[{step}]" if isinstance(step, int) else f".{step}" if key else step
        return Place(self.file, key)

    def __str__(self) -> str:
        return f"{self.file}: {self.key}" if self.key else self.file

    def error(self, found: str, advice: str) -> DeviceFileError:
        """The error for a key or value that is wrong."""
        return DeviceFileError(f"{self}: {found}.", where=self.key or self.file, found=found, advice=advice)

    def unknown(self, kind: str, name: str, known: Iterable[str]) -> DeviceFileError:
        """The error for a name that nothing in the device has."""
        names = tuple(known)
        text = f'{self}: no {kind} is named "{name}".'
        return DeviceFileError(text, where=self.key, found=name, limit=names, advice=suggestion(name, names))

    def taken(self, kind: str, name: str, first: str) -> DeviceFileError:
        """The error for a name that is used twice."""
        text = f'{self}: the {kind} "{name}" is already taken by {first}.'
        return DeviceFileError(text, where=self.key, found=name, advice="Give one of them another name.")


def first_error(error: ValidationError, file: str, data: Any, model: type[BaseModel]) -> DeviceFileError:
    """The first fault that a user should read, as an error of a device file."""
    fault = Fault.of(error, model, data)
    place, steps = Place(file).at(*fault.steps), fault.steps
    if fault.kinds and fault.kind == "union_tag_invalid":
        noun = "shape" if "collision" in steps else "term"
        return place.unknown(f"kind of {noun}", str(fault.found), fault.kinds)
    if fault.kinds:
        return place.error("this key is missing", f"Write kind = ..., one of {', '.join(fault.kinds)}.")
    if fault.kind == "extra_forbidden":
        key = str(steps[-1])
        return place.error(f'there is no key "{key}" here', suggestion(key, fault.keys))
    if fault.kind == "missing":
        return place.error("this key is missing", f"Write {steps[-1]} = ... {_table(steps[:-1])}.")
    return place.error(f"found {fault.shown}", f"{fault.wanted[:1].upper()}{fault.wanted[1:]}.")


def _table(steps: Sequence[str | int]) -> str:
    names = [str(step) for step in steps if isinstance(step, str)]
    if not names:
        return "at the top of the file"
    return f"in [[{'.'.join(names)}]]" if isinstance(steps[-1], int) else f"in [{'.'.join(names)}]"
