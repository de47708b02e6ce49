"""A device file as checked tables: TOML, then keys and kinds of values; each fault becomes one error."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any, get_origin

from pydantic import BaseModel, ValidationError

from haptid.device.place import Place
from haptid.device.schema import CONVENTIONS, AnyDevice, AnyTerm
from haptid.errors import (
    DeviceFileError,
    DeviceKeyError,
    DeviceSyntaxError,
    DeviceValueError,
    UnknownNameError,
)
from haptid.errors.devices import suggestion

# A device file is some kilobytes; a file beyond this is something else.
LARGEST_FILE = 1_000_000
# Errors of these types are shown before the others: a misspelt key is the cause of the missing one, and where
# a key takes one kind of value or another, these say more than that it is not the other.
FIRST = ("extra_forbidden", "missing", "value_error")
# What to write instead, where pydantic's own words are not a user's.
INSTEAD = {
    "string_type": 'Write a text in double quotes, such as "1"',
    "string_pattern_mismatch": "Write a name of letters, digits and underscores",
    "list_type": "Write a list in square brackets",
    "bool_type": "Write true or false",
    "model_type": "Write a table",
    "dict_type": "Write a table",
}


def shipped_devices() -> tuple[str, ...]:
    """Names of the devices that come with haptid."""
    folder = files("haptid") / "devices"
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
        source = files("haptid") / "devices" / f"{path}.toml"
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
        position = re.search(r"line (\d+), column (\d+)", str(error))
        lines = text.splitlines() or [""]
        line, column = (int(position[1]), int(position[2])) if position else (len(lines), len(lines[-1]) + 1)
        found = re.sub(r" \(at .*\)$", "", str(error))
        raise DeviceSyntaxError(file, line, column, found, lines[min(line, len(lines)) - 1].strip()[:80]) from None


def _first_error(error: ValidationError, file: str, data: Any, model: type[BaseModel]) -> Exception:
    """The one pydantic error that a user should read first, in haptid's words."""
    details = error.errors(include_url=False)
    detail = min(details, key=_rank)
    steps = _steps(detail["loc"], data)
    place = Place(file).at(*steps)
    kind, context = detail["type"], detail.get("ctx", {})
    if kind == "extra_forbidden":
        known = _keys(model, steps[:-1], data)
        return DeviceKeyError(str(place), f'there is no key "{steps[-1]}" here', suggestion(str(steps[-1]), known))
    if kind == "missing":
        return DeviceKeyError(str(place), "this key is missing", f"Write {steps[-1]} = ... {_table(steps[:-1])}.")
    if kind == "union_tag_not_found":
        return DeviceKeyError(
            str(place.at("kind")), "this key is missing", f"Write kind = ..., one of {', '.join(_kinds())}."
        )
    if kind == "union_tag_invalid":
        return UnknownNameError(str(place.at("kind")), "kind of term", str(context["tag"]), _kinds())
    wanted = INSTEAD.get(kind, detail["msg"].removeprefix("Value error, "))
    return DeviceValueError(str(place), f"found {_shown(detail['input'])}", f"{wanted[:1].upper()}{wanted[1:]}.")


def _rank(detail: Any) -> int:
    """Place in the queue of one of several errors; a wrong word is told by the words that there are."""
    kind = detail["type"]
    if kind == "literal_error" and isinstance(detail["input"], str):
        return len(FIRST)
    return FIRST.index(kind) if kind in FIRST else len(FIRST) + 1 + (kind == "literal_error")


def _steps(loc: tuple[int | str, ...], data: Any) -> list[str | int]:
    """A pydantic location without the names of unions' branches: steps that the data has, then the last."""
    steps: list[str | int] = []
    here = data
    for k, step in enumerate(loc):
        is_key = isinstance(here, dict) and isinstance(step, str) and step in here
        is_entry = isinstance(here, list) and isinstance(step, int) and step < len(here)
        if is_key or is_entry:
            here = here[step]
            steps.append(step)
        elif k == len(loc) - 1 and isinstance(here, dict) and step != "[key]":
            steps.append(step)
    return steps


def _keys(model: type[BaseModel], steps: list[str | int], data: Any) -> list[str]:
    """The keys that may stand in the table at `steps`."""
    here: Any = model
    entry_of_dict = False
    for k, step in enumerate(steps):
        if isinstance(step, int) or entry_of_dict:
            entry_of_dict = False
            continue
        if steps[0] == "terms" and k == 0 and len(steps) > 1:
            here = _term_model(data["terms"][steps[1]].get("kind"))
            continue
        field = next((f for name, f in here.model_fields.items() if step in (name, f.alias)), None)
        here = next(iter(_models(field.annotation)), None) if field else None
        if field is None or here is None:
            return []
        entry_of_dict = get_origin(field.annotation) is dict
    return [field.alias or name for name, field in here.model_fields.items()]


def _models(annotation: Any) -> Iterable[type[BaseModel]]:
    """The table models anywhere in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in getattr(annotation, "__args__", ()):
        yield from _models(part)


def _term_model(kind: str) -> type[BaseModel]:
    return next(model for model in _models(AnyTerm) if kind in model.model_fields["kind"].annotation.__args__)  # type: ignore[union-attr]


def _kinds() -> list[str]:
    return [kind for model in _models(AnyTerm) for kind in model.model_fields["kind"].annotation.__args__]  # type: ignore[union-attr]


def _table(steps: list[str | int]) -> str:
    names = [str(step) for step in steps if isinstance(step, str)]
    if not names:
        return "at the top of the file"
    return f"in [[{'.'.join(names)}]]" if isinstance(steps[-1], int) else f"in [{'.'.join(names)}]"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
