"""TOML files as checked tables, and what is wrong with one: where, what was found, what may stand there."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from haptid.errors import HaptidError

Model = TypeVar("Model", bound=BaseModel)
# The error of a kind of file, from its path, the place in it, what is wrong, and the keys that there are.
Wrong = Callable[[object, str, str, Sequence[str]], HaptidError]

# Such a file is a page of text; anything much larger is something else.
LARGEST_FILE = 1 << 20
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


@dataclass(frozen=True)
class Syntax:
    """Where a text stops to be TOML.

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
        """From what the parser says."""
        position = re.search(r"line (\d+), column (\d+)", str(error))
        lines = text.splitlines() or [""]
        line, column = (int(position[1]), int(position[2])) if position else (len(lines), len(lines[-1]) + 1)
        found = re.sub(r" \(at .*\)$", "", str(error))
        return Syntax(line, column, found, lines[min(line, len(lines)) - 1].strip()[:80])


@dataclass(frozen=True)
class Fault:
    """What a user should read first of all that is wrong with a file's tables.

    Attributes:
        kind: pydantic's word for it, such as "missing" or "extra_forbidden".
        steps: where: names and list indices, without the branches of unions.
        found: what stands there.
        wanted: what to write, a sentence without its end.
        keys: that may stand in the table around; none where it is no table of known keys.
        kinds: that may be written, where the kind of a table is missing or unknown.
        meaning: what the key is for, or the one that it stands in; empty where its table does not say.
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
        """From what pydantic says of the data of a file."""
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
            wanted=INSTEAD.get(kind, detail["msg"].removeprefix("Value error, ")),
            keys=tuple(_fields(around)) if around else (),
            kinds=kinds,
            meaning=_meaning(model, steps, data),
        )

    @property
    def shown(self) -> str:
        """What was found, in short."""
        text = repr(self.found)
        return text if len(text) <= 60 else text[:57] + "..."

    @property
    def sentence(self) -> str:
        """What is wrong, and what the key is for, without an end."""
        if self.kinds:
            missing = self.kind == "union_tag_not_found"
            what = "this key is missing" if missing else f"there is no kind {self.shown}"
            kinds = ", ".join(f'"{kind}"' for kind in self.kinds)
            return f"{what}; write one of {kinds}"
        if self.kind == "extra_forbidden":
            return f"there is no such key (found {self.shown})"
        meaning = f"; {self.meaning}" if self.meaning else ""
        what = "this key is missing" if self.kind == "missing" else f"{self.wanted} (found {self.shown})"
        return f"{what}{meaning}"


def read_checked(path: Path, model: type[Model], wrong: Wrong, noun: str) -> Model:
    """The checked tables of a file.

    Args:
        path: of the file.
        model: of its tables.
        noun: what the file is of: "a study".
        wrong: the error to raise where the file cannot be read, or a key in it is missing, unknown or wrong.
    """
    data = _parsed(path, wrong, noun)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        fault = Fault.of(error, model, data)
        known = fault.keys if fault.kind == "extra_forbidden" else ()
        raise wrong(path, ".".join(map(str, fault.steps)), fault.sentence, known) from None


def _parsed(path: Path, wrong: Wrong, noun: str) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise wrong(path, "", f"the file is larger than {LARGEST_FILE >> 20} MiB: is this a log?", ())
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise wrong(path, "", f"there is no such file; give the path of the TOML file of {noun}", ()) from None
    except UnicodeDecodeError as error:
        what = f"byte {error.start} is not UTF-8 text; save the file as UTF-8 in your editor"
        raise wrong(path, "", what, ()) from None
    except (OSError, ValueError) as error:  # no file, not allowed; a path that can be none
        reason = getattr(error, "strerror", None) or str(error)
        raise wrong(path, "", f"cannot be opened ({reason})", ()) from None
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        at = Syntax.of(error, text)
        what = f"line {at.line}, column {at.column}: not TOML: {at.found}, in `{at.text}`"
        raise wrong(path, "", what, ()) from None


def _rank(detail: Any) -> int:
    """Place in the queue of one of several errors; a wrong word is told by the words that there are."""
    kind = detail["type"]
    if kind == "literal_error" and isinstance(detail["input"], str):
        return len(FIRST)
    return FIRST.index(kind) if kind in FIRST else len(FIRST) + 1 + (kind == "literal_error")


def _steps(detail: Any, data: Any) -> list[str | int]:
    """Where an error is: the steps that the data has; the last one too that it lacks, where a key is missing."""
    steps: list[str | int] = []
    here = data
    for k, step in enumerate(detail["loc"]):
        is_key = isinstance(here, dict) and isinstance(step, str) and step in here
        is_entry = isinstance(here, list) and isinstance(step, int) and step < len(here)
        if is_key or is_entry:
            here = here[step]
            steps.append(step)
        elif k == len(detail["loc"]) - 1 and detail["type"] == "missing":
            steps.append(step)
    return steps


def _models_at(model: type[BaseModel], steps: Sequence[str | int], data: Any) -> list[type[BaseModel]]:
    """The tables that may stand at `steps`: of several kinds the one that the data says, if it says one."""
    here, value = [model], data
    annotation: Any = None
    by_name = False  # whether the next step is a name that the user chooses
    for step in steps:
        value = value[step]
        if by_name or isinstance(step, int):
            by_name = False
        else:
            field = _fields(here[0]).get(step) if here else None
            annotation = field.annotation if field else None
            by_name = any(get_origin(part) is dict for part in (annotation, *get_args(annotation)))
        here = _of_kind(list(_models(annotation)), value)
    return here


def _meaning(model: type[BaseModel], steps: Sequence[str | int], data: Any) -> str:
    """What the last step is that its table knows, if the table says so."""
    for k in reversed(range(len(steps))):
        around = _models_at(model, steps[:k], data)
        field = _fields(around[0]).get(str(steps[k])) if around else None
        if field:
            return f"{steps[k]} is {field.description}" if field.description else ""
    return ""


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """The tables anywhere in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _of_kind(models: list[type[BaseModel]], value: Any) -> list[type[BaseModel]]:
    """Those of the kind that a value says; all where it says none of theirs."""
    said = value.get("kind") if isinstance(value, dict) else None
    return [model for model in models if said in _kinds(model)] or models


def _kinds(model: type[BaseModel]) -> tuple[Any, ...]:
    """The kinds that a table may be of."""
    field = model.model_fields.get("kind")
    return get_args(field.annotation) if field else ()


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of a table by the names they have in the file."""
    return {field.alias or name: field for name, field in model.model_fields.items()}
