"""Tables written as TOML."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any


def toml(table: Mapping[str, Any]) -> str:
    """A table as TOML, one key per line; nested tables below the second level inline."""
    return "\n".join(_lines(table)) + "\n"


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    simple = {k: v for k, v in table.items() if not isinstance(v, Mapping) and not _tables(v)}
    yield from (f"{key} = {value_text(value)}" for key, value in simple.items() if value is not None)
    for key, value in table.items():
        for one in [value] if isinstance(value, Mapping) else value if _tables(value) else []:
            yield f"\n[{key}]" if isinstance(value, Mapping) else f"\n[[{key}]]"
            yield from (f"{name} = {value_text(v)}" for name, v in one.items() if v is not None)


def _tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, Mapping) for item in value)


def basic_string(text: str) -> str:
    """A TOML string, control characters escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def value_text(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {value_text(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(value_text(item) for item in value) + "]"
    if isinstance(value, str):
        return basic_string(value)
    return repr(value)
