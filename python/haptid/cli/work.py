"""Executors of a command, and resuming of an interrupted run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from haptid.cli.common import EXIT_INTERRUPTED, complain, err
from haptid.executors import DaskExecutor, Executor, ProcessExecutor, SerialExecutor
from haptid.observation.cache import RFactorCache, partial_of


def workers(count: int, scheduler: str | None) -> Executor:
    """The executor: a Dask cluster, several processes, or serial."""
    if scheduler is not None:
        return DaskExecutor(scheduler)
    return SerialExecutor() if count == 1 else ProcessExecutor(count)


def resumed(out: Path, no_resume: bool, quiet: bool) -> RFactorCache:
    """Stored intermediate results of an interrupted run; none where the run is to start again."""
    cache = partial_of(out)
    if no_resume:
        cache.forget()
    elif not quiet and (parts := cache.count()):
        err.print(f"Resuming an interrupted run: {parts} parts in {cache.folder}. --no-resume starts again.")
    return cache


@contextmanager
def interruptible(cache: RFactorCache) -> Iterator[None]:
    """Report an interruption in one line and exit with its status."""
    try:
        yield
    except KeyboardInterrupt:
        parts = cache.count()
        stored = f"{parts} parts are stored in {cache.folder}; the same command resumes from there"
        complain(f"interrupted: {stored if parts else 'nothing is stored'}.")
        raise typer.Exit(EXIT_INTERRUPTED) from None
