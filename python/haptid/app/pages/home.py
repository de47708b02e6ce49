"""The home page, and what all pages share: lists of the folder, texts of files, jobs, the report's style and script."""

from __future__ import annotations

from dataclasses import asdict
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from haptid.app.answers import Asked
from haptid.app.session import PageCalls, Session

if TYPE_CHECKING:
    from haptid.registry.index import IndexedKind


def _overview(session: Session, asked: Asked) -> dict[str, Any]:
    """What the home page lists, of the words that are searched."""
    from importlib.util import find_spec

    index, words = session.index, asked.text("words", "")
    kinds: tuple[IndexedKind, ...] = ("device", "study", "experiment", "log", "result")
    return {
        "folder": str(session.workspace.folder),
        "lists": {kind: [asdict(entry) for entry in index.search(kind, words)] for kind in kinds},
        "counts": {kind: index.count(kind) for kind in kinds},
        "jobs": [asdict(record) for record in session.jobs.recent(8)],
        "bench": find_spec("mujoco") is not None,
    }


def _text_of(session: Session, asked: Asked) -> dict[str, str]:
    """The text of an edited file, and its hash."""
    text, sha256 = session.workspace.read_text(asked.text("path"))
    return {"text": text, "sha256": sha256}


def _save(session: Session, asked: Asked) -> dict[str, str]:
    """A text is written, unless its file is not the one that the page had read."""
    made = session.workspace.save_text(asked.text("path"), asked.text("text"), asked.text("known", ""))
    session.changed()
    return {"sha256": made}


def _job(session: Session, asked: Asked) -> dict[str, Any]:
    """A job as it is now."""
    return asdict(session.jobs.get(asked.text("id")))


def _cancel(session: Session, asked: Asked) -> dict[str, Any]:
    """A job ends."""
    return asdict(session.jobs.cancel(asked.text("id")))


def _report_part(request: HttpRequest) -> Response:
    """Style and script of the report: the same modules draw here."""
    from haptid.report.page import module_of_scripts

    name = request.path_params["name"]
    if name == "page.css":
        return Response((files("haptid.report") / "templates" / name).read_bytes(), media_type="text/css")
    if name == "charts.js":
        return Response(module_of_scripts(), media_type="text/javascript")
    return Response("There is no such part of the report.\n", 404)


def _streams(_session: Session) -> list[BaseRoute]:
    """Parts of the report."""
    return [Route("/report/{name}", _report_part)]


HOME_CALLS = PageCalls(
    reads={"workspace": _overview, "file": _text_of, "jobs/{id}": _job},
    changes={"file": _save, "jobs/{id}/cancel": _cancel},
    streams=_streams,
)
