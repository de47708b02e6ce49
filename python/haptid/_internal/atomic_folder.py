"""Writing a folder of results so that a run that fails leaves nothing behind and damages nothing."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from haptid.errors import OutputError


@contextmanager
def publishing(out: Path) -> Iterator[Path]:
    """A scratch folder whose files appear in `out` when, and only when, the block ends without an error.

    A new folder appears whole, in one step. In one that is there, files of an earlier result are replaced one by one,
    each in a single step, and other files are left alone.

    Raises:
        OutputError: nothing can be written there, or a folder stands where a file must go.
    """
    check_writable(out)
    target = out.resolve()
    try:
        # In the folder itself, or beside it while it is not there: files then move by renaming.
        where = target if target.exists() else target.parent
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=where))
    except OSError as error:
        raise OutputError(out, str(error)) from error
    try:
        yield scratch
        publish(scratch, target)
    except OSError as error:
        raise OutputError(out, str(error)) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def publish(scratch: Path, target: Path) -> None:
    """Move every file of the scratch folder to its place."""
    if not target.exists():
        scratch.chmod(0o777 & ~_mask())
        os.replace(scratch, target)
        return
    moves = [(path, target / path.relative_to(scratch)) for path in sorted(scratch.rglob("*")) if path.is_file()]
    for _, place in moves:  # before the first is replaced
        if place.is_dir():
            raise OSError(f"{place} is a folder, and a file must go there")
    for path, place in moves:
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(path, place)


def _mask() -> int:
    """The permissions that new files do not get."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def check_writable(out: Path) -> None:
    """Raise OutputError where results could not be written, before any work is done."""
    target = out.resolve()
    if target.exists() and not target.is_dir():
        raise OutputError(out, "it is a file")
    where = target if target.exists() else target.parent
    if not where.is_dir():
        raise OutputError(out, f"its parent folder {where} does not exist")
    if not os.access(where, os.W_OK | os.X_OK):
        raise OutputError(out, f"the folder {where} is not writable")
