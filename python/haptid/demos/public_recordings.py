"""Public recordings of real machines: a list of them, and their download with a check of every file."""

from __future__ import annotations

import hashlib
import http.client
import tomllib
import urllib.error
import urllib.request
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from haptid._internal.atomic_folder import publishing
from haptid._internal.extras import needing
from haptid.errors import LogFileError, unknown_name

Progress = Callable[[str, float], None]
# Time without data after which a download fails, s.
_PATIENCE = 30.0
_BLOCK = 2**16


class _Table(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class RecordedFile(_Table):
    """One published file.

    Attributes:
        source: its path below the recording's address.
        to: its name in the folder; that of `source` where None.
        bytes: its size.
        sha256: of its content.
    """

    source: Annotated[str, Field(alias="from")]
    to: str | None = None
    bytes: int
    sha256: str

    @property
    def name(self) -> str:
        """Its name in the folder."""
        return self.to or self.source.rpartition("/")[2]


class Joined(_Table):
    """Tables of equal length, side by side in one file.

    Attributes:
        to: name of that file, Parquet.
        rate_hz: of its rows.
        columns: prefix of the columns of each table, which are numbered from 1.
    """

    to: str
    rate_hz: float
    columns: list[str]


class PublicRecording(_Table):
    """A published recording.

    Attributes:
        name: of it, and of the shipped device that it is of.
        what: was recorded.
        licence: under which it was published.
        cite: its source.
        page: where it is described.
        address: of its files.
        files: to download.
        joined: what is written in place of them; None where they are kept as they are.
    """

    name: str
    what: str
    licence: str
    cite: str
    page: str
    address: str
    files: list[RecordedFile]
    joined: Joined | None = None


def public_recordings() -> tuple[PublicRecording, ...]:
    """All known public recordings."""
    text = resources.files("haptid.demos").joinpath("public_recordings.toml").read_text(encoding="utf-8")
    return tuple(PublicRecording.model_validate(table) for table in tomllib.loads(text)["recordings"])


def public_recording(name: str) -> PublicRecording:
    """A public recording by its name.

    Raises:
        UnknownNameError: there is none.
    """
    known = {recording.name: recording for recording in public_recordings()}
    if name not in known:
        raise unknown_name(f"there is no recording {name!r}.", name, known)
    return known[name]


def fetch_recording(recording: PublicRecording, folder: Path, progress: Progress | None = None) -> tuple[Path, ...]:
    """Download a recording; its files are written together, once each has the published size and SHA-256.

    Args:
        recording: which.
        folder: to write to; other files in it are kept.
        progress: called with what is downloaded and the share that is done.

    Returns:
        Paths of the written logs.

    Raises:
        LogFileError: a file cannot be downloaded, or is not the one that was published.
        OutputFolderError: the folder cannot be written.
        MissingDependencyError: the tables are joined to Parquet, and pyarrow is not installed.
    """
    total, done = sum(file.bytes for file in recording.files), 0
    with publishing(folder) as scratch:
        for file in recording.files:

            def report(count: int, name: str = file.name, before: int = done) -> None:
                if progress is not None:
                    progress(f"{recording.name}: {name}", (before + count) / total)

            _download(recording.address + file.source, scratch / file.name, file, report)
            done += file.bytes
        names = [file.name for file in recording.files]
        if recording.joined is not None:
            _join([scratch / name for name in names], recording.joined, scratch)
            names = [recording.joined.to]
    return tuple(folder / name for name in names)


def _download(address: str, path: Path, wanted: RecordedFile, progress: Callable[[int], None]) -> None:
    """One file, of which no byte more than the published size is read."""
    digest, count = hashlib.sha256(), 0
    try:
        with urllib.request.urlopen(address, timeout=_PATIENCE) as answer, path.open("wb") as file:
            while block := answer.read(min(_BLOCK, wanted.bytes + 1 - count)):
                file.write(block)
                digest.update(block)
                count += len(block)
                progress(count)
    except (urllib.error.URLError, http.client.HTTPException, TimeoutError, ConnectionError) as error:
        reason = getattr(error, "reason", None) or error
        raise LogFileError(
            f"{address} cannot be downloaded: {reason}.",
            where=address,
            found=str(reason),
            advice=f"Check the connection; or download it elsewhere, and save it as {wanted.name}.",
        ) from error
    if digest.hexdigest() != wanted.sha256:
        raise LogFileError(
            f"{address} is not the published file: it has {'more than ' * (count > wanted.bytes)}"
            f"{min(count, wanted.bytes)} bytes and another SHA-256 than the published one of {wanted.bytes} bytes.",
            where=address,
            found=digest.hexdigest(),
            limit=wanted.sha256,
            advice="Nothing was written. Try again; a proxy may have answered in place of the server.",
        )


def _join(tables: list[Path], joined: Joined, folder: Path) -> None:
    """Write CSV tables of equal length as one Parquet file, and remove them."""
    with needing("writing Parquet"):
        import pyarrow as pa
        from pyarrow import parquet
    columns: dict[str, np.ndarray] = {}
    for prefix, path in zip(joined.columns, tables, strict=True):
        table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
        columns |= {f"{prefix}{k}": column for k, column in enumerate(table.T, 1)}
        path.unlink()
    rows = len(next(iter(columns.values())))
    parquet.write_table(pa.table({"t": np.arange(rows) / joined.rate_hz, **columns}), folder / joined.to)
