"""Jobs: long work in a spawned process each, one at a time, with progress, cancelling, and a record on disk.

A job belongs to the folder and not to a tab: a page that is closed or loaded again finds it by its number. Its record
in `.haptid/jobs/` survives the server; a job that was running when the server ended is recorded as interrupted.
"""

from __future__ import annotations

import json
import multiprocessing
import secrets
import threading
import time
from contextlib import suppress
from dataclasses import asdict, field
from enum import StrEnum
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from haptid._internal.atomic_folder import write_file
from haptid._internal.interruption import interruption_held
from haptid._internal.late import dataclass
from haptid.errors import WorkbenchError

# Records that are kept, and what a cancelled process may take to end before it is killed, s.
_KEPT, _GRACE = 200, 0.5


class JobState(StrEnum):
    """State of a job."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    INTERRUPTED = "interrupted"


@dataclass
class JobRecord:
    """A job as JSON for a page.

    Attributes:
        id: in its address.
        kind: key of `app.work.WORK`.
        title: for people.
        command: that does the same on the command line, one a line.
        arguments: of the work.
        state: running, done, failed, cancelled or interrupted.
        begun, ended: times since 1970, s; `ended` is 0 while it runs.
        steps: names of the steps so far with the share done and the seconds since the job began.
        error: why it failed, a sentence.
        defect: traceback where the failure is a defect of haptid.
        outcome: what the work returned.
    """

    id: str
    kind: str
    title: str
    command: str
    arguments: dict[str, Any]
    state: str = JobState.RUNNING
    begun: float = 0.0
    ended: float = 0.0
    steps: list[dict[str, Any]] = field(default_factory=list)
    error: str = ""
    defect: str = ""
    outcome: dict[str, Any] = field(default_factory=dict)

    def progressed(self, what: str, share: float) -> None:
        """A step's share, added or updated; the detail after a colon belongs to the same step."""
        name, now = what.partition(": ")[0], round(time.time() - self.begun, 3)
        known = next((step for step in reversed(self.steps) if step["name"] == name), None)
        if known is None:
            known = {"name": name, "at": now}
            self.steps.append(known)
        known |= {"text": what, "share": share, "until": now}


class Jobs:
    """All jobs of a folder.

    Args:
        root: the workspace; the process of a job works in it.
        folder: of the records.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self._root, self._folder, self._lock = root, folder, threading.Lock()
        self._process: BaseProcess | None = None
        self._reader: threading.Thread | None = None
        folder.mkdir(parents=True, exist_ok=True)
        self._records = {record.id: record for record in map(_read_record, sorted(folder.glob("*.json"))) if record}
        for record in self._records.values():
            if record.state == JobState.RUNNING:
                record.state, record.ended = JobState.INTERRUPTED, time.time()
                record.error = "The workbench ended while this ran. Nothing of it was published; run it again."
                self._leave(record)
                self._store(record)

    def start(self, kind: str, title: str, command: str, arguments: dict[str, Any]) -> JobRecord:
        """Begin a job.

        Raises:
            WorkbenchError: another one runs.
        """
        with self._lock:
            busy = self.running()
            if busy is not None:
                raise WorkbenchError(
                    f"{busy.title} is running, and one job runs at a time.",
                    where=busy.id,
                    advice="Wait for its end, or cancel it.",
                )
            record = JobRecord(secrets.token_hex(6), kind, title, command, arguments, begun=time.time())
            self._records[record.id] = record
            self._store(record)
            context = multiprocessing.get_context("spawn")
            here, there = context.Pipe(duplex=False)
            from haptid.app.work import run_work

            self._process = context.Process(
                target=run_work, args=(there, str(self._root), kind, arguments), name=f"haptid {kind}", daemon=True
            )
            with interruption_held():
                self._process.start()
            there.close()
            self._reader = threading.Thread(target=self._follow, args=(record, here, self._process), daemon=True)
            self._reader.start()
        return record

    def running(self) -> JobRecord | None:
        """The job that runs."""
        return next((record for record in self._records.values() if record.state == JobState.RUNNING), None)

    def get(self, name: str) -> JobRecord:
        """A job by its number.

        Raises:
            WorkbenchError: there is none.
        """
        if name not in self._records:
            raise WorkbenchError(f"there is no job {name[:40]!r}.", where=name, advice="Open a job from the home page.")
        return self._records[name]

    def recent(self, count: int = 20) -> list[JobRecord]:
        """The latest jobs, the latest first."""
        return sorted(self._records.values(), key=lambda record: -record.begun)[:count]

    def cancel(self, name: str) -> JobRecord:
        """End a job's process; what it had begun to write is removed."""
        record, reader = self.get(name), None
        with self._lock:
            if record.state == JobState.RUNNING:
                record.state = JobState.CANCELLED
                reader = self._reader
                self._end()
        if reader is not None:
            reader.join()
        return record

    def close(self) -> None:
        """Cancel the running job when the server ends."""
        record = self.running()
        if record is not None:
            self.cancel(record.id)

    def _end(self) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.join(_GRACE)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()

    def _follow(self, record: JobRecord, pipe: Connection, process: BaseProcess) -> None:
        """Read the messages of a job's process until it ends."""
        said: dict[str, Any] | None = None
        with suppress(EOFError, OSError):
            while True:
                kind, content = pipe.recv()
                if kind == "progress":
                    record.progressed(*content)
                else:
                    said = content
        pipe.close()
        process.join()
        if record.state == JobState.RUNNING:
            found = said or {"error": f"its process ended with status {process.exitcode}: out of memory, or killed."}
            record.error, record.defect = found.get("error", ""), found.get("defect", "")
            record.outcome = found.get("outcome", {})
            record.state = JobState.FAILED if record.error or record.defect else JobState.DONE
        if record.state != JobState.DONE:
            self._leave(record)
        record.ended = time.time()
        self._store(record)

    def _leave(self, record: JobRecord) -> None:
        """Remove the partial output of a job that did not finish."""
        from haptid._internal.atomic_folder import sweep_beside
        from haptid.observation.cache import RFactorCache

        for name in record.arguments.get("writes", ()):
            path = self._root / name
            sweep_beside(path)
            RFactorCache.beside(path).forget()

    def _store(self, record: JobRecord) -> None:
        write_file(self._folder / f"{record.id}.json", json.dumps(asdict(record), indent=1) + "\n")
        for old in sorted(self._records.values(), key=lambda one: -one.begun)[_KEPT:]:
            del self._records[old.id]
            (self._folder / f"{old.id}.json").unlink(missing_ok=True)


def _read_record(path: Path) -> JobRecord | None:
    """A stored record; None where the file is none."""
    try:
        return JobRecord(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
