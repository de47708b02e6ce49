"""The pages of results and of their use: the report's sections, comparison, drift, exports."""

from __future__ import annotations

import shlex
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from starlette.requests import Request as HttpRequest
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Route

from haptid.app.answers import Asked, refusing
from haptid.app.session import PageCalls, Session
from haptid.app.workspace import EXPERIMENTS, EXPORTS, RESULTS
from haptid.errors import HaptidError, WorkbenchError

# Of an exported file in the preview, characters.
_PREVIEW = 60_000
_SECONDS_IN_DAY = 86400.0


def _shown(session: Session, asked: Asked) -> dict[str, Any]:
    """The sections of a result's report, made of the data beside it."""
    from dataclasses import asdict

    from haptid.report import read_report
    from haptid.report.page import page_parts

    name = asked.text("path")
    folder = session.workspace.inside(name, RESULTS)
    report, entry = read_report(folder), session.index.get(name)
    files = sorted(path.name for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    return {
        "name": report.name,
        "about": f"{report.model}, {report.made}, haptid {report.haptid}",
        "files": files,
        "entry": entry and asdict(entry),
        "command": shlex.join(["haptid", "report", name]),
        **page_parts(tuple(report.sections.values())),
    }


def _compared(session: Session, asked: Asked) -> dict[str, Any]:
    """Each result against the first, and with dates the drift of the parameters."""
    from haptid.inference.comparison import compare
    from haptid.inference.drift import drift
    from haptid.report.compared import names_of
    from haptid.report.page import page_parts
    from haptid.report.sections.comparison import ComparisonSection
    from haptid.report.sections.drift import drift_section
    from haptid.results.result import Result

    names, times = asked.texts("paths"), asked.text("times", "")
    if len(names) < 2:
        raise WorkbenchError(f"{len(names)} results are chosen; two or more are compared.", limit=2)
    folders = [session.workspace.inside(name, RESULTS) for name in names]
    found, labels = [Result.load(folder) for folder in folders], names_of(folders)
    sections: list[Any] = [ComparisonSection.between(found, labels)]
    command = ["haptid", "report", *names, "--out", "comparison.html"]
    if times:
        when = [_day(part) for part in times.split(",")]
        sections.append(drift_section(drift(compare(*found, labels=labels), when), times.split(",")))
        command = ["haptid", "compare", *names, "--times", times]
    return {"command": shlex.join(command), **page_parts(sections)}


def _formats(_session: Session, _asked: Asked) -> list[str]:
    """Names of the exports."""
    from haptid.export.all_formats import export_formats

    return list(export_formats())


def _preview(session: Session, asked: Asked) -> dict[str, Any]:
    """What an export would write, made in a folder that is removed again."""
    name, to = asked.text("path"), asked.text("to")
    with tempfile.TemporaryDirectory(prefix="haptid-export-") as made:
        written = _exported(session.workspace.inside(name, RESULTS), Path(made), [to])[to]
        texts = [_shortened(written.folder / file) | {"name": file} for file in written.files]
    command = shlex.join(["haptid", "export", name, "--to", to, "--out", f"{EXPORTS}/{Path(name).name}"])
    return {"files": texts, "verdict": written.verdict, "command": command}


def _write(session: Session, asked: Asked) -> dict[str, Any]:
    """Exports are written into `exports/`."""
    name, formats = asked.text("path"), asked.texts("to")
    out = session.workspace.inside(f"{EXPORTS}/{Path(name).name}", EXPORTS)
    out.parent.mkdir(exist_ok=True)
    made = _exported(session.workspace.inside(name, RESULTS), out, formats)
    return {"folders": [session.workspace.name_of(one.folder) for one in made.values()]}


def _file(session: Session, request: HttpRequest) -> Response:
    """A file of a result, an export or an experiment as it is, to save."""
    try:
        path = session.workspace.inside(request.query_params.get("path", ""), RESULTS, EXPORTS, EXPERIMENTS)
    except HaptidError as error:
        return refusing(error, 404)
    if not path.is_file():
        return Response("There is no such file.\n", 404)
    return FileResponse(path, filename=path.name, content_disposition_type="attachment")


def _exported(result: Path, folder: Path, formats: list[str]) -> dict[str, Any]:
    from haptid.export import export_model
    from haptid.results.result import Result

    return dict(export_model(Result.load(result), folder, formats))


def _shortened(path: Path) -> dict[str, Any]:
    content = path.read_bytes()
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        return {"text": "", "bytes": len(content), "cut": False}
    return {"text": text[:_PREVIEW], "bytes": len(content), "cut": len(text) > _PREVIEW}


def _day(text: str) -> float:
    """A date as days since 1970; without a time zone it is UTC.

    Raises:
        WorkbenchError: it is no date.
    """
    from datetime import UTC, datetime

    try:
        date = datetime.fromisoformat(text.strip())
    except ValueError as error:
        raise WorkbenchError(f"{text!r} is no date.", where=text, advice="Write dates such as 2026-03-02.") from error
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp() / _SECONDS_IN_DAY


def _streams(session: Session) -> list[BaseRoute]:
    """Files to save."""
    return [Route("/api/download", partial(_file, session))]


RESULTS_CALLS = PageCalls(
    reads={"result": _shown, "compare": _compared, "formats": _formats, "export": _preview},
    changes={"export": _write},
    streams=_streams,
)
