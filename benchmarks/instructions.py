"""Instructions per sample of the kernels, counted by callgrind: a figure that a loaded machine does not disturb.

The count is the difference between runs of the core's example that repeat the work more and less often, so that what
runs once does not count. It must stay within 5 % of the one kept in `results/`; a change that is meant is recorded by
removing that file first. Valgrind knows AVX2 and nothing wider, so that the figures are those of the AVX2 back end.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
KEPT = Path(__file__).parent / "results" / "instructions.json"
WORKS = ("arm-regressor", "arm-reduce", "arm-filter", "arm-momentum", "loop-regressor", "loop-reduce")
SAMPLES = 2048
FEW, MANY = 2, 6
ALLOWED = 1.05


def run() -> dict[str, float]:
    """Instructions per sample by work; nothing where valgrind is not installed."""
    if shutil.which("valgrind") is None:
        return {}
    build = ["cargo", "build", "--quiet", "--locked", "--release", "-p", "haptid-core", "--example", "kernel"]
    subprocess.run(build, cwd=ROOT, check=True)
    figures = {f"{work}, instructions per sample": per_sample(work) for work in WORKS}
    if KEPT.exists():
        kept = json.loads(KEPT.read_text(encoding="utf-8"))["figures"]
        worse = {name: x for name, x in figures.items() if x > ALLOWED * kept.get(name, x)}
        assert not worse, f"more instructions than are kept in {KEPT.name}: {worse}"
    return figures


def per_sample(work: str) -> float:
    """Instructions of one sample more."""
    return (count(work, MANY) - count(work, FEW)) / (MANY - FEW) / SAMPLES


def count(work: str, repeats: int) -> int:
    """Instructions of a whole run, on one thread."""
    example = ROOT / "target" / "release" / "examples" / "kernel"
    with tempfile.TemporaryDirectory() as folder:
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={folder}/out", str(example)]
        command += [work, str(SAMPLES), str(repeats)]
        environment = os.environ | {"RAYON_NUM_THREADS": "1"}
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    found = re.search(r"refs:\s+([\d,]+)", done.stderr)
    assert found, done.stderr
    return int(found[1].replace(",", ""))
