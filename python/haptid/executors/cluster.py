"""Executor of a Dask cluster; items of a worker that is lost are given to another one."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from typing import Any

from haptid._internal.late import dataclass
from haptid.errors import ExecutorError, MissingDependencyError
from haptid.executors.executor import Item, Made, lost_item

# Timeout of the connection to a cluster, s.
PATIENCE = 30.0


@dataclass(frozen=True)
class DaskExecutor:
    """The workers of a Dask scheduler, on machines that have the same files; `pip install "haptid[cluster]"`.

    Attributes:
        address: of the scheduler, as "tcp://host:8786".
    """

    address: str

    def check(self) -> None:
        """Raise ExecutorError where no scheduler answers, MissingDependencyError without Dask.

        A client of Dask that gets no answer is never closed: it prints a traceback of its own when the program ends,
        and waits for ever where something else listens.
        """
        import asyncio  # slow to import, and few commands have a cluster
        from concurrent.futures import ThreadPoolExecutor

        distributed = _distributed()
        try:
            # A thread of its own: that of a notebook has an event loop that runs.
            with ThreadPoolExecutor(1) as thread:
                role = thread.submit(asyncio.run, _role(distributed, self.address)).result()
        except Exception as error:  # what is read from another program may be anything
            said = str(error) if isinstance(error, OSError | ValueError) else ""
            raise self._no_scheduler(said or "what listens there does not speak Dask's protocol") from error
        if role != "Scheduler":
            raise self._no_scheduler(f"it is the address of a {role}")

    def _no_scheduler(self, why: str) -> ExecutorError:
        return ExecutorError(
            f"no Dask scheduler answers at {self.address or 'an empty address'}: {why}.",
            where=self.address,
            advice="Start one with `dask scheduler`, workers with `dask worker ADDRESS`, and give the "
            "address that the scheduler prints.",
        )

    def map(self, function: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[tuple[int, Made]]:
        self.check()
        distributed = _distributed()
        client = distributed.Client(self.address, timeout=PATIENCE, set_as_default=False)
        with client:
            # Unpickled on the workers, not scattered: it is unpickled again if the worker that had it is lost.
            with warnings.catch_warnings():  # it may be large, but is sent once
                warnings.filterwarnings("ignore", "Sending large graph")
                held = client.submit(pickle.loads, pickle.dumps(function), pure=False)
            running = {client.submit(_call, held, item, pure=False): k for k, item in enumerate(items)}
            for future in distributed.as_completed(list(running), loop=client.loop):
                k = running.pop(future)  # its worker then forgets the result
                try:
                    result = future.result()
                except distributed.KilledWorker as error:
                    raise lost_item(k, error.allowed_failures + 1) from error
                del future
                yield k, result


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise MissingDependencyError(
            "a cluster needs Dask distributed.", where="distributed", advice='pip install "haptid[cluster]".'
        ) from error


async def _role(distributed: Any, address: str) -> str:
    """What answers at an address: "Scheduler", "Worker" or "Nanny"."""
    import asyncio

    security = distributed.Security().get_connection_args("client")
    # What listens and says nothing is left later than what cannot be reached, so that its error is its own.
    there = distributed.rpc(address, timeout=PATIENCE, connection_args=security)
    try:
        return str((await asyncio.wait_for(there.identity(), PATIENCE + 2))["type"])
    finally:
        await there.close_rpc()


def _call(function: Callable[[Item], Made], item: Item) -> Made:
    return function(item)
