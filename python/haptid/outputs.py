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

    The scratch folder is made beside `out`, so that files move by renaming. Files of an earlier result are replaced
    one by one, each in a single step; other files in `out` are left alone.

    Raises:
        OutputError: `out` is a file, or nothing can be written beside it.
    """
    check_writable(out)
    scratch = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        yield scratch
        made = sorted(path for path in scratch.rglob("*") if path.is_file())
        for path in made:
            target = out / path.relative_to(scratch)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, target)
    except OSError as error:
        raise OutputError(out, str(error)) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def check_writable(out: Path) -> None:
    """Raise OutputError where results could not be written, before any work is done."""
    if out.exists() and not out.is_dir():
        raise OutputError(out, "it is a file")
    parent = out.parent
    if not parent.is_dir():
        raise OutputError(out, f"its parent folder {parent} does not exist")
    if not os.access(out if out.exists() else parent, os.W_OK):
        raise OutputError(out, "the folder is not writable")
