"""The live page: a recording begins and ends, and what its samples say meanwhile."""

from __future__ import annotations

import json
import struct
from contextlib import suppress
from functools import partial
from typing import Any

from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from haptid._internal.numerals import whole_number
from haptid.app.answers import Asked
from haptid.app.recording import LiveRecording
from haptid.app.session import PageCalls, Session
from haptid.app.workspace import LOGS, STUDIES
from haptid.errors import WorkbenchError


def _start(session: Session, asked: Asked) -> dict[str, Any]:
    """A recording begins."""
    from haptid.live import LiveSettings

    name, log, forgetting = f"{asked.text('name')}.csv", asked.text("play", ""), asked.text("forgetting", "")
    session.workspace.check_name(name, ".csv")
    study = session.workspace.inside(asked.text("study"), STUDIES)
    source = session.workspace.inside(log, LOGS) if log else None
    settings = LiveSettings(
        rate_hz=_number("rate", asked.text("rate"), 1.0, 1e5),
        forgetting_s=_number("forgetting", forgetting, 1.0, 1e6) if forgetting else None,
    )
    port = int(_number("port", asked.text("port", "0"), 0, 65535))
    return session.live.start(study, name, settings, port, source)


def _stop(session: Session, _asked: Asked) -> dict[str, Any]:
    """The recording ends, and is a log."""
    return session.live.stop()


def _state(session: Session, asked: Asked) -> dict[str, Any]:
    """The recording that runs, if one does, with its treated rows after a time where one is asked for."""
    made, since = session.live.recording, asked.text("since", "")
    if made is None:
        return {"running": False}
    rows = {"new": _rows(made, _number("since", since, -1e12, 1e12))} if since else {}
    return {"running": True, **made.to_json(), **rows}


def _rows(made: LiveRecording, since: float) -> dict[str, Any]:
    """Treated torques after a time: measured, predicted, and the force of the hand with a model that is held."""
    import numpy as np

    found = made.analysis.rows_since(since)
    if not found:
        return {"t": [], "measured": [], "predicted": [], "force": None}
    measured, predicted = (
        np.concatenate([getattr(rows, name) for rows in found], axis=-1) for name in ("measured", "predicted")
    )
    blank = (np.full((3, len(rows.t)), np.nan) if rows.force is None else rows.force for rows in found)
    return {
        "t": np.concatenate([rows.t for rows in found]).tolist(),
        "measured": measured.tolist(),
        "predicted": predicted.tolist(),
        "force": None if found[-1].force is None else np.concatenate(list(blank), axis=1).tolist(),
    }


def _hold(session: Session, asked: Asked) -> dict[str, Any]:
    """The model of now is held against what comes, or no longer."""
    made = session.live.running()
    made.analysis.hold(asked.text("held") == "true")
    return made.to_json()


def _samples(session: Session, request: HttpRequest) -> Response:
    """Samples for drawing, after one that the page has; no content where the recording has ended."""
    made = session.live.recording
    since = whole_number(request.query_params.get("since", "0"), 15)
    if since is None:
        return Response("There is no such sample.\n", 404)
    if made is None:
        return Response(status_code=204)
    first, rows = made.since(since)
    head = json.dumps({"first": first, "rows": len(rows), "next": first + len(rows)}).encode()
    head += b" " * (-(4 + len(head)) % 8)
    parts = [rows[:, 0].astype("<f8").tobytes(), *(column.astype("<f4").tobytes() for column in rows[:, 1:].T)]
    content = b"".join([struct.pack("<I", len(head)), head, *parts])
    return Response(content, media_type="application/octet-stream")


async def _frames(session: Session, socket: WebSocket) -> None:
    """Frames of a controller by WebSocket."""
    await socket.accept()
    with suppress(WebSocketDisconnect, KeyError):
        while True:
            content = await socket.receive_bytes()
            made = session.live.recording
            if made is not None:
                made.receiver.take(content, id(socket))


def _number(name: str, text: str, low: float, high: float) -> float:
    """A number of a request.

    Raises:
        WorkbenchError: it is none, or out of range.
    """
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise WorkbenchError(f"{name} is {text[:40]!r}; write a number from {low:g} to {high:g}.", where=name)
    return value


def _streams(session: Session) -> list[BaseRoute]:
    """Samples for drawing, and frames by WebSocket."""
    return [
        Route("/api/live/samples", partial(_samples, session)),
        WebSocketRoute("/api/live/frames", partial(_frames, session)),
    ]


LIVE_CALLS = PageCalls(
    reads={"live/state": _state},
    changes={"live/start": _start, "live/stop": _stop, "live/hold": _hold},
    streams=_streams,
)
