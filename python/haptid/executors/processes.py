"""Executor of processes of this machine; items of a process that is lost are given to another one."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, cast

from haptid._internal.interruption import interruption_held
from haptid._internal.late import dataclass
from haptid.errors import SettingError
from haptid.executors.executor import Item, Made, lost_item

# Processes that may be lost with one item before it counts as the cause.
_LOSSES = 3


@dataclass(frozen=True)
class ProcessExecutor:
    """Processes of this machine, each with one thread for linear algebra.

    The calling program must guard its own work by `if __name__ == "__main__":`, as each process imports it.

    Attributes:
        count: number of processes; None: one for each processor.
    """

    count: int | None = None

    def __post_init__(self) -> None:
        if self.count is not None and self.count < 1:
            raise SettingError(
                f"count is {self.count}.", where="count", found=self.count, limit=1, advice="Write 1 worker or more."
            )

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        waiting = deque(enumerate(items))
        losses: Counter[int] = Counter()
        crew = _Crew(function, min(self.count or os.cpu_count() or 1, len(waiting)))
        try:
            while waiting or crew.busy:
                crew.hand_out(waiting)
                for k, item, result, error in crew.gather():
                    if error is not None:
                        raise error
                    if result is not None:
                        yield k, result[0]
                        continue
                    losses[k] += 1  # its worker was lost
                    if losses[k] == _LOSSES:
                        raise lost_item(k, _LOSSES)
                    waiting.appendleft((k, item))
        finally:
            crew.dismiss()


class _Crew:
    """Processes, and the item that each of them has."""

    def __init__(self, function: Callable[[Any], Any], count: int) -> None:
        self.context = multiprocessing.get_context("spawn")
        self.function, self.count = pickle.dumps(function), count
        self.idle: dict[Connection, BaseProcess] = {}
        self.busy: dict[Connection, tuple[BaseProcess, int, Any]] = {}

    def hand_out(self, waiting: deque[tuple[int, Any]]) -> None:
        """Send an item to every idle process; lost ones are replaced."""
        while waiting and len(self.busy) < self.count:
            connection, process = self.idle.popitem() if self.idle else self._start()
            k, item = waiting.popleft()
            self.busy[connection] = process, k, item
            try:
                connection.send(item)
            except OSError:  # the process was lost, which `gather` finds
                continue

    def gather(self) -> Iterator[tuple[int, Any, tuple[Any] | None, BaseException | None]]:
        """Index, item, result and exception of every process that has finished its item."""
        for connection in wait(list(self.busy)):
            process, k, item = self.busy.pop(cast(Connection, connection))
            try:
                result, error = cast(Connection, connection).recv()
            except (EOFError, OSError):
                process.join()
                yield k, item, None, None
            else:
                self.idle[cast(Connection, connection)] = process
                yield k, item, result, error

    def dismiss(self) -> None:
        """End every process: idle ones by closing their pipe, busy ones by terminating them."""
        for connection, (process, _, _) in self.busy.items():
            process.terminate()
            connection.close()
        for connection in self.idle:
            connection.close()
        for process in (*self.idle.values(), *(process for process, _, _ in self.busy.values())):
            process.join()

    def _start(self) -> tuple[Connection, BaseProcess]:
        ours, theirs = self.context.Pipe()
        process = self.context.Process(target=_serve, args=(theirs, self.function), daemon=True)
        with interruption_held():
            process.start()
        theirs.close()
        return ours, process


def _serve(connection: Connection, function: bytes) -> None:
    """Loop of a worker process: receive an item, send the result, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where it could not be held back
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
        os.environ[name] = "1"
    call = pickle.loads(function)
    while True:
        try:
            item = connection.recv()
        except EOFError:
            return
        answer: tuple[tuple[Any] | None, Exception | None]
        try:
            answer = (call(item),), None
        except Exception as error:
            answer = None, error
        connection.send(answer)
