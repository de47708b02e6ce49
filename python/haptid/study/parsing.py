"""From the text of a study file to its tables; what is wrong with it, in a sentence."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from haptid.errors import StudyFileError
from haptid.study.schema import StudyTable

# A study is a page of text; anything much larger is not one.
LARGEST_FILE = 1 << 20


def parsed(path: Path) -> StudyTable:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise StudyFileError(path, "", f"the file is larger than {LARGEST_FILE >> 20} MiB, so it is no study")
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise StudyFileError(path, "", "there is no such file; give the path of a study's TOML file") from error
    except (OSError, ValueError) as error:  # not readable, not UTF-8, not TOML
        raise StudyFileError(path, "", str(error)) from error
    try:
        return StudyTable.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where, table, key = _place(first["loc"])
        known = list(_fields(table)) if key not in _fields(table) else None
        raise StudyFileError(path, where, _sentence(first, table, key), known) from error


def _sentence(error: Any, table: type[BaseModel], key: str) -> str:
    """What is wrong with a key: what was found, and what the key is for."""
    found = "" if error["type"] == "missing" else f" (found {str(error.get('input'))[:60]!r})"
    text = {"missing": "this key is missing", "extra_forbidden": "there is no such key"}.get(error["type"])
    field = _fields(table).get(key)
    meaning = f"; {key} is {field.description}" if field is not None and field.description else ""
    return (text or str(error["msg"])) + found + meaning


def _fields(table: type[BaseModel]) -> dict[str, Any]:
    """Fields of a table by the names they have in the file."""
    return {field.alias or name: field for name, field in table.model_fields.items()}


def _place(location: tuple[int | str, ...]) -> tuple[str, type[BaseModel], str]:
    """Where an error is: as text, the table, and the key in it; without the tags of pydantic's unions."""
    table: type[BaseModel] = StudyTable
    shown: list[str] = []
    key = ""
    for k, part in enumerate(location):
        fields = _fields(table)
        if isinstance(part, int):
            shown.append(str(part))
        elif part in fields:
            shown.append(part)
            inner = _inner(fields[part].annotation)
            if isinstance(inner, type) and issubclass(inner, BaseModel) and k + 1 < len(location):
                table, key = inner, ""
            else:
                key = part
        elif k + 1 == len(location) and not key:
            shown.append(part)  # a key that is not known
            key = part
    return ".".join(shown), table, key


def _inner(annotation: Any) -> Any:
    """The table type inside `X | None` or `list[X]`."""
    for part in getattr(annotation, "__args__", ()):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part
    return annotation
