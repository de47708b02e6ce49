"""TOML files as checked tables; a fault says where it is, what was found and what is allowed there."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from haptid._internal.bounded_files import DEFINITION_FILE, read_bounded
from haptid._internal.late import dataclass
from haptid.errors import HaptidError, keys_here

Model = TypeVar("Model", bound=BaseModel)

# Most parts of a dotted key: the parser's time and memory grow with their square.
_MOST_PARTS = 32
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+"""
_DOTTED = re.compile(rf"(?:^|[\[{{,])[ \t]*+(?:{_PART}){{{_MOST_PARTS}}}", re.MULTILINE)
# Types of pydantic errors that are shown first: a misspelt key is the cause of a missing one, and for a union of
# types these say more than a mismatch with one of them.
_FIRST = ("extra_forbidden", "missing", "value_error")
# Advice for types of pydantic errors whose own message is not for users.
INSTEAD = {
    "string_type": 'Write a text in double quotes, such as "1"',
    "string_pattern_mismatch": "Write a name of the letters A to Z and a to z, digits and underscores",
    "list_type": "Write a list in square brackets",
    "bool_type": "Write true or false",
    "model_type": "Write a table",
    "dict_type": "Write a table",
}
# Of lists: the key of their bound in pydantic's error, and its name.
_COUNTED = {"too_long": ("max_length", "at most"), "too_short": ("min_length", "at least")}


@dataclass(frozen=True)
class Syntax:
    """Place of a syntax error in TOML.

    Attributes:
        line, column: from 1.
        found: what is wrong there.
        text: that line.
    """

    line: int
    column: int
    found: str
    text: str

    @staticmethod
    def of(error: Exception, text: str) -> Syntax:
        """From the parser's exception."""
        position = re.search(r"line (\d+), column (\d+)", str(error))
        lines = text.splitlines() or [""]
        line, column = (int(position[1]), int(position[2])) if position else (len(lines), len(lines[-1]) + 1)
        message = re.sub(r" \(at .*\)$", "", str(error))
        return Syntax(line, column, message, lines[min(line, len(lines)) - 1].strip()[:80])


@dataclass(frozen=True)
class Fault:
    """The first fault of a file's tables that a user should read.

    Attributes:
        kind: pydantic's type of error, such as "missing" or "extra_forbidden".
        steps: path: names and list indices, without the branches of unions.
        found: the value there.
        wanted: what to write, without a full stop.
        keys: allowed in the enclosing table; empty if its keys are not fixed.
        kinds: allowed, if the kind of a table is missing or unknown.
        meaning: description of the key or of the enclosing one; empty if there is none.
    """

    kind: str
    steps: tuple[str | int, ...]
    found: Any
    wanted: str
    keys: tuple[str, ...]
    kinds: tuple[str, ...]
    meaning: str

    @staticmethod
    def of(error: ValidationError, model: type[BaseModel], data: Any) -> Fault:
        """From pydantic's errors for the data of a file."""
        detail: Any = min(error.errors(include_url=False), key=_rank)
        kind, steps = detail["type"], _steps(detail, data)
        around = next(iter(_models_at(model, steps[:-1], data)), None)
        kinds: tuple[str, ...] = ()
        if kind.startswith("union_tag"):
            kinds = tuple(name for table in _models_at(model, steps, data) for name in _kinds(table))
        return Fault(
            kind=kind,
            steps=(*steps, "kind") if kinds else tuple(steps),
            found=detail.get("ctx", {}).get("tag", detail["input"]),
            wanted=_counts(detail) or INSTEAD.get(kind, detail["msg"].removeprefix("Value error, ")),
            keys=tuple(_fields(around)) if around else (),
            kinds=kinds,
            meaning=_meaning(model, steps, data),
        )

    @property
    def shown(self) -> str:
        """The value found, shortened."""
        counted = self.kind in _COUNTED and isinstance(self.found, list)
        text = f"{len(self.found)} entries" if counted else repr(self.found)
        return text if len(text) <= 60 else text[:57] + "..."

    @property
    def sentence(self) -> str:
        """What is wrong and what the key is for, without a full stop."""
        if self.kinds:
            missing = self.kind == "union_tag_not_found"
            problem = "this key is missing" if missing else f"there is no kind {self.shown}"
            kinds = ", ".join(f'"{kind}"' for kind in self.kinds)
            return f"{problem}; write one of {kinds}"
        if self.kind == "extra_forbidden":
            return f"there is no such key (found {self.shown})"
        meaning = f"; {self.meaning}" if self.meaning else ""
        problem = "this key is missing" if self.kind == "missing" else f"{self.wanted} (found {self.shown})"
        return f"{problem}{meaning}"


def _counts(detail: Any) -> str:
    """What to write in place of a list of too many or too few entries; empty for other errors."""
    bound = _COUNTED.get(detail["type"])
    return f"Write {bound[1]} {detail['ctx'][bound[0]]} entries" if bound and isinstance(detail["input"], list) else ""


def read_checked(path: Path, model: type[Model], wrong: type[HaptidError], noun: str, advice: str = "") -> Model:
    """The checked tables of a file.

    Args:
        path: of the file.
        model: of its tables.
        wrong: class of the error if the file cannot be read, or a key in it is missing, unknown or wrong.
        noun: kind of file: "a study".
        advice: appended to every error.
    """
    try:
        data = _parsed(path, noun)
    except _NotReadError as error:
        raise wrong(f"{path}: {error}.", where=str(path), advice=advice) from None
    try:
        return model.model_validate(data)
    except ValidationError as error:
        fault = Fault.of(error, model, data)
        path_of_key = ".".join(map(str, fault.steps))
        known = fault.keys if fault.kind == "extra_forbidden" else ()
        raise wrong(
            f"{path}, key `{path_of_key}`: {fault.sentence}.",
            where=path_of_key,
            found=fault.found,
            limit=known or None,
            advice=" ".join(filter(None, (keys_here(path_of_key, known), advice))),
        ) from None


class _NotReadError(Exception):
    """A file that is not TOML, with the reason."""


def _parsed(path: Path, noun: str) -> dict[str, Any]:
    try:
        text = read_bounded(path, DEFINITION_FILE).decode("utf-8")
    except FileNotFoundError:
        raise _NotReadError(f"there is no such file; give the path of the TOML file of {noun}") from None
    except UnicodeDecodeError as error:
        raise _NotReadError(f"byte {error.start} is not UTF-8 text; save the file as UTF-8 in your editor") from None
    except (OSError, ValueError) as error:  # no file, not allowed; a path that can be none
        reason = getattr(error, "strerror", None) or str(error)
        raise _NotReadError(f"cannot be opened ({reason})") from None
    try:
        return toml_values(text)
    except (ValueError, RecursionError) as error:
        syntax = Syntax.of(error, text)
        raise _NotReadError(
            f"line {syntax.line}, column {syntax.column}: not TOML: {syntax.found}, in `{syntax.text}`"
        ) from None


def toml_values(text: str) -> dict[str, Any]:
    """The values of a text in TOML.

    Raises:
        ValueError: it is not TOML, has a number of thousands of digits or a key of very many parts.
        RecursionError: it is nested too deeply.
    """
    if long := _DOTTED.search(text):
        line = text.count("\n", 0, long.start()) + 1
        column = long.start() - text.rfind("\n", 0, long.start())
        problem = f"a key of more than {_MOST_PARTS} parts"
        raise tomllib.TOMLDecodeError(f"{problem} (at line {line}, column {column})")
    return tomllib.loads(text)


def _rank(detail: Any) -> int:
    """Sort key of one of several errors; a wrong literal says which are allowed."""
    kind = detail["type"]
    if kind == "literal_error" and isinstance(detail["input"], str):
        return len(_FIRST)
    return _FIRST.index(kind) if kind in _FIRST else len(_FIRST) + 1 + (kind == "literal_error")


def _steps(detail: Any, data: Any) -> list[str | int]:
    """Path of an error: the steps that the data has, and the missing key."""
    steps: list[str | int] = []
    node = data
    for k, step in enumerate(detail["loc"]):
        is_key = isinstance(node, dict) and isinstance(step, str) and step in node
        is_entry = isinstance(node, list) and isinstance(step, int) and step < len(node)
        if is_key or is_entry:
            node = node[step]
            steps.append(step)
        elif k == len(detail["loc"]) - 1 and detail["type"] == "missing":
            steps.append(step)
    return steps


def _models_at(model: type[BaseModel], steps: Sequence[str | int], data: Any) -> list[type[BaseModel]]:
    """The tables allowed at `steps`: of several kinds the one that the data names, if any."""
    models, value = [model], data
    annotation: Any = None
    by_name = False  # whether the next step is a name chosen by the user
    for step in steps:
        value = value[step]
        if by_name or isinstance(step, int):
            by_name = False
        else:
            field = _fields(models[0]).get(step) if models else None
            annotation = field.annotation if field else _of_names(models[0]) if models else None
            by_name = any(get_origin(part) is dict for part in (annotation, *get_args(annotation)))
        models = _of_kind(list(_models(annotation)), value)
    return models


def _meaning(model: type[BaseModel], steps: Sequence[str | int], data: Any) -> str:
    """Description of the last step that is a field, if it has one."""
    for k in reversed(range(len(steps))):
        around = _models_at(model, steps[:k], data)
        field = _fields(around[0]).get(str(steps[k])) if around else None
        if field:
            return f"{steps[k]} is {field.description}" if field.description else ""
    return ""


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """All tables within a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _of_kind(models: list[type[BaseModel]], value: Any) -> list[type[BaseModel]]:
    """The tables of the kind that a value names; all if it names none of them."""
    kind = value.get("kind") if isinstance(value, dict) else None
    return [model for model in models if kind in _kinds(model)] or models


def _kinds(model: type[BaseModel]) -> tuple[Any, ...]:
    """The kinds that a table may have."""
    field = model.model_fields.get("kind")
    return get_args(field.annotation) if field else ()


def _of_names(model: type[BaseModel]) -> Any:
    """Type of the values of a table whose other keys are names chosen by the user, None of other tables."""
    if model.model_config.get("extra") != "allow":
        return None
    return get_args(get_type_hints(model, include_extras=True)["__pydantic_extra__"])[1]


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of a table by their names in the file."""
    return {field.alias or name: field for name, field in model.model_fields.items()}
