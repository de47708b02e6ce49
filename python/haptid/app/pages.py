"""`Session`: what the pages of one start of the workbench share, and the calls that they make."""

from __future__ import annotations

import threading
import time
from dataclasses import asdict
from functools import cached_property
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from starlette.requests import Request as HttpRequest
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from haptid.app import (
    data_calls,
    device_calls,
    experiment_calls,
    forms,
    live_calls,
    registry_calls,
    remedies,
    result_calls,
    study_calls,
)
from haptid.app.answers import Asked, call
from haptid.app.jobs import Jobs
from haptid.app.workspace import WorkbenchFolder

if TYPE_CHECKING:
    from haptid.registry import Index
    from haptid.registry.index import IndexedKind

# Names of the pages; the first part of their addresses.
PAGES = ("device", "experiment", "data", "solve", "results", "use", "live", "registry")
# An index is used for this many times the duration of its scan, or until a file is added, renamed or removed: pages
# loaded together scan a large folder once.
_FRESH = 2.0


class Session:
    """The folder, its jobs and its index.

    Args:
        workspace: the folder.
        largest_log: bytes of a log that is dropped on a page.
        reindex: whether the index is made again from the files.
    """

    def __init__(self, workspace: WorkbenchFolder, largest_log: int, reindex: bool = False) -> None:
        self.workspace, self.largest_log = workspace, largest_log
        self.jobs = Jobs(workspace.folder, workspace.own() / "jobs")
        self.live = live_calls.Live(workspace, self.changed)
        self._reindex, self._lock = reindex, threading.Lock()
        self._good_until = 0.0
        self._listed: tuple[int, ...] = ()

    @cached_property
    def _index(self) -> Index:
        from haptid.registry import Index

        made = Index(self.workspace.folder, self.workspace.own() / "index.sqlite")
        if self._reindex:
            made.rebuild()
        return made

    @property
    def index(self) -> Index:
        """The index, as the files are now."""
        with self._lock:
            began, listed = time.monotonic(), self._index.listed()
            if began >= self._good_until or listed != self._listed:
                self._index.refresh()
                done = time.monotonic()
                self._good_until, self._listed = done + _FRESH * (done - began), listed
            return self._index

    def changed(self) -> None:
        """Scan the folder again at the next use of the index, after a file was written."""
        self._good_until = 0.0

    def routes(self) -> list[BaseRoute]:
        """The calls of all pages."""
        calls = {
            "workspace": self._overview,
            "file": lambda asked: dict(
                zip(("text", "sha256"), self.workspace.read_text(asked.text("path")), strict=True)
            ),
            "jobs/{id}": lambda asked: asdict(self.jobs.get(asked.text("id"))),
            **device_calls.device_reads(self),
            **data_calls.log_reads(self),
            **study_calls.study_reads(self),
            **result_calls.result_reads(self),
            **live_calls.live_reads(self),
            **experiment_calls.experiment_reads(self),
            **registry_calls.registry_reads(self),
        }
        changes = {
            "file": self._save,
            "jobs/{id}/cancel": lambda asked: asdict(self.jobs.cancel(asked.text("id"))),
            **device_calls.device_changes(self),
            **data_calls.log_changes(self),
            **study_calls.study_changes(self),
            **result_calls.result_changes(self),
            **live_calls.live_changes(self),
            **experiment_calls.experiment_changes(self),
            **registry_calls.registry_changes(self),
            **forms.form_changes(),
            **remedies.remedy_changes(self),
        }
        return [
            *(Route(f"/api/{path}", call(made), methods=["POST"]) for path, made in changes.items()),
            *(Route(f"/api/{path}", call(made)) for path, made in calls.items()),
            *data_calls.log_streams(self),
            *result_calls.result_streams(self),
            *live_calls.live_streams(self),
            Route("/report/{name}", _report_part),
        ]

    def close(self) -> None:
        """End jobs and a recording, and release the index."""
        self.live.close()
        self.jobs.close()
        if "_index" in self.__dict__:
            self._index.close()

    def _overview(self, asked: Asked) -> dict[str, Any]:
        """What the home page lists, of the words that are searched."""
        from importlib.util import find_spec

        index, words = self.index, asked.text("words", "")
        kinds: tuple[IndexedKind, ...] = ("device", "study", "experiment", "log", "result")
        return {
            "folder": str(self.workspace.folder),
            "lists": {kind: [asdict(entry) for entry in index.search(kind, words)] for kind in kinds},
            "counts": {kind: index.count(kind) for kind in kinds},
            "jobs": [asdict(record) for record in self.jobs.recent(8)],
            "bench": find_spec("mujoco") is not None,
        }

    def _save(self, asked: Asked) -> dict[str, str]:
        made = self.workspace.save_text(asked.text("path"), asked.text("text"), asked.text("known", ""))
        self.changed()
        return {"sha256": made}


def _report_part(request: HttpRequest) -> Response:
    """Style and script of the report: the same modules draw here."""
    from haptid.report.page import module_of_scripts

    name = request.path_params["name"]
    if name == "page.css":
        return Response((files("haptid.report") / "templates" / name).read_bytes(), media_type="text/css")
    if name == "charts.js":
        return Response(module_of_scripts(), media_type="text/javascript")
    return Response("There is no such part of the report.\n", 404)
