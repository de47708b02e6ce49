"""Atomic writing of a folder of results: a run that fails leaves nothing behind and damages nothing."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from haptid.errors import OutputFolderError


@contextmanager
def publishing(out: Path) -> Iterator[Path]:
    """A scratch folder whose files are moved to `out` if the block ends without an error.

    A new folder appears in one step. In an existing one, files of an earlier result are replaced one by one, each
    atomically, and other files are left alone.

    Raises:
        OutputFolderError: nothing can be written there, or a folder has the name of a file to write.
    """
    check_writable(out)
    target = out.resolve()
    try:
        # In the folder itself, or next to it if it does not exist yet: files then move by renaming.
        where = target if target.exists() else target.parent
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=where))
    except OSError as error:
        raise unwritable(out, str(error)) from error
    try:
        yield scratch
        publish(scratch, target)
    except OSError as error:
        raise unwritable(out, str(error)) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def publish(scratch: Path, target: Path) -> None:
    """Move every file of the scratch folder to its place."""
    if not target.exists():
        scratch.chmod(0o777 & ~_mask())
        os.replace(scratch, target)
        return
    moves = [(path, target / path.relative_to(scratch)) for path in sorted(scratch.rglob("*")) if path.is_file()]
    for _, place in moves:  # before any is replaced
        if place.is_dir():
            raise OSError(f"{place} is a folder, a file of that name is to be written")
    for path, place in moves:
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(path, place)


def _mask() -> int:
    """The umask of this process."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def check_writable(out: Path) -> None:
    """Raise OutputFolderError if results could not be written, before any work is done."""
    target = out.resolve()
    if target.exists() and not target.is_dir():
        raise unwritable(out, "it is a file")
    where = target if target.exists() else target.parent
    if not where.is_dir():
        raise unwritable(out, f"its parent folder {where} does not exist")
    if not os.access(where, os.W_OK | os.X_OK):
        raise unwritable(out, f"the folder {where} is not writable")


def unwritable(path: object, why: str) -> OutputFolderError:
    """The error for a folder or file that cannot be written."""
    return OutputFolderError(
        f"cannot write results to {path}: {why}.",
        where=str(path),
        found=why,
        advice="Choose another folder with --out.",
    )
