"""Executor of a Dask cluster; items of a worker that is lost are given to another one."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

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
                k = running.pop(future)  # its worker then forgets the result
                try:
                    result = future.result()
                except distributed.KilledWorker as error:
                    raise lost_item(k, error.allowed_failures + 1) from error
                del future
                yield k, result


def _call(function: Callable[[Item], Made], item: Item) -> Made:
    return function(item)
