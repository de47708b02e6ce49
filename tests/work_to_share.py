"""Functions that other processes call. They import nothing that takes long, as each process imports it anew."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from haptid import errors


def doubled(item: int) -> int:
    return 2 * item


def counted(item: tuple[Path, int]) -> int:
    """Says in a file that it was called."""
    folder, k = item
    (folder / f"{k}-{os.getpid()}").touch()
    return k


def killed_once(item: tuple[Path, int]) -> int:
    """The process that first has item 2 is killed in the middle of it."""
    folder, k = item
    if k == 2 and not (folder / "killed").exists():
        (folder / "killed").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return counted(item)


def always_killed(item: int) -> int:
    if item == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def refused(item: int) -> int:
    raise errors.LogMismatchError("the channels do not fit.", where="position", found=item, limit=2, notes=["a note"])
