"""How long the command line takes to say its help, and Python to have the package; peers' packages beside it.

Wall time of the fastest of ten processes each, of three for a peer's package; the files have been read before.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from compare_peers import PYTHON, left_out
from stopwatch import fastest

RUNS, FEW = 10, 3
PACKAGES = ("pinocchio", "mujoco", "casadi", "idyntree.bindings", "figaroh")


def run() -> dict[str, float]:
    """Seconds."""

    def seconds(*call: str, runs: int = RUNS) -> float:
        return fastest(lambda: subprocess.run(call, check=True, capture_output=True), 0.0, runs, time.perf_counter)

    figures = {
        "haptid --help, s": seconds(str(Path(sys.executable).with_name("haptid")), "--help"),
        "python without any import, s": seconds(sys.executable, "-c", ""),
        "import haptid, s": seconds(sys.executable, "-c", "import haptid"),
    }
    for package in PACKAGES:
        try:
            figures[f"import {package}, s"] = seconds(str(PYTHON), "-c", f"import {package}", runs=FEW)
        except (FileNotFoundError, subprocess.CalledProcessError):
            left_out(package, "it is not installed")
    return figures
