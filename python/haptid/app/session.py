"""`Session`: what the pages of one start of the workbench share, and `PageCalls`: the calls that a page makes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from starlette.routing import BaseRoute

from haptid._internal.late import dataclass
from haptid.app.answers import Asked
from haptid.app.jobs import Jobs
from haptid.app.recording import Live
from haptid.app.workspace import WorkbenchFolder

if TYPE_CHECKING:
    from haptid.registry import Index

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
        self.live = Live(workspace, self.changed)
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

    def close(self) -> None:
        """End jobs and a recording, and release the index."""
        self.live.close()
        self.jobs.close()
        if "_index" in self.__dict__:
            self._index.close()


@dataclass(frozen=True)
class PageCalls:
    """Calls of a page, by their address below `/api/`.

    Attributes:
        reads: that change nothing: GET.
        changes: POST.
        streams: routes whose body or answer is no JSON.
    """

    reads: Mapping[str, Callable[[Session, Asked], Any]] = field(default_factory=dict)
    changes: Mapping[str, Callable[[Session, Asked], Any]] = field(default_factory=dict)
    streams: Callable[[Session], list[BaseRoute]] = lambda _: []
