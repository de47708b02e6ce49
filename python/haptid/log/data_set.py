"""Data sets of many log files: in a folder of this machine, or under a URL that fsspec knows (s3://, gs://, memory://)."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any

from haptid._internal.atomic_folder import MANIFEST
from haptid._internal.late import dataclass
from haptid.errors import LogFileError, MissingDependencyError
from haptid.log.file_format import FORMATS
from haptid.log.formats.folders import natural


@dataclass(frozen=True)
class DataFile:
    """A log file of a data set.

    Attributes:
        name: its path in the data set, with slashes.
        place: its path on this machine, or in the file system of the URL.
        size: bytes.
        url: of the data set; empty on this machine.
        version: changes when the file is written again, as far as its file system says.
    """

    name: str
    place: str
    size: int
    url: str = ""
    version: str = ""

    @contextmanager
    def here(self) -> Iterator[Path]:
        """The file on this machine: itself, or a copy that is deleted afterwards.

        Raises:
            LogFileError: it cannot be fetched.
        """
        if not self.url:
            yield Path(self.place)
            return
        with tempfile.TemporaryDirectory(prefix="haptid-") as folder:
            path = Path(folder) / PurePosixPath(self.name).name
            with _fetching(self.name):
                # A path alone does not name its host, nor the archive that it is in.
                system, _ = _file_system(self.url)
                system.get_file(self.place, str(path))
            yield path


def data_files(source: str) -> tuple[DataFile, ...]:
    """The log files of a data set, in folders of any depth, by the numbers in their names.

    Files and folders whose names begin with a point or an underscore are none of them, such as `_SUCCESS`, nor are the
    files of a folder of results. Links to folders are not followed.

    Args:
        source: a folder, or a URL of one; credentials are those of fsspec's configuration or the provider's.

    Raises:
        LogFileError: it does not exist, is a file, has no log in it, or cannot be listed.
        MissingDependencyError: fsspec, or its package for this kind of URL, is not installed.
    """
    if "://" in source:
        with _fetching(source):
            system, root = _file_system(source)
            listed = system.find(root, detail=True)
        root = f"{root.strip('/')}/".lstrip("/")
        found = [
            DataFile(path.lstrip("/").removeprefix(root), path, int(info["size"] or 0), source, _version(info))
            for path, info in listed.items()
        ]
    else:
        folder = Path(source)
        _refuse_no_folder(source)
        found = []
        for path in folder.rglob("*"):
            if path.is_file():
                name, status = path.relative_to(folder).as_posix(), path.stat()
                found.append(DataFile(name, str(path.absolute()), status.st_size, version=f"{status.st_mtime_ns}"))
    suffixes = {suffix for kind in FORMATS for suffix in kind.suffixes}
    logs = [file for file in found if PurePosixPath(file.name).suffix.lower() in suffixes]
    logs = [file for file in logs if not any(part[0] in "._" for part in PurePosixPath(file.name).parts)]
    results = {PurePosixPath(file.name).parent for file in found if PurePosixPath(file.name).name == MANIFEST}
    logs = [file for file in logs if PurePosixPath(file.name).parent not in results]
    if not logs:
        raise LogFileError(
            f"{source} has no log files.",
            where=source,
            found=len(found),
            limit=tuple(sorted(suffixes)),
            advice="Give a folder of Parquet files, or of other logs, or its URL.",
        )
    return tuple(sorted(logs, key=lambda file: natural(file.name)))


def _version(info: Mapping[str, Any]) -> str:
    """What a file system says of a file, such as its ETag and when it was written."""
    return str(sorted((key, str(value)) for key, value in info.items()))


def _refuse_no_folder(source: str) -> None:
    """Raise LogFileError where there is no folder."""
    if source and Path(source).is_dir():
        return
    there = bool(source) and Path(source).exists()
    shown = source or "A data set without a name"
    raise LogFileError(
        f"{shown} is a file, not a folder of log files." if there else f"{shown} does not exist.",
        where=source,
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
