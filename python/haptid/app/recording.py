"""`Live`: the recording of a session: a port, a file, the last samples for drawing, and their analysis."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haptid.app.workspace import LOGS, WorkbenchFolder, free_name
from haptid.errors import HaptidError, WorkbenchError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from haptid.live import LiveAnalysis, LiveSettings, Receiver, SampleRun
    from haptid.log import Channels

# Samples that are kept for drawing, s, and most of one answer: a slow tab loses what it did not ask for.
_KEPT_S, _ANSWERED_S = 60.0, 12.0
_PATIENCE = 0.1
# Frames in a second of a log that is played: few, so that the system's buffer bridges a busy machine.
_FRAMES_HZ = 100.0


class LiveRecording:
    """One recording: a port, a file, the last samples for drawing, and the analysis in a thread of its own.

    Args:
        path: of the file.
        channels: of the samples.
        analysis: of the samples.
        port: for frames, 0 for a free one.
    """

    def __init__(self, path: Path, channels: Channels, analysis: LiveAnalysis, port: int) -> None:
        import numpy as np

        from haptid.live import Receiver, Recorder
        from haptid.log import units

        self.path, self.channels, self.analysis = path, channels, analysis
        self.names = [*channels.position.channels, *channels.torque.channels]
        self.rate_hz = analysis.settings.rate_hz
        self.error = ""
        unit = units.scale(channels.time_unit, "time")[1]
        columns = [channels.time or "t", *self.names]
        recorder = Recorder(path, self.rate_hz, columns, len(channels.position.channels), time_unit=unit)
        self._ring: NDArray[np.float64] = np.full((max(2, round(_KEPT_S * self.rate_hz)), len(columns)), np.nan)
        self.drawn = 0
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._waiting: queue.SimpleQueue[SampleRun | None] = queue.SimpleQueue()
        self.receiver: Receiver = Receiver(recorder, port)
        self._threads = [threading.Thread(target=each, daemon=True) for each in (self._keep, self._analyse)]
        for thread in self._threads:
            thread.start()
        self._player: threading.Thread | None = None

    def play(self, path: Path) -> None:
        """Send a log to the own port as a controller would, again and again."""
        import numpy as np

        from haptid.live import play
        from haptid.log.file_format import format_of
        from haptid.log.request import Request

        found = format_of(path).columns(path, self.names, Request())
        missing = [name for name in self.names if name not in found]
        if missing:
            raise WorkbenchError(f"{path.name} has no channel {missing[0]!r}.", where=missing[0])
        values = np.column_stack([found[name] for name in self.names]).astype(float)
        many = len(self.channels.position.channels)
        arguments = (values[:, :many], values[:, many:], self.rate_hz, ("127.0.0.1", self.receiver.port))
        settings = {"each": max(1, round(self.rate_hz / _FRAMES_HZ)), "again": True, "stop": self._ended.is_set}
        self._player = threading.Thread(target=play, args=arguments, kwargs=settings, daemon=True)
        self._player.start()

    def close(self) -> None:
        """End everything; the file has its name then."""
        self._ended.set()
        if self._player is not None:
            self._player.join()
        self.receiver.close()
        for thread in self._threads:
            thread.join()

    def since(self, first: int) -> tuple[int, NDArray[np.float64]]:
        """Number of the first sample that is given, and samples from there on, (n, 1 + channels)."""
        with self._lock:
            size = len(self._ring)
            begin = max(first, self.drawn - min(size, round(_ANSWERED_S * self.rate_hz)))
            places = [k % size for k in range(begin, self.drawn)]
            return begin, self._ring[places]

    def to_json(self) -> dict[str, Any]:
        """What the page shows."""
        receiver = self.receiver
        return {
            "path": f"{LOGS}/{self.path.name}",
            "port": receiver.port,
            "rate_hz": self.rate_hz,
            "names": self.names,
            "positions": len(self.channels.position.channels),
            "units": [", ".join(dict.fromkeys(s.each_unit)) for s in (self.channels.position, self.channels.torque)],
            "rows": [self.analysis.model.device.row_labels[k] for k in self.analysis.model.known_rows],
            "counts": asdict(receiver.recorder.counts),
            "broken": receiver.broken,
            "foreign": receiver.foreign,
            "skipped": receiver.skipped,
            "drawn": self.drawn,
            "error": receiver.error or self.error,
            "analysis": self.analysis.to_json(),
        }

    def _keep(self) -> None:
        """Samples for drawing, as they come."""
        import numpy as np

        while not (self._ended.is_set() and self.receiver.runs.empty()):
            with suppress(queue.Empty):
                run = self.receiver.runs.get(timeout=_PATIENCE)
                times = run.t + np.arange(len(run.position)) / self.rate_hz
                rows = np.column_stack([times, run.position, run.torque])
                with self._lock:
                    self._ring[(self.drawn + np.arange(len(rows))) % len(self._ring)] = rows
                    self.drawn += len(rows)
                self._waiting.put(run)
        self._waiting.put(None)

    def _analyse(self) -> None:
        """What the samples say; a run that continues the last is taken together with it."""
        import numpy as np

        from haptid.live import SampleRun

        over = False
        while not over:
            runs = [self._waiting.get()]
            while not self._waiting.empty():
                runs.append(self._waiting.get())
            over = runs[-1] is None
            parts: list[list[SampleRun]] = []
            for run in runs:
                if run is not None and (run.gap or not parts):
                    parts.append([run])
                elif run is not None:
                    parts[-1].append(run)
            for part in parts:
                q, tau = (np.concatenate([getattr(run, name) for run in part]) for name in ("position", "torque"))
                try:
                    self.analysis.take(SampleRun(part[0].t, part[0].gap, q, tau))
                except HaptidError as error:  # the samples are no motion of this device: recorded all the same
                    self.error = str(error)


class Live:
    """The recording of a session, if there is one.

    Args:
        space: the folder.
        changed: told when there is a new file.
    """

    def __init__(self, space: WorkbenchFolder, changed: Callable[[], None]) -> None:
        self._space, self._changed, self._lock = space, changed, threading.Lock()
        self.recording: LiveRecording | None = None

    def start(self, study: Path, name: str, settings: LiveSettings, port: int, source: Path | None) -> dict[str, Any]:
        """Begin a recording.

        Args:
            study: which says what the channels are.
            name: of the new log.
            settings: of the analysis.
            port: for frames, 0 for a free one.
            source: a log that is played in place of a controller.

        Raises:
            WorkbenchError: one runs already, or the log cannot be played.
            HaptidError: the study cannot be used.
        """
        from haptid.live import analysed_study, recover
        from haptid.live.analysis import study_channels
        from haptid.study import read_study

        with self._lock:
            if self.recording is not None:
                raise WorkbenchError("a recording runs already.", advice="End it first.")
            read = read_study(study)
            analysis = analysed_study(read, settings)
            folder = self._space.folder / LOGS
            folder.mkdir(exist_ok=True)
            recover(folder)
            made = LiveRecording(free_name(folder, name), study_channels(read), analysis, port)
            self.recording = made
        if source is not None:
            try:
                made.play(source)
            except HaptidError:
                self.stop()
                raise
        return made.to_json()

    def stop(self) -> dict[str, Any]:
        """End the recording; what it was at the end."""
        with self._lock:
            made, self.recording = self.recording, None
        if made is None:
            raise WorkbenchError("no recording runs.")
        made.close()
        self._changed()
        return made.to_json() | {"ended": True}

    def running(self) -> LiveRecording:
        """The recording.

        Raises:
            WorkbenchError: there is none.
        """
        if self.recording is None:
            raise WorkbenchError("no recording runs.", advice="Begin one on the page Live.")
        return self.recording

    def close(self) -> None:
        """End what runs, at the end of the server."""
        if self.recording is not None:
            self.stop()
