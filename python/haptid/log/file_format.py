"""Formats of log files: each with its suffixes and the module that reads it, and the format of a file."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from haptid._internal.bounded_files import LOG_FILE, open_regular
from haptid._internal.extensions import extension, extension_names
from haptid._internal.extras import needing
from haptid._internal.late import dataclass
from haptid.errors import LogFileError
from haptid.log.formats.assignments import is_assignments
from haptid.log.formats.controller_trace import HEAD, is_trace
from haptid.log.formats.folders import (
    MOST_TABLES,
    bag_files,
    data_set_files,
    is_pattern,
    log_files,
    matched_files,
    natural,
    parquet_files,
    root_of,
    table_files,
)
from haptid.log.formats.labelled import is_labelled
from haptid.log.formats.rearranged import is_rearranged
from haptid.log.formats.sniff import RawChannel, empty
from haptid.log.formats.transposed import is_transposed
from haptid.log.request import Request
from haptid.log.stamp_parts import with_parts, with_sums


@dataclass(frozen=True)
class Format:
    """A file format: its name, its suffixes, and the module that reads it, imported when needed.

    Attributes:
        by_rows: whether some rows can be read without the others.
        asks: whether reading depends on a `Request`, and its notes say what was found.
        groups: whether channels may be in groups, each with times of its own.
        extension: what another package declared in `haptid.log_formats`, in place of `module`.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    by_rows: bool = False
    asks: bool = False
    groups: bool = False
    extension: Any = None

    @property
    def _reader(self) -> Any:
        if self.extension is not None:
            return self.extension
        with needing(f"reading {self.name}"):
            return import_module(f"haptid.log.formats.{self.module}")

    def names(self, path: Path) -> list[str]:
        """Every channel of the file."""
        found: list[str] = self._reader.names(path)
        return found

    def columns(self, path: Path, wanted: Sequence[str], request: Request | None = None) -> dict[str, RawChannel]:
        """Those wanted channels that the file has, each (n,); sums of two, see `stamp_parts`, too."""
        more = (request or Request(),) if self.asks else ()
        found: dict[str, RawChannel] = self._reader.columns(path, with_parts(wanted), *more)
        return with_sums(wanted, found)

    def units(self, path: Path) -> dict[str, str]:
        """Units that the file states of its channels, as it spells them."""
        stated = getattr(self._reader, "units", None)
        found: dict[str, str] = {} if stated is None else stated(path)
        return found

    def texts(self, path: Path, wanted: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """Different texts in columns that hold no numbers, some of each, of formats that have such columns."""
        told = getattr(self._reader, "texts", None)
        found: dict[str, tuple[str, ...]] = {} if told is None else told(path, wanted)
        return found

    def beside(self, path: Path) -> dict[str, RawChannel]:
        """Lists of texts, and single numbers, beside the samples, each (n,), of formats that have such arrays."""
        told = getattr(self._reader, "beside", None)
        found: dict[str, RawChannel] = {} if told is None else told(path)
        return found

    def rows(self, path: Path, wanted: Sequence[str], start: int, stop: int) -> list[RawChannel]:
        """Rows start..stop of channels that the file has, each (stop - start,); where `by_rows`."""
        found: list[RawChannel] = self._reader.rows(path, wanted, start, stop)
        return found


FOLDER_OF_TABLES = "folder of tables"
FORMATS = (
    Format("CSV", (".csv", ".tsv", ".txt", ".dat", ".log", ".lvm"), "csv", asks=True),
    Format("Parquet", (".parquet", ".pq"), "parquet", by_rows=True),
    Format("MATLAB", (".mat",), "mat", groups=True),
    Format("NumPy", (".npz", ".npy"), "npz", groups=True),
    Format("HDF5", (".h5", ".hdf5"), "hdf5", by_rows=True, groups=True),
    Format("MCAP or ROS bag", (".mcap", ".bag", ".db3"), "messages", asks=True),
    Format("TDMS", (".tdms",), "tdms", asks=True, groups=True),
    Format("LeRobot data set", (), "lerobot", asks=True),
    Format("JSON", (".json", ".jsonl", ".ndjson"), "json"),
    Format("text with a channel in each row", (), "transposed"),
    Format("folder of Parquet files", (), "parquet_folder", by_rows=True),
    Format("trace of TwinCAT or CODESYS", (".trace", ".xml"), "controller_trace", asks=True),
    Format(FOLDER_OF_TABLES, (), "table_folder", asks=True),
    Format("text of a controller's variables", (), "assignments"),
    Format("text with labels", (".yaml", ".yml"), "labelled", asks=True),
    Format("text with lists, or a row for each joint", (), "rearranged", asks=True),
)
_TEXT, MESSAGES, LEROBOT, TRANSPOSED, _PARQUET_FILES, _TRACE, _TABLES, _ASSIGNED, _LABELLED, _REARRANGED = (
    FORMATS[k] for k in (0, 5, 7, 9, 10, 11, 12, 13, 14, 15)
)
# What Git LFS leaves in place of a file whose content was not fetched.
_POINTER = b"version https://git-lfs"
_SHEET = (
    "Save the sheet with the samples as CSV: by Save As, with `soffice --convert-to csv FILE`, or in Python "
    "`pandas.read_excel(FILE).to_csv('run.csv', index=False)`."
)
_PICKLE = (
    "A pickle can run code, so haptid reads none: where you trust it, load it in Python and save its arrays with "
    "`numpy.savez('run.npz', t=t, q=q, tau=tau)`."
)
_EVENTS = (
    "Its messages need the types that they were written with: in Python, read them with `lcm.EventLog(FILE)`, decode "
    "each with its type, and save the arrays with `numpy.savez('run.npz', t=t, q=q, tau=tau)`."
)
_RECORDS = (
    "In Python, read the episodes with `tensorflow_datasets`, and save the arrays of each with "
    "`numpy.savez('run.npz', t=t, q=q, tau=tau)`."
)
_UNPACK = "Unpack it, and name a file in it."
# How files of other kinds that hold logs are converted.
_CONVERSION = {
    **dict.fromkeys((".xlsx", ".xlsm", ".xls", ".ods"), _SHEET),
    **dict.fromkeys((".pkl", ".pickle", ".pth", ".pt"), _PICKLE),
    ".lcm": _EVENTS,
    ".lcmlog": _EVENTS,
    ".tfrecord": _RECORDS,
    ".ulg": "Convert it with `ulog2csv FILE` of the package pyulog, and put the CSV files into a folder of their own.",
    ".mf4": "Convert it in Python with the package asammdf: `asammdf.MDF(FILE).export('csv', filename='run.csv')`.",
    **dict.fromkeys((".zip", ".gz", ".7z", ".tar", ".tgz", ".xz", ".bz2", ".rar", ".zst"), _UNPACK),
}
# Logs that are named in an error.
_SHOWN = 8
_FOLDERS = (
    *((LEROBOT, data_set_files), (MESSAGES, bag_files)),
    *((_PARQUET_FILES, parquet_files), (_TABLES, table_files)),
)


def format_of(path: Path) -> Format:
    """The format by the suffix, of a file that exists and can be read."""
    try:
        if path.is_dir():
            for kind, files in _FOLDERS:
                if files(path):
                    return kind
            raise _no_log(path)
        if is_pattern(path):
            _check_matched(path)
            return _TABLES
        if not path.exists():
            raise LogFileError(
                f"{path}: no such file.",
                where=path,
                advice="Check the path; a study takes it from the folder of --data, or from its own.",
            )
        with open_regular(path, LOG_FILE) as file:
            head = file.read(HEAD)
    except (OSError, ValueError) as error:
        raise _inaccessible(path, getattr(error, "strerror", None) or str(error)) from error
    if not head:
        raise empty(path, "0 bytes")
    if head.startswith(_POINTER):
        raise LogFileError(
            f"{path} is a pointer of Git LFS: the log itself is not there.",
            where=path,
            advice="Fetch it with `git lfs pull` in its repository, or download the file by itself.",
        )
    for kind in FORMATS:
        if path.suffix.lower() in kind.suffixes:
            return _text(path, head) if kind is _TEXT else kind
    suffix = path.suffix.lower()
    if suffix and (found := extension("haptid.log_formats", suffix[1:])) is not None:
        return Format(suffix[1:].upper(), (suffix,), "", extension=found)
    known = [f"{kind.name} ({', '.join(kind.suffixes)})" for kind in FORMATS if kind.suffixes]
    known += [f".{name}" for name in extension_names("haptid.log_formats")]
    conversion = _CONVERSION.get(suffix.partition("-")[0], "Convert the log, or rename it.")  # .tfrecord-00000-of-00064
    raise LogFileError(
        f"{path}: its suffix {path.suffix!r} is not that of a log." if path.suffix else f"{path}: it has no suffix.",
        where=path,
        found=path.suffix,
        limit=tuple(known),
        advice=f"{conversion} Formats: {'; '.join(known)}.",
    )


def _text(path: Path, head: bytes) -> Format:
    """The format of a text with these first bytes."""
    by_head = ((is_trace, _TRACE), (is_assignments, _ASSIGNED), (is_labelled, _LABELLED), (is_rearranged, _REARRANGED))
    for fits, kind in by_head:
        if fits(head):
            return kind
    return TRANSPOSED if is_transposed(path) else _TEXT


def logs_in(folder: Path) -> list[Path]:
    """Logs in a folder that is none: the folders in it that are, or that hold one file of a log; by their numbers."""
    found = []
    for part in sorted(folder.iterdir(), key=lambda path: natural(path.name)):
        if part.is_dir() and not part.is_symlink():
            suffixes = {suffix for kind in FORMATS for suffix in kind.suffixes}
            alone = [file for file in part.iterdir() if file.suffix.lower() in suffixes and file.is_file()]
            found += [part] if log_files(part) != [] else alone[:1] if len(alone) == 1 else []
    return found


def _no_log(folder: Path) -> LogFileError:
    """Error of a folder that is no log, with the logs that are in it."""
    inside = logs_in(folder)
    shown = ", ".join(log.relative_to(folder).as_posix() for log in inside[:_SHOWN])
    more = f" and {len(inside) - _SHOWN} more" if len(inside) > _SHOWN else ""
    return LogFileError(
        f"{folder} is a folder, and neither a LeRobot data set, nor a ROS 2 bag, nor one of tables.",
        where=folder,
        advice=f"Name one of the logs in it: {shown}{more}; `haptid channels {folder} --device DEVICE` drafts a study "
        "of all of them."
        if inside
        else "Name one file in it.",
    )


def _check_matched(pattern: Path) -> None:
    """Refuse a path with one `*` that stands for no file, for more than one log has, or for those of two recordings."""
    from haptid.log.survey.parts import check_alone  # which knows the formats

    found = len(matched_files(pattern))
    if not found:
        raise LogFileError(
            f"{pattern}: no table or array matches.",
            where=pattern,
            advice="`*` stands for the words in which the names of one recording's files, or of their folders, differ.",
        )
    if found > MOST_TABLES:
        raise LogFileError(
            f"{pattern}: {found} files match; at most {MOST_TABLES} are one log.",
            where=pattern,
            found=found,
            limit=MOST_TABLES,
            advice="Name fewer, by more of their names before or after `*`.",
        )
    check_alone(pattern)


def _inaccessible(path: Path, why: str) -> LogFileError:
    """Error of a file that cannot be opened."""
    return LogFileError(f"{path} cannot be read: {why}.", where=path, advice="Check its permissions, or copy the file.")


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes; of several, of the names and digests of the files that hold its samples."""
    if path.is_dir() or is_pattern(path):
        root = root_of(path)
        lines = "".join(f"{sha256_of(file)}  {file.relative_to(root).as_posix()}\n" for file in log_files(path))
        return hashlib.sha256(lines.encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
