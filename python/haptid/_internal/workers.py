"""Where work is done: here, in processes of this machine, or on a Dask cluster. Each maps a function over items.

A worker that is lost costs the items that it had, which another one does again.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, TypeVar, cast

from haptid.errors import ClusterError, DistributedMissingError, WorkerCountError, WorkerLostError

Item = TypeVar("Item")
Made = TypeVar("Made")

# Workers that may be lost over one item before it is taken to be what loses them.
LOSSES = 3
# A cluster that does not answer for so long is not there, s.
PATIENCE = 30.0


class Executor(Protocol):
    """Whoever maps a function over items."""

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        """Index of an item and what was made of it, each as soon as it is there, in any order.

        Args:
            function: of a module, or an object of one that can be called; it goes to each worker once.
            items: what it is called with.

        Raises:
            WorkerLostError: an item was lost with one worker after the other.
            Exception: the first that the function raises.
        """
        ...


@dataclass(frozen=True)
class SerialExecutor:
    """One item after the other, in this process."""

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        for k, item in enumerate(items):
            yield k, function(item)


@dataclass(frozen=True)
class ProcessExecutor:
    """Processes of this machine, each with one thread for linear algebra.

    A program that uses them starts its own work under `if __name__ == "__main__":`, as each process imports it.

    Attributes:
        count: how many; as many as there are processors where None.
    """

    count: int | None = None

    def __post_init__(self) -> None:
        if self.count is not None and self.count < 1:
            raise WorkerCountError(self.count)

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        waiting = deque(enumerate(items))
        losses: Counter[int] = Counter()
        crew = _Crew(function, min(self.count or os.cpu_count() or 1, len(waiting)))
        try:
            while waiting or crew.busy:
                crew.hand_out(waiting)
                for k, item, made, error in crew.gather():
                    if error is not None:
                        raise error
                    if made is None:  # its worker is gone
                        losses[k] += 1
                        if losses[k] == LOSSES:
                            raise WorkerLostError(k, LOSSES)
                        waiting.appendleft((k, item))
                    else:
                        yield k, made[0]
        finally:
            crew.dismiss()


class _Crew:
    """Processes, and which item each of them has."""

    def __init__(self, function: Callable[[Any], Any], count: int) -> None:
        self.context = multiprocessing.get_context("spawn")
        self.function, self.count = pickle.dumps(function), count
        self.idle: dict[Connection, BaseProcess] = {}
        self.busy: dict[Connection, tuple[BaseProcess, int, Any]] = {}

    def hand_out(self, waiting: deque[tuple[int, Any]]) -> None:
        """An item to every process that has none; one that is lost is replaced."""
        while waiting and len(self.busy) < self.count:
            connection, process = self.idle.popitem() if self.idle else self._start()
            k, item = waiting.popleft()
            self.busy[connection] = process, k, item
            try:
                connection.send(item)
            except OSError:  # it is gone, which `gather` finds
                continue

    def gather(self) -> Iterator[tuple[int, Any, tuple[Any] | None, BaseException | None]]:
        """Of every process that has something to say: index, item, what was made, and what was raised."""
        for connection in wait(list(self.busy)):
            process, k, item = self.busy.pop(cast(Connection, connection))
            try:
                made, error = cast(Connection, connection).recv()
            except (EOFError, OSError):
                process.join()
                yield k, item, None, None
            else:
                self.idle[cast(Connection, connection)] = process
                yield k, item, made, error

    def dismiss(self) -> None:
        """End every process: one with nothing to do by itself, one at work at once."""
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
        process.start()
        theirs.close()
        return ours, process


def _serve(connection: Connection, function: bytes) -> None:
    """What a process does: items come, answers go, until nobody asks any more.

    An interruption from the keyboard goes to every process of a terminal: what it means is for the first one to say.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
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


@dataclass(frozen=True)
class DaskExecutor:
    """The workers of a Dask scheduler, in processes anywhere that see the same files; `pip install "haptid[cluster]"`.

    Attributes:
        address: of the scheduler, as "tcp://host:8786".
    """

    address: str

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as error:
            raise DistributedMissingError from error
        try:
            client = distributed.Client(self.address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(self.address, str(error)) from error
        with client:
            # Made on the workers from its bytes, not scattered: it is made again where the worker that had it is lost.
            with warnings.catch_warnings():  # it may be large, and goes once all the same
                warnings.filterwarnings("ignore", "Sending large graph")
                held = client.submit(pickle.loads, pickle.dumps(function), pure=False)
            running = {client.submit(_call, held, item, pure=False): k for k, item in enumerate(items)}
            for future in distributed.as_completed(list(running), loop=client.loop):
                try:
                    made = future.result()
                except distributed.KilledWorker as error:
                    raise WorkerLostError(running[future], error.allowed_failures + 1) from error
                yield running[future], made


def _call(function: Callable[[Item], Made], item: Item) -> Made:
    return function(item)
