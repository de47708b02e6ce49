"""`Receiver`: takes frames from a UDP port: recorded first, then handed on.

The port belongs to a process that does nothing else (`relay`), so that no sample is lost while this one computes. It is
one of this machine's own address unless another one is asked for. The first sender is the only one that is heard until
the end: what others send is counted and thrown away.
"""

from __future__ import annotations

import queue
import subprocess
import sys
import threading
from collections.abc import Iterable

from haptid.errors import WorkbenchError
from haptid.live import relay
from haptid.live.frames import FrameError, read_frame
from haptid.live.recorder import Recorder, SampleRun

# Runs that may wait for who analyses them; what is more is recorded, and not analysed.
_QUEUE = 1 << 16


class Receiver:
    """Records what a sender sends until it is closed.

    Args:
        recorder: which takes the frames.
        port: 0 for one that is free.
        address: of this machine, to which the port belongs.

    Attributes:
        port: that was bound.
        runs: what was written, in order, for who analyses it.
        broken: messages that were no frames.
        foreign: messages of other senders than the first.
        skipped: runs that were recorded and did not fit into the queue.
        error: why the recording ended by itself, a sentence; empty where it did not.

    Raises:
        WorkbenchError: the port cannot be used.
    """

    def __init__(self, recorder: Recorder, port: int = 0, address: str = "127.0.0.1") -> None:
        self.recorder, self.runs = recorder, queue.Queue[SampleRun](_QUEUE)
        self.broken = self.foreign = self.skipped = 0
        self.error = ""
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._sender: object = None
        # -S: no packages, which it needs none of; its start takes some hundredths of a second so.
        command = [sys.executable, "-I", "-S", relay.__file__, address, str(port)]
        self._relay = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._relay.stdin is not None
        assert self._relay.stdout is not None
        self._input, self._messages = self._relay.stdin, self._relay.stdout
        said = self._messages.readline().decode("utf-8", "replace").strip()
        if not said.isdigit():
            self._end_relay()
            list(recorder.close())
            raise WorkbenchError(
                f"UDP port {port} of {address} cannot be used: {said.removeprefix('! ') or 'no process begins'}.",
                where=port,
                advice="Give another one, or 0 for any that is free.",
            )
        self.port = int(said)
        self._thread = threading.Thread(target=self._listen, name="haptid frames", daemon=True)
        self._thread.start()

    def take(self, content: bytes, sender: object) -> None:
        """One message of a sender, by UDP or by another way."""
        try:
            frame = read_frame(content)
        except FrameError:
            self.broken += 1
            return
        with self._lock:
            if self._sender is None:
                self._sender = sender
            if sender != self._sender:
                self.foreign += 1
            elif not self._closed.is_set():
                self._hand_on(self.recorder.take(frame))

    def close(self) -> None:
        """End the recording; the file has its name then."""
        self._input.close()  # what has arrived by now still comes
        self._thread.join()
        self._end_relay()
        self._closed.set()
        with self._lock:
            self._hand_on(self.recorder.close())

    def _hand_on(self, runs: Iterable[SampleRun]) -> None:
        for run in runs:
            try:
                self.runs.put_nowait(run)
            except queue.Full:
                self.skipped += 1

    def _listen(self) -> None:
        try:
            while head := self._messages.read(relay.HEAD.size):
                size, *sender = relay.HEAD.unpack(head)
                self.take(self._messages.read(size), tuple(sender))
        except OSError as error:  # the disk is full
            self.error = f"The recording ended: {error.strerror or error}."

    def _end_relay(self) -> None:
        self._input.close()
        self._messages.close()
        self._relay.wait()
