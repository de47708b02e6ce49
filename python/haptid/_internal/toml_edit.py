"""`rewritten` and `with_value`: a TOML text with other values, and everything else as it was, comments and order too.

The result is proved: read again, it has exactly the wanted values.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping, MutableMapping, MutableSequence, Sequence
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, InlineTable, Item, Table

from haptid._internal.toml_text import toml


class TomlEditError(ValueError):
    """A value that cannot be changed, because the text has no place for it."""


def with_value(text: str, path: Sequence[str | int], value: Any) -> str:
    """The text with one value.

    Args:
        text: TOML.
        path: keys from the top; a number is an entry of an array. The last is the key.
        value: new one; None removes the key.

    Raises:
        TomlEditError: the text is no TOML, or has no such place.
    """
    try:
        return rewritten(text, _changed(tomllib.loads(text), path, value))
    except (tomllib.TOMLDecodeError, KeyError, IndexError, TypeError) as error:
        raise TomlEditError(f"the text has no place for {'.'.join(map(str, path))}: {error}") from error


def rewritten(text: str, wanted: Mapping[str, Any]) -> str:
    """The text with these values: what is equal stays as it is written, keys that are not wanted go.

    Where that cannot be done, the values are written anew, without comments.

    Args:
        text: TOML.
        wanted: tables of all its values; None is left out.
    """
    plain = _without_none(wanted)
    try:
        document = tomlkit.parse(text)
        _merge(document, plain)
        made = tomlkit.dumps(document)
        if tomllib.loads(made) == plain:
            return made
    except (TOMLKitError, tomllib.TOMLDecodeError, TypeError, ValueError, KeyError, IndexError, AttributeError):
        pass
    return toml(plain)


def _changed(values: dict[str, Any], path: Sequence[str | int], value: Any) -> dict[str, Any]:
    """The values with one of them set or removed."""
    changed = copy.deepcopy(values)
    target: Any = changed
    for key in path[:-1]:
        if value is None and isinstance(key, str) and key not in target:
            return changed
        target = target.setdefault(key, {}) if isinstance(key, str) else target[key]
    if value is None:
        target.pop(path[-1], None)
    else:
        target[path[-1]] = value
    return changed


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [_without_none(item) for item in value]
    return value


def _merge(written: MutableMapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Change a table of a document to the wanted values, as little as possible."""
    for key in [key for key in written if key not in wanted]:
        del written[key]
    for key, value in wanted.items():
        if key not in written:
            written[key] = _item(value, top=isinstance(written, (tomlkit.TOMLDocument, Table)))
        elif isinstance(value, Mapping) and isinstance(written[key], MutableMapping):
            _merge(written[key], value)
        elif _tables(value) and _tables(written[key]):
            _merge_tables(written[key], value)
        elif not _same(written[key], value):
            written[key] = _inline(value) if isinstance(value, Mapping) else value


def _merge_tables(written: MutableSequence[Any], wanted: Sequence[Mapping[str, Any]]) -> None:
    """Change a list of tables: those that are not wanted go, changed ones keep their places, new ones stand last."""
    k = 0
    while len(written) > len(wanted):
        table_wanted = wanted[k] if k < len(wanted) else {}
        if k + 1 == len(written) or _alike(written[k], table_wanted) < _alike(written[k + 1], table_wanted):
            del written[k]
        else:
            k += 1
    for table, value in zip(written, wanted, strict=False):
        _merge(table, value)
    for value in wanted[len(written) :]:
        written.append(_table(value) if isinstance(written, AoT) else _inline(value))


def _item(value: Any, top: bool) -> Item:
    """A new value: tables with headers of their own, except within inline ones."""
    if top and isinstance(value, Mapping):
        return _table(value)
    if top and _tables(value):
        tables = tomlkit.aot()
        for table in value:
            tables.append(_table(table))
        return tables
    plain: Item = _inline(value) if isinstance(value, Mapping) else tomlkit.item(value)
    return plain


def _table(value: Mapping[str, Any]) -> Table:
    """A table whose own tables are inline."""
    table = tomlkit.table()
    for key, item in value.items():
        table[key] = _inline(item) if isinstance(item, Mapping) else item
    return table


def _inline(value: Mapping[str, Any]) -> InlineTable:
    table = tomlkit.inline_table()
    for key, item in value.items():
        table[key] = _inline(item) if isinstance(item, Mapping) else item
    return table


def _alike(written: Mapping[str, Any], value: Mapping[str, Any]) -> int:
    """How many of the values are as they are written."""
    return sum(key in written and _same(written[key], item) for key, item in value.items())


def _tables(value: Any) -> bool:
    return isinstance(value, (list, AoT)) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _same(written: Any, value: Any) -> bool:
    """Whether a value is equal, and of the same kind: 1, 1.0 and true are not the same."""
    plain = written.unwrap() if hasattr(written, "unwrap") else written
    return type(plain) is type(value) and bool(plain == value)
