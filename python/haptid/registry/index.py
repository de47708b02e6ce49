"""`Index`: a SQLite file over a folder of plain files, brought up to date by what has changed on the disk."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import threading
import tomllib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from haptid._internal.bounded_files import DEFINITION_FILE, RESULT_FILE, read_bounded
from haptid._internal.late import dataclass
from haptid.log.file_format import sha256_of

IndexedKind = Literal["device", "study", "experiment", "log", "result"]
# Folder of each kind, and what counts in it: files by ending, or folders with a result file.
_FOLDERS: dict[IndexedKind, str] = {
    "device": "devices",
    "study": "studies",
    "experiment": "experiments",
    "log": "logs",
    "result": "results",
}
_RESULT = "result.json"
# Version of the tables below; an index of another version is rebuilt from the files.
_VERSION = 2
_TABLES = """
create table entries (
  path text primary key, kind text not null, sha256 text not null, size integer not null, modified integer not null,
  title text not null, words text not null, about text not null);
create index by_kind on entries (kind, modified);
create index by_content on entries (sha256);
create table inputs (result text not null, sha256 text not null);
create index by_input on inputs (sha256);
create index by_result on inputs (result);
"""


@dataclass(frozen=True)
class Indexed:
    """One file, or one folder of a result.

    Attributes:
        path: relative to the folder, with `/`.
        kind: what it is.
        sha256: of the file; of `result.json` for a result; empty for a log that is a folder.
        size: bytes.
        modified: time of the last change since 1970, s.
        title: name of the device or study; of others the file's.
        about: what a list shows, by kind.
        logs: of a result, the paths of its logs that are in this folder, found by their content.
        results: of a log, the results made of it.
    """

    path: str
    kind: IndexedKind
    sha256: str
    size: int
    modified: float
    title: str
    about: dict[str, Any]
    logs: tuple[str, ...] = ()
    results: tuple[str, ...] = ()


class Index:
    """The index of a folder.

    Args:
        root: the folder, with devices/, studies/, experiments/, logs/ and results/ as far as they are there.
        file: of the index; made, or made again, where it is absent, damaged or of another version.
    """

    def __init__(self, root: Path, file: Path) -> None:
        self._root, self._file, self._lock = root, file, threading.Lock()
        self._base = self._opened()

    def _opened(self) -> sqlite3.Connection:
        for fresh in (False, True):
            if fresh:
                self._file.unlink(missing_ok=True)
            base = sqlite3.connect(self._file, check_same_thread=False)
            try:
                base.execute("pragma journal_mode = wal")
                base.execute("pragma synchronous = normal")
                if base.execute("pragma user_version").fetchone()[0] == _VERSION:
                    base.execute("select count(*) from inputs, entries where 0")
                    return base
                if not base.execute("select count(*) from sqlite_master").fetchone()[0]:
                    base.executescript(_TABLES)
                    base.execute(f"pragma user_version = {_VERSION}")
                    return base
            except sqlite3.DatabaseError:
                pass
            base.close()
        raise sqlite3.DatabaseError(f"{self._file} cannot be made")

    def close(self) -> None:
        """Release the file."""
        self._base.close()

    def rebuild(self) -> int:
        """Rebuild the index from all files; their number."""
        with self._lock, self._base:
            self._base.execute("delete from entries")
            self._base.execute("delete from inputs")
        return self.refresh()

    def refresh(self) -> int:
        """Update the index from added, changed and removed files; the number of changed entries."""
        with self._lock:
            known = {row[0]: row[1:] for row in self._base.execute("select path, size, modified from entries")}
            present = dict(self._there())
            changed = [path for path, (_, *state) in present.items() if known.get(path) != tuple(state)]
            removed = [(path,) for path in known.keys() - present.keys()]
            with self._base:
                self._base.executemany("delete from entries where path = ?", removed)
                self._base.executemany("delete from inputs where result = ?", removed)
                for path in changed:
                    self._write(path, *present[path])
        return len(changed) + len(removed)

    def listed(self) -> tuple[int, ...]:
        """Times of the last additions, renamings and removals in the folders, ns; 0 for an absent one."""
        return tuple(_changed(self._root / folder) for folder in _FOLDERS.values())

    def search(self, kind: IndexedKind, words: str = "", limit: int = 200) -> list[Indexed]:
        """Entries of a kind that contain every word, the latest first."""
        wanted = [f"%{_escaped(word)}%" for word in words.lower().split()]
        condition = "".join(" and words like ? escape '\\'" for _ in wanted)
        ask = f"select * from entries where kind = ?{condition} order by modified desc, path limit ?"
        with self._lock:
            return [self._entry(row) for row in self._base.execute(ask, (kind, *wanted, limit)).fetchall()]

    def count(self, kind: IndexedKind) -> int:
        """Entries of a kind."""
        with self._lock:
            return int(self._base.execute("select count(*) from entries where kind = ?", (kind,)).fetchone()[0])

    def get(self, path: str) -> Indexed | None:
        """An entry by its path."""
        with self._lock:
            row = self._base.execute("select * from entries where path = ?", (path,)).fetchone()
            return None if row is None else self._entry(row)

    def of_content(self, sha256: str) -> list[Indexed]:
        """Files with this content."""
        with self._lock:
            rows = self._base.execute("select * from entries where sha256 = ?", (sha256,)).fetchall()
            return [self._entry(row) for row in rows]

    def _entry(self, row: tuple[Any, ...]) -> Indexed:
        path, kind, sha256, size, modified, title, _, about = row
        logs = "select path from entries join inputs using (sha256) where result = ? and kind = 'log' order by path"
        results = "select distinct result from inputs where sha256 = ? order by result"
        return Indexed(
            path,
            kind,
            sha256,
            size,
            modified * 1e-9,
            title,
            json.loads(about),
            tuple(log for (log,) in self._base.execute(logs, (path,))) if kind == "result" else (),
            tuple(log for (log,) in self._base.execute(results, (sha256,))) if kind == "log" and sha256 else (),
        )

    def _there(self) -> Iterator[tuple[str, tuple[IndexedKind, int, int]]]:
        """Path, kind, size and time of every file that counts; hidden ones do not."""
        for kind, folder in _FOLDERS.items():
            visible: list[os.DirEntry[str]] = []
            with suppress(FileNotFoundError, NotADirectoryError), os.scandir(self._root / folder) as entries:
                visible = [entry for entry in entries if not entry.name.startswith(".")]
            for entry in visible if kind in ("log", "result") else filter(_is_toml, visible):
                with suppress(OSError):
                    about = os.stat(os.path.join(entry.path, _RESULT) if kind == "result" else entry.path)
                    yield f"{folder}/{entry.name}", (kind, about.st_size, about.st_mtime_ns)

    def _write(self, path: str, kind: IndexedKind, size: int, modified: int) -> None:
        place = self._root / path
        try:
            title, sha256, about, inputs = _READERS[kind](place)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            title, sha256, about, inputs = place.name, "", {"unreadable": str(error)[:200]}, []
        text = json.dumps(about)
        words = " ".join([path, title, *(str(value) for value in about.values() if isinstance(value, str))]).lower()
        row = (path, kind, sha256, size, modified, title, words, text)
        self._base.execute("insert or replace into entries values (?, ?, ?, ?, ?, ?, ?, ?)", row)
        self._base.execute("delete from inputs where result = ?", (path,))
        self._base.executemany("insert into inputs values (?, ?)", [(path, sha) for sha in inputs])


_Read = tuple[str, str, dict[str, Any], list[str]]


def _is_toml(entry: os.DirEntry[str]) -> bool:
    return entry.name.endswith(".toml") and entry.is_file()


def _changed(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def _escaped(word: str) -> str:
    return word.replace("\\", "\\\\").replace("%", r"\%").replace("_", r"\_")


def _definition(path: Path) -> _Read:
    """A TOML file: its name, and of a study its device and logs."""
    content = read_bounded(path, DEFINITION_FILE)
    values = tomllib.loads(content.decode("utf-8"))
    about = {key: values[key] for key in ("device", "description", "serial") if isinstance(values.get(key), str)}
    logs = values.get("logs")
    if isinstance(logs, list):
        about["logs"] = [str(log.get("path")) for log in logs if isinstance(log, dict)]
    return str(values.get("name") or path.stem), hashlib.sha256(content).hexdigest(), about, []


def _recording(path: Path) -> _Read:
    return path.name, "" if path.is_dir() else sha256_of(path), {"ending": path.suffix.lower().lstrip(".")}, []


def _identified(path: Path) -> _Read:
    """A result folder: figures of the list of results, and the hashes of its logs."""
    content = read_bounded(path / _RESULT, RESULT_FILE)
    result = json.loads(content)
    unseen = [entry for entry in result["validation"] if entry["rows"] != "fit"]
    reference = [entry for entry in unseen if entry["rows"] == "reference"] or unseen
    errors = [entry["relative_error_percent"] for entry in reference if entry["motor"] == "all" or len(reference) == 1]
    about = {
        "device": result.get("device", ""),
        "serial": str(result.get("device_file", {}).get("serial", "")),
        "method": result["estimate"]["method"],
        "parameters": len(result["estimate"]["parameters"]),
        "error_percent": max((float(value) for value in errors if value is not None), default=None),
        "limit_percent": result["criteria"]["relative_error_percent"],
        "met": result["criteria"]["met"],
        "grades": {use["use"]: use["grade"] for use in result.get("verdict", [])},
        "logs": [log["path"] for log in result["logs"]],
        "haptid": result.get("haptid", ""),
    }
    return str(result["study"]), hashlib.sha256(content).hexdigest(), about, [log["sha256"] for log in result["logs"]]


_READERS: dict[IndexedKind, Callable[[Path], _Read]] = {
    "device": _definition,
    "study": _definition,
    "experiment": _definition,
    "log": _recording,
    "result": _identified,
}
