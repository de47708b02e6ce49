"""Executors: a function mapped over items in this process, in processes of this machine, or on a Dask cluster.

Items of a worker that is lost are given to another one.
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

from haptid.errors import ExecutorError, MissingDependencyError, SettingError

Item = TypeVar("Item")
Made = TypeVar("Made")

# Workers that may be lost with one item before it counts as the cause.
_LOSSES = 3
# Timeout of the connection to a cluster, s.
PATIENCE = 30.0


class Executor(Protocol):
    """Executor protocol: maps a function over items."""

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        """Index and result of every item, as soon as each is ready, in any order.

        Args:
            function: picklable; it is sent to each worker once.
            items: its arguments.

        Raises:
            ExecutorError: an item was lost with several workers in a row.
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
                for k, item, made, error in crew.gather():
                    if error is not None:
                        raise error
                    if made is None:  # its worker was lost
                        losses[k] += 1
                        if losses[k] == _LOSSES:
                            raise _lost(k, _LOSSES)
                        waiting.appendleft((k, item))
                    else:
                        yield k, made[0]
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
                made, error = cast(Connection, connection).recv()
            except (EOFError, OSError):
                process.join()
                yield k, item, None, None
            else:
                self.idle[cast(Connection, connection)] = process
                yield k, item, made, error

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
        process.start()
        theirs.close()
        return ours, process


def _serve(connection: Connection, function: bytes) -> None:
    """Loop of a worker process: receive an item, send the result, until the pipe is closed.

    It ignores SIGINT, which a terminal sends to every process: the parent decides what an interruption means.
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
    """The workers of a Dask scheduler, on machines that have the same files; `pip install "haptid[cluster]"`.

    Attributes:
        address: of the scheduler, as "tcp://host:8786".
    """

    address: str

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as error:
            raise MissingDependencyError(
                "a cluster needs Dask distributed.", where="distributed", advice='pip install "haptid[cluster]".'
            ) from error
        try:
            client = distributed.Client(self.address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ExecutorError(
                f"no Dask scheduler answers at {self.address}: {error}.",
                where=self.address,
                advice="Start one with `dask scheduler`, workers with `dask worker ADDRESS`, and give the "
                "address that the scheduler prints.",
            ) from error
        with client:
            # Unpickled on the workers, not scattered: it is unpickled again if the worker that had it is lost.
            with warnings.catch_warnings():  # it may be large, but is sent once
                warnings.filterwarnings("ignore", "Sending large graph")
                held = client.submit(pickle.loads, pickle.dumps(function), pure=False)
            running = {client.submit(_call, held, item, pure=False): k for k, item in enumerate(items)}
            for future in distributed.as_completed(list(running), loop=client.loop):
                try:
                    made = future.result()
                except distributed.KilledWorker as error:
                    raise _lost(running[future], error.allowed_failures + 1) from error
                yield running[future], made


def _call(function: Callable[[Item], Made], item: Item) -> Made:
    return function(item)


def _lost(item: int, losses: int) -> ExecutorError:
    return ExecutorError(
        f"item {item + 1} of the work was lost {losses} times, each time because its process ended.",
        where=item,
        found=losses,
        advice="The usual cause is too little memory: use fewer workers, or machines with more memory.",
    )
