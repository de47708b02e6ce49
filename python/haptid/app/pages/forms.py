"""Forms of TOML files, made from their published schemas: views on the text, which stays the file."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

from haptid._internal.toml_edit import TomlEditError, with_value
from haptid.app.answers import Asked
from haptid.app.session import PageCalls, Session
from haptid.errors import WorkbenchError

_Path = tuple[str | int, ...]
_SIMPLE = {"string": "text", "number": "number", "integer": "integer", "boolean": "choice"}
# Tables below the second level, and keys that a page does not change.
_DEEPEST, _FIXED = 3, ("schema",)
_LARGEST = 2**20


def _form(_session: Session, asked: Asked) -> dict[str, Any]:
    """The fields of a text, with their values."""
    text, kind = asked.text("text"), asked.text("kind")
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        return {"error": f"The text is no TOML: {error}.", "fields": []}
    schema = _schema(kind, values)
    return {"fields": list(_fields(schema, schema, values, ()))}


def _changed(_session: Session, asked: Asked) -> dict[str, Any]:
    """The text with one value set; an empty one is removed."""
    text = asked.text("text")
    if len(text) > _LARGEST:
        raise WorkbenchError(f"the text has more than {_LARGEST} characters.")
    try:
        path, value = json.loads(asked.text("field")), json.loads(asked.text("value"))
        if not isinstance(path, list) or not path or not all(isinstance(key, str | int) for key in path):
            raise WorkbenchError("the field is no list of keys.", where="field")
        return {"text": with_value(text, path, value)}
    except TomlEditError as error:
        raise WorkbenchError(f"{error}", where=asked.text("field")) from error
    except (json.JSONDecodeError, RecursionError) as error:
        raise WorkbenchError("field or value is not JSON.") from error


def _left_out(_session: Session, asked: Asked) -> dict[str, Any]:
    """The text of a study without a stretch of one log, besides those that are left out already."""
    text, name = asked.text("text"), PurePosixPath(asked.text("log")).name
    try:
        logs = tomllib.loads(text).get("logs", [])
        stretch = [float(asked.text("begin")), float(asked.text("end"))]
        k = next(k for k, log in enumerate(logs) if PurePosixPath(log["path"]).name == name)
        return {"text": with_value(text, ("logs", k, "exclude"), [*logs[k].get("exclude", []), stretch])}
    except StopIteration:
        raise WorkbenchError(
            f"the study has no log {name}.", where="logs", advice="Draft a study of this log."
        ) from None
    except (TomlEditError, tomllib.TOMLDecodeError, TypeError, KeyError, AttributeError, ValueError) as error:
        raise WorkbenchError(f"no stretch can be left out of {name}: {error}.", where="logs") from error


def _schema(kind: str, values: dict[str, Any]) -> dict[str, Any]:
    """The published schema of a kind of file.

    Raises:
        WorkbenchError: there is none.
    """
    if kind == "study":
        from haptid.study import study_schema

        return study_schema()
    if kind == "device":
        from haptid.device import device_schema

        whole = device_schema()
        for entry in whole.get("oneOf", whole.get("anyOf", [whole])):
            own = _resolved(whole, entry)
            known = own.get("properties", {}).get("convention", {})
            if values.get("convention", "modified-dh") in (known.get("const"), known.get("default")):
                return own | {"$defs": whole.get("$defs", {})}
        return whole
    raise WorkbenchError(f"there is no form of {kind[:40]!r}.", where="kind", limit=("study", "device"))


def _fields(whole: dict[str, Any], schema: dict[str, Any], values: Any, path: _Path) -> Iterator[dict[str, Any]]:
    """Every value of a table that is a text, a number, a choice or a list of numbers; tables inside follow."""
    for name, given in schema.get("properties", {}).items():
        at, value = (*path, name), values.get(name) if isinstance(values, dict) else None
        if name in _FIXED and not path:
            continue
        about = {"path": list(at), "about": given.get("description", ""), "value": value}
        options = [_resolved(whole, one) for one in given.get("anyOf", given.get("oneOf", [given]))]
        kind = _kind(options, value)
        if kind is not None:
            yield about | kind
        elif len(path) < _DEEPEST:
            for one in options:
                if "properties" in one:
                    yield from _fields(whole, one, value, at)
                    break
                inner = _resolved(whole, one.get("items", {}))
                if "properties" in inner and isinstance(value, list):
                    for k, entry in enumerate(value):
                        yield from _fields(whole, inner, entry, (*at, k))
                    break


def _kind(options: list[dict[str, Any]], value: Any) -> dict[str, Any] | None:
    """What a field is; None for a table, and for what a form cannot say."""
    choices = [c for one in options for c in one.get("enum", [one["const"]] if "const" in one else [])]
    types = [one.get("type") for one in options if one.get("type") != "null" and not one.get("enum")]
    if isinstance(value, list):
        numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
        return {"kind": "numbers"} if numbers and "array" in types else None
    if isinstance(value, dict):
        return None
    if choices and not set(types) - {"string", "boolean"}:
        return {"kind": "choice", "choices": choices}
    for kind in ("number", "integer", "string", "boolean"):
        if kind in types:
            return {"kind": _SIMPLE[kind], **({"choices": [True, False]} if kind == "boolean" else {})}
    return None


def _resolved(whole: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """A schema behind a reference."""
    name = given.get("$ref", "").removeprefix("#/$defs/")
    found = whole.get("$defs", {}).get(name) if name else None
    return {**found, **{k: v for k, v in given.items() if k != "$ref"}} if found else given


FORMS_CALLS = PageCalls(changes={"form": _form, "form/set": _changed, "form/leave-out": _left_out})
