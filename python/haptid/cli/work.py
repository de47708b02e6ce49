"""Executors of a command, and resuming of an interrupted run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

import typer

from haptid._internal.kept_parts import KeptParts
from haptid.cli.common import EXIT_INTERRUPTED, complain, err
from haptid.executors import DaskExecutor, Executor, ProcessExecutor, SerialExecutor

Kept = TypeVar("Kept", bound=KeptParts)


def workers(count: int, scheduler: str | None) -> Executor:
    """The executor: a Dask cluster, which must answer, several processes, or serial."""
    if scheduler is not None:
        cluster = DaskExecutor(scheduler)
        cluster.check()  # before logs are read
        return cluster
    return SerialExecutor() if count == 1 else ProcessExecutor(count)


def resumed(kept: Kept, no_resume: bool, quiet: bool) -> Kept:
    """Stored intermediate results of an interrupted run; none where the run is to start again."""
    if no_resume:
        kept.forget()
    elif not quiet and (parts := kept.count()):
        err.print(f"Resuming an interrupted run: {parts} {kept.noun} in {kept.folder}. --no-resume starts again.")
    return kept


@contextmanager
def interruptible(kept: KeptParts) -> Iterator[None]:
    """Report an interruption in one line and exit with its status."""
    try:
        yield
    except KeyboardInterrupt:
        parts = kept.count()
        stored = f"{parts} {kept.noun} are stored in {kept.folder}; the same command resumes from there"
        complain(f"interrupted: {stored if parts else 'nothing is stored'}.")
        raise typer.Exit(EXIT_INTERRUPTED) from None
