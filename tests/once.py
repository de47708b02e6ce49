"""What several tests need is made once in a test run, by the first worker that asks, and kept for the others."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest


def run_folder(factory: pytest.TempPathFactory) -> Path:
    """Folder of the whole test run, which its workers share."""
    base = factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def made_once(folder: Path, make: Callable[[Path], object]) -> Path:
    """`folder` as `make` fills it, made unless it is there.

    Two workers that begin at the same time both make it, and the first to finish names its own: no lock is left behind
    by a worker that dies.
    """
    if not folder.exists():
        begun = Path(tempfile.mkdtemp(dir=folder.parent))
        make(begun)
        with contextlib.suppress(OSError):
            begun.rename(folder)
        shutil.rmtree(begun, ignore_errors=True)
    return folder
