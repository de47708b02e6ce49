"""File-system calls that fail, or at which the process dies, one after the other."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest import mock

from haptid._internal import atomic_folder

# Functions that change the file system, or open a file.
CALLS = ("mkdir", "rename", "replace", "link", "symlink", "unlink", "rmdir", "fsync", "open", "chmod", "utime")
DIED = 77


class Count:
    """Calls so far; the `at`-th one does `what` first."""

    def __init__(self, at: int, what: Callable[[], None]) -> None:
        self.calls, self.at, self.what = 0, at, what

    def wrapped(self, function: Callable[..., object]) -> Callable[..., object]:
        """The function, counted."""

        def counted(*args: object, **options: object) -> object:
            self.calls += 1
            if self.calls == self.at:
                self.what()
            return function(*args, **options)

        return counted


def full_disk() -> None:
    """A call fails."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def death() -> None:
    """The process is gone, as by kill -9."""
    os._exit(DIED)


@contextmanager
def fault(at: int, what: Callable[[], None], exchange: bool = True) -> Iterator[Count]:
    """File-system calls in this block are counted, and the `at`-th one does `what`.

    Args:
        at: from 1; 0 for none.
        what: `full_disk` or `death`.
        exchange: whether the system can exchange two folders in one step.
    """
    count = Count(at, what)
    with mock.patch.object(io, "open", count.wrapped(io.open)), mock.patch("builtins.open", io.open):
        patches = [mock.patch.object(os, name, count.wrapped(getattr(os, name))) for name in CALLS]
        step = count.wrapped(atomic_folder._exchange) if exchange else lambda *_: False
        patches.append(mock.patch.object(atomic_folder, "_exchange", step))
        for patch in patches:
            patch.start()
        try:
            yield count
        finally:
            for patch in patches:
                patch.stop()


def died(task: Callable[[], object], at: int, exchange: bool = True) -> bool:
    """Whether a copy of this process that carries out a task dies at its `at`-th call; False once there are fewer."""
    child = os.fork()
    if not child:
        try:
            with fault(at, death, exchange):
                task()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == DIED
