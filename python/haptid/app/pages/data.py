"""The data page: a log is dropped, its channels are guessed with reasons, and drawn as they were recorded."""

from __future__ import annotations

import json
import os
import struct
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from starlette.requests import Request as HttpRequest
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from haptid.app.answers import Asked, refusing
from haptid.app.session import PageCalls, Session
from haptid.app.workspace import EXPERIMENTS, LOGS, free_name
from haptid.errors import HaptidError, WorkbenchError

# Endings of logs that are one file.
LOG_ENDINGS = (
    ".csv",
    ".txt",
    ".tsv",
    ".dat",
    ".lvm",
    ".parquet",
    ".mat",
    ".npz",
    ".npy",
    ".h5",
    ".hdf5",
    ".mcap",
    ".bag",
    ".db3",
    ".tdms",
)
# Samples of a channel that are sent; of longer logs least and greatest of each run, so that no peak is lost.
_MOST_SAMPLES, _MOST_CHANNELS = 400_000, 32


def _look(session: Session, asked: Asked) -> Any:
    """What a log has: its channels with guessed roles, and what is noteworthy."""
    from haptid.log.survey import survey
    from haptid.results.tables import finite

    path = session.workspace.inside(asked.text("path"), LOGS)
    return finite(survey(path).to_json() | {"path": asked.text("path")})


async def _drop(session: Session, request: HttpRequest) -> JSONResponse:
    """A log is written while it comes in."""
    try:
        return JSONResponse(await _received(session, request))
    except HaptidError as error:
        return refusing(error, 413 if error.limit == session.largest_log else 400)


def _samples(session: Session, request: HttpRequest) -> Response:
    """Channels of a log or an experiment, for drawing."""
    try:
        path = session.workspace.inside(request.query_params.get("path", ""), LOGS, EXPERIMENTS)
        names = request.query_params.getlist("channel")
        return Response(
            packed_samples(path, request.query_params.get("time", ""), names), media_type="application/octet-stream"
        )
    except HaptidError as error:
        return refusing(error)


async def _received(session: Session, request: HttpRequest) -> dict[str, Any]:
    """Write a log to the disk while it comes in; the same content is not written twice."""
    from hashlib import sha256

    session.workspace, name = session.workspace, request.query_params.get("name", "")
    session.workspace.check_name(name, *LOG_ENDINGS)
    folder = session.workspace.folder / LOGS
    folder.mkdir(exist_ok=True)
    handle, part = tempfile.mkstemp(prefix=".dropped-", dir=folder)
    size, digest = 0, sha256()
    try:
        with os.fdopen(handle, "wb") as file:
            async for chunk in request.stream():
                size += len(chunk)
                if size > session.largest_log:
                    raise WorkbenchError(
                        f"{name} has more than {session.largest_log >> 20} MiB.",
                        where=name,
                        limit=session.largest_log,
                        advice=f"Copy it into {folder} instead.",
                    )
                file.write(chunk)
                digest.update(chunk)
        if not size:
            raise WorkbenchError(f"{name} is empty.", where=name)
        known = next((one for one in session.index.of_content(digest.hexdigest()) if one.kind == "log"), None)
        if known is not None:
            return {"path": known.path, "sha256": known.sha256, "bytes": size, "known": True}
        path = free_name(folder, name)
        os.chmod(part, 0o644)
        os.replace(part, path)
        session.changed()
        return {"path": session.workspace.name_of(path), "sha256": digest.hexdigest(), "bytes": size, "known": False}
    finally:
        with suppress(FileNotFoundError):
            os.unlink(part)


def packed_samples(path: Path, time: str, names: Sequence[str]) -> bytes:
    """Channels as they are in the file, for drawing.

    Args:
        path: of the log.
        time: name of the channel of times; rows are counted where empty.
        names: of the others.

    Returns:
        The length of a JSON head (4 bytes, little-endian), the head, blanks up to a multiple of 8, the times as float64
        and each channel as float32. The head has `names`, `rows` and `each`, the number of samples that a pair of least
        and greatest stands for (1: every sample is there).

    Raises:
        LogError: the log cannot be read.
        WorkbenchError: no channel, or too many.
    """
    import numpy as np

    from haptid.log.file_format import format_of
    from haptid.log.request import Request

    if not 0 < len(names) <= _MOST_CHANNELS:
        raise WorkbenchError(f"{len(names)} channels are asked for; 1 to {_MOST_CHANNELS} are drawn together.")
    wanted = list(dict.fromkeys([*([time] if time else []), *names]))
    columns = format_of(path).columns(path, wanted, Request())
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise WorkbenchError(f"{path.name} has no channel {missing[0]!r}.", where=missing[0])
    count = min(column.size for column in columns.values())
    t = np.asarray(columns[time][:count], dtype="<f8") if time else np.arange(count, dtype="<f8")
    if time and count and columns[time].dtype.kind in "iu":
        t = (columns[time][:count] - columns[time][0]).astype("<f8")
    signals = [np.asarray(columns[name][:count], dtype="<f4") for name in names]
    each = -(-2 * count // _MOST_SAMPLES) if count > _MOST_SAMPLES else 1
    if each > 1:
        from haptid.report.chart import extremes

        t = np.repeat(t[::each], 2)
        signals = [np.column_stack(extremes(signal, each)).ravel().astype("<f4") for signal in signals]
    head = json.dumps({"names": list(names), "rows": len(t), "each": each}).encode()
    head += b" " * (-(4 + len(head)) % 8)
    return b"".join([struct.pack("<I", len(head)), head, t.tobytes(), *(signal.tobytes() for signal in signals)])


def _streams(session: Session) -> list[BaseRoute]:
    """Routes with a body that is no JSON."""
    return [
        Route("/api/drop", partial(_drop, session), methods=["POST"]),
        Route("/api/samples", partial(_samples, session)),
    ]


DATA_CALLS = PageCalls(reads={"log": _look}, streams=_streams)
