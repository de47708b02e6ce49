"""Executor protocol, and the executor of this process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

from haptid._internal.late import dataclass
from haptid.errors import ExecutorError

Item = TypeVar("Item")
Made = TypeVar("Made")


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


def lost_item(item: int, losses: int) -> ExecutorError:
    """Error of an item whose worker was lost each time that it was tried."""
    return ExecutorError(
        f"item {item + 1} of the work was lost {losses} times, each time because its process ended.",
        where=item,
        found=losses,
        advice="The usual cause is too little memory: use fewer workers, or machines with more memory.",
    )
