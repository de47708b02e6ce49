"""Who does the work of a command, and where an interrupted one goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from haptid._internal.workers import DaskExecutor, Executor, ProcessExecutor, SerialExecutor
from haptid.cli.common import EXIT_INTERRUPTED, complain, err
from haptid.observation.batch import RFactorCache


def workers(count: int, scheduler: str | None) -> Executor:
    """A cluster where there is one, processes where there are to be several."""
    if scheduler is not None:
        return DaskExecutor(scheduler)
    return SerialExecutor() if count == 1 else ProcessExecutor(count)


def resumed(out: Path, fresh: bool, quiet: bool) -> RFactorCache:
    """What an interrupted run has left beside its folder, which is said; nothing where all is to be done anew."""
    target = out.resolve()
    kept = RFactorCache(target.with_name(f".{target.name}.partial"))
    if fresh:
        kept.forget()
    elif not quiet and (parts := kept.count()):
        err.print(f"Going on from an interrupted run: {parts} parts are there, in {kept.folder}. --fresh starts anew.")
    return kept


@contextmanager
def interruptible(kept: RFactorCache) -> Iterator[None]:
    """An interruption as one line that says what is left of the work, and the exit status for it."""
    try:
        yield
    except KeyboardInterrupt:
        parts = kept.count()
        there = f"{parts} parts are in {kept.folder}, and the same command goes on from there"
        complain(f"interrupted: {there if parts else 'nothing is left of it'}.")
        raise typer.Exit(EXIT_INTERRUPTED) from None
