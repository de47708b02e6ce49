"""The machine's own limits, measured: multiply-adds in registers, and filling memory, one core."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

SOURCE = Path(__file__).with_name("limits.c")


def limits() -> dict[str, float]:
    """The fastest of some runs; none without a compiler."""
    if shutil.which("gcc") is None:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "limits.so"
        subprocess.run(["gcc", "-O3", "-march=native", "-fPIC", "-shared", str(SOURCE), "-o", str(made)], check=True)
        library = ctypes.CDLL(str(made))
        library.multiply_add_peak.restype = library.fill_speed.restype = ctypes.c_double
        return {
            "multiply-add peak, GF/s": max(library.multiply_add_peak() for _ in range(50)),
            "memory fill, GB/s": max(library.fill_speed() for _ in range(10)),
        }
