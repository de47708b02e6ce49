"""Logs that are folders: a ROS 2 bag, a LeRobot data set, rows in several Parquet files, signals in several tables."""

from __future__ import annotations

import re
from pathlib import Path

BAG_SUFFIXES = (".mcap", ".bag", ".db3")
_INFO = "meta/info.json"
# Suffixes of files with one signal each, and most of them in a folder.
_TABLES, MOST_TABLES = (".csv", ".tsv", ".txt", ".dat", ".npy", ".mat"), 64


# What YARP's dumper writes into the folder of each port: a count, the time, and the samples in each line.
DUMP = "data.log"


def bag_files(folder: Path) -> list[Path]:
    """The files of a bag's folder; their numbers are counted, not spelled: bag_10 follows bag_9."""
    files = [file for file in folder.iterdir() if file.suffix.lower() in BAG_SUFFIXES and file.is_file()]
    return sorted(files, key=lambda file: natural(file.name))


def data_set_files(folder: Path) -> list[Path]:
    """The description and the tables of a data set's folder, description first; none where it is no data set."""
    if not (folder / _INFO).is_file():
        return []
    tables = [file for file in (folder / "data").glob("*/*.parquet") if file.is_file()]
    return [folder / _INFO, *sorted(tables, key=lambda file: natural(file.relative_to(folder).as_posix()))]


def parquet_files(folder: Path) -> list[Path]:
    """Parquet files in a folder, or in folders in it, by their numbers."""
    files = [file for pattern in ("*.parquet", "*/*.parquet") for file in folder.glob(pattern) if file.is_file()]
    return sorted(files, key=lambda file: natural(file.relative_to(folder).as_posix()))


def table_files(folder: Path) -> list[Path]:
    """Tables and arrays in a folder: signals of one recording, a file for each; or a folder for each with a dump."""
    files = [file for file in folder.iterdir() if file.suffix.lower() in _TABLES and file.is_file()]
    files = files or [file for file in folder.glob(f"*/{DUMP}") if file.is_file()]
    key = [(natural(file.relative_to(folder).as_posix()), file) for file in files]
    return [file for _, file in sorted(key)] if 1 < len(files) <= MOST_TABLES else []


def is_pattern(path: Path) -> bool:
    """Whether a path stands for several files: it has one `*` below the folders that exist, and is itself none."""
    if "*" not in str(path) or path.exists():
        return False
    name, *inside = path.relative_to(root_of(path)).parts
    return name.count("*") == 1 and "*" not in "".join(inside)


def root_of(path: Path) -> Path:
    """The folder that a log's files are named from: itself, or the deepest one above it that exists, above a `*`."""
    return next((folder for folder in (path, *path.parents) if folder.is_dir()), Path(path.anchor))


def matched_files(pattern: Path) -> list[tuple[str, Path]]:
    """Tables and arrays that a path with one `*` stands for, each behind what it has there: `run1_*.csv`, `*/run1.csv`.

    The `*` is within the name of a file or of a folder. There may be more of them than a log has, see `MOST_TABLES`.
    """
    root = root_of(pattern)
    star, *below = pattern.relative_to(root).parts
    start, _, end = star.partition("*")
    found = []
    for entry in root.iterdir() if root.is_dir() else ():
        name, file = entry.name, entry.joinpath(*below)
        whole = len(name) > len(start) + len(end) and name.startswith(start) and name.endswith(end)
        if whole and file.suffix.lower() in _TABLES and file.is_file():
            found.append((name[len(start) : len(name) - len(end)], file))
    return sorted(found, key=lambda own: natural(own[0]))


def log_files(path: Path) -> list[Path]:
    """The files that hold a log's samples: itself, those of its folder, or those that its one `*` stands for."""
    if is_pattern(path):
        files = [file for _, file in matched_files(path)]
        return files if len(files) <= MOST_TABLES else []
    if not path.is_dir():
        return [path]
    return data_set_files(path) or bag_files(path) or parquet_files(path) or table_files(path)


def log_size(path: Path) -> int:
    """Bytes of the files that hold a log's samples."""
    return sum(file.stat().st_size for file in log_files(path))


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts numbers in names by their value."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]
