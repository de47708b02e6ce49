"""`with_value`: a TOML text with one value set or removed, everything else as it was, comments too.

The value is found by lines, and the result is proved: read again, it differs from what was read before in this value
alone. A text in which that fails (a table written inline, a dotted key) is refused, and not changed.
"""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Sequence
from typing import Any

from haptid._internal.toml_text import basic_string, value_text

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_BARE = re.compile(r"[A-Za-z0-9_-]+")


class TomlEditError(ValueError):
    """A value that cannot be changed by lines."""


def with_value(text: str, path: Sequence[str | int], value: Any) -> str:
    """The text with a value.

    Args:
        text: TOML.
        path: keys from the top; a number is an entry of an array of tables. The last is the key.
        value: new one; None removes the key.

    Raises:
        TomlEditError: the text is no TOML, or the value is written in a way that is not changed by lines.
    """
    try:
        wanted = _changed(tomllib.loads(text), path, value)
    except (tomllib.TOMLDecodeError, KeyError, IndexError, TypeError) as error:
        raise TomlEditError(f"the text has no place for {_shown(path)}: {error}") from error
    lines = re.findall(r"[^\n]*\n|[^\n]+", text)  # other characters that end a line may stand in a string
    made = _edited(lines, path, value)
    try:
        proved = tomllib.loads(made) == wanted
    except tomllib.TOMLDecodeError:
        proved = False
    if not proved and len(path) > 1:
        inline = _inline(lines, path, wanted)
        if inline is not None:
            return with_value(text, path[:-1], inline)
    if not proved:
        raise TomlEditError(f"{_shown(path)} is written in a way that only a person can change: edit the text.")
    return made


def _changed(values: dict[str, Any], path: Sequence[str | int], value: Any) -> dict[str, Any]:
    """The values with one of them set or removed."""
    made = copy.deepcopy(values)
    at: Any = made
    for key in path[:-1]:
        if value is None and isinstance(key, str) and key not in at:
            return made
        at = at[key] if isinstance(key, int) else at.setdefault(key, {})
    if value is None:
        at.pop(path[-1], None)
    else:
        at[path[-1]] = value
    return made


def _inline(lines: list[str], path: Sequence[str | int], wanted: Any) -> dict[str, Any] | None:
    """The table that the value is in, changed, where it is written inline on one line; else None."""
    *table, name, _ = path
    names = [part for part in table if isinstance(part, str)]
    begin, end = _table(lines, names, next((part for part in reversed(table) if isinstance(part, int)), 0))
    found = _entry(lines, begin, end, str(name)) if begin >= 0 and isinstance(name, str) else None
    if found is None or found[1] != found[0] + 1:
        return None
    for part in path[:-1]:
        wanted = wanted[part]
    return wanted if isinstance(wanted, dict) else None


def _edited(lines: list[str], path: Sequence[str | int], value: Any) -> str:
    """The text with the line of the key replaced, removed, or added at the end of its table."""
    *table, key = path
    names = [part for part in table if isinstance(part, str)]
    begin, end = _table(lines, names, next((part for part in reversed(table) if isinstance(part, int)), 0))
    written = "" if value is None else f"{_key(str(key))} = {value_text(value)}"
    if begin < 0:
        last = "" if not lines or lines[-1].endswith("\n") else "\n"
        return "".join(lines) + (f"{last}\n[{'.'.join(map(_key, names))}]\n{written}\n" if written else "")
    found = _entry(lines, begin, end, str(key))
    if found is not None:
        first, stop = found
        comment = _comment(lines[stop - 1]) if stop == first + 1 else ""
        return "".join([*lines[:first], *([f"{written}{comment}\n"] if written else []), *lines[stop:]])
    if not written:
        return "".join(lines)
    while end > begin and not lines[end - 1].strip():
        end -= 1
    ending = [] if end == 0 or lines[end - 1].endswith("\n") else ["\n"]
    return "".join([*lines[:end], *ending, f"{written}\n", *lines[end:]])


def _table(lines: list[str], names: list[str], index: int) -> tuple[int, int]:
    """Lines of a table after its header, up to the next; -1 where it has none."""
    headers = [(k, found[2]) for k, line in enumerate(lines) if (found := _HEADER.match(line))]
    if not names:
        return 0, headers[0][0] if headers else len(lines)
    seen = -1
    for place, (k, name) in enumerate(headers):
        if [part.strip().strip("\"'") for part in name.split(".")] == names:
            seen += 1
            if seen == index:
                return k + 1, headers[place + 1][0] if place + 1 < len(headers) else len(lines)
    return -1, -1


def _entry(lines: list[str], begin: int, end: int, key: str) -> tuple[int, int] | None:
    """First line of a key's value, and one past its last."""
    start = re.compile(rf"\s*(?:{re.escape(key)}|{re.escape(basic_string(key))})\s*=")
    for first in range(begin, end):
        if start.match(lines[first]):
            for stop in range(first + 1, end + 1):
                try:
                    tomllib.loads("".join(lines[first:stop]))
                except tomllib.TOMLDecodeError:
                    continue
                return first, stop
    return None


def _comment(line: str) -> str:
    """The comment at the end of a line of one value, with the blanks before it."""
    for k in (found.start() for found in re.finditer(r"\s*#", line)):
        try:
            tomllib.loads(line[:k])
        except tomllib.TOMLDecodeError:
            continue
        return line[k:].rstrip("\n")
    return ""


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else basic_string(name)


def _shown(path: Sequence[str | int]) -> str:
    return ".".join(map(str, path))
