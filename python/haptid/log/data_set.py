"""Data sets of many log files: in a folder of this machine, or under a URL that fsspec knows (s3://, gs://, memory://)."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any

from haptid.errors import LogFileError, MissingDependencyError
from haptid.log.file_format import FORMATS
from haptid.log.formats.folders import natural


@dataclass(frozen=True)
class DataFile:
    """A log file of a data set.

    Attributes:
        name: its path in the data set, with slashes.
        place: its path on this machine, or its URL.
        size: bytes.
    """

    name: str
    place: str
    size: int

    @contextmanager
    def here(self) -> Iterator[Path]:
        """The file on this machine: itself, or a copy that is deleted afterwards.

        Raises:
            LogFileError: it cannot be fetched.
        """
        if "://" not in self.place:
            yield Path(self.place)
            return
        with tempfile.TemporaryDirectory(prefix="haptid-") as folder:
            path = Path(folder) / PurePosixPath(self.name).name
            with _fetching(self.name):
                system, there = _file_system(self.place)
                system.get_file(there, str(path))
            yield path


def data_files(source: str) -> tuple[DataFile, ...]:
    """The log files of a data set, in folders of any depth, by the numbers in their names.

    Files and folders whose names begin with a point or an underscore are none of them, such as `_SUCCESS`.

    Args:
        source: a folder, or a URL of one; credentials are those of fsspec's configuration or the provider's.

    Raises:
        LogFileError: it does not exist, is a file, has no log in it, or cannot be listed.
        MissingDependencyError: fsspec, or its package for this kind of URL, is not installed.
    """
    if "://" in source:
        with _fetching(source):
            system, root = _file_system(source)
            listed = {system.unstrip_protocol(path): info for path, info in system.find(root, detail=True).items()}
            base = system.unstrip_protocol(root).rstrip("/")
        found = [DataFile(url[len(base) + 1 :], url, int(info["size"] or 0)) for url, info in listed.items()]
    else:
        folder = Path(source)
        _refuse_no_folder(folder)
        paths = [path for path in folder.rglob("*") if path.is_file()]
        found = [
            DataFile(path.relative_to(folder).as_posix(), str(path.absolute()), path.stat().st_size) for path in paths
        ]
    suffixes = {suffix for kind in FORMATS for suffix in kind.suffixes}
    logs = [file for file in found if PurePosixPath(file.name).suffix.lower() in suffixes]
    logs = [file for file in logs if not any(part[0] in "._" for part in PurePosixPath(file.name).parts)]
    if not logs:
        raise LogFileError(
            f"{source} has no log files.",
            where=source,
            found=len(found),
            limit=tuple(sorted(suffixes)),
            advice="Give a folder of Parquet files, or of other logs, or its URL.",
        )
    return tuple(sorted(logs, key=lambda file: natural(file.name)))


def _refuse_no_folder(folder: Path) -> None:
    """Raise LogFileError where there is no folder."""
    if folder.is_dir():
        return
    there = folder.exists()
    raise LogFileError(
        f"{folder} is a file, not a folder of log files." if there else f"{folder} does not exist.",
        where=str(folder),
        advice="Give the folder that it is in, or identify it alone with `haptid identify`."
        if there
        else "Give a folder of log files, or its URL.",
    )


def _file_system(url: str) -> tuple[Any, str]:
    """fsspec's file system of a URL, and the path in it."""
    fsspec: Any = import_module("fsspec")
    system, path = fsspec.core.url_to_fs(url)
    return system, str(path)


@contextmanager
def _fetching(what: str) -> Iterator[None]:
    """Around calls of fsspec, whose file systems raise errors of their own kinds."""
    try:
        yield
    except ImportError as error:
        raise MissingDependencyError(
            f"{what} needs a package that is not installed: {error}.",
            where=error.name or what,
            advice='pip install "haptid[remote]", and the package of the provider, such as s3fs, gcsfs or adlfs.',
        ) from error
    except Exception as error:
        raise LogFileError(
            f"{what} cannot be read: {type(error).__name__}: {' '.join(str(error).split()) or 'no reason is given'}.",
            where=what,
            advice="Check the URL, the network, and the credentials that fsspec takes for it.",
        ) from error
