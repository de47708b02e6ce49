"""Comparison with other packages on the same robot and samples: first agreement of the values, then times."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from run_peer import LEFT_OUT
from stopwatch import Work

HERE = Path(__file__).parent
PYTHON = HERE.parent / ".venv-bench" / "bin" / "python"
# What each is called, and its file in `peers/`.
PEERS = {
    "Pinocchio C++": "pinocchio_cpp",
    "Pinocchio Python": "pinocchio_python",
    "CasADi C": "casadi_c",
    "iDynTree": "idyntree_python",
    "MuJoCo": "mujoco_python",
    "figaroh": "figaroh_python",
    "NumPy": "numpy_qr",
    "NumPy by blocks": "numpy_blocks",
    "SciPy": "scipy_qr",
}
# A peer that takes longer than this, s, is left out.
LIMIT = {"values": 120.0, "times": 60.0}
# Largest disagreement with ours that is rounding, relative to the largest value.
ROUNDING = 1e-9


def compared(case: Mapping[str, object], ours: Mapping[str, Work], peers: Sequence[str]) -> dict[str, float]:
    """Microseconds per sample of haptid and of every installed peer, disagreement of values, ratios of times."""
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(folder / "case.npz", **case)
        values = {work: one.values() for work, one in ours.items()}
        there = [peer for peer in peers if run_peer(folder, peer, "values", ours)]
        for peer in there:
            figures |= disagreement(peer, values, dict(np.load(folder / f"{PEERS[peer]}.npz")))
        counts = folder / "counts.json"
        figures |= json.loads(counts.read_text(encoding="utf-8")) if counts.exists() else {}
        times = {work: one.microseconds() for work, one in ours.items()}
        figures |= {f"{work}: haptid, us": time for work, time in times.items()}
        for peer in there:
            if run_peer(folder, peer, "times", ours):
                found = json.loads((folder / f"{PEERS[peer]}.json").read_text(encoding="utf-8"))
                figures |= {f"{work}: {peer}, us": time for work, time in found.items()}
                figures |= {f"{work}: {peer} over haptid": time / times[work] for work, time in found.items()}
    return figures


def disagreement(peer: str, ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> dict[str, float]:
    """Largest difference of each task relative to its largest value; an error above rounding."""
    found = {}
    for work, values in theirs.items():
        assert values.shape == ours[work].shape, (peer, work, values.shape, ours[work].shape)
        found[work] = float(np.abs(values - ours[work]).max() / np.abs(ours[work]).max())
        assert found[work] < ROUNDING, f"{peer} disagrees on {work}: {found[work]:.2e}"
    return {f"{work}: {peer}, disagreement": x for work, x in found.items()}


def run_peer(folder: Path, peer: str, what: str, works: Mapping[str, Work]) -> bool:
    """Run a peer; false, and why on standard error, where it is not there or takes too long."""
    call = [str(PYTHON), str(HERE / "run_peer.py"), str(folder), PEERS[peer], what, *works]
    try:
        done = subprocess.run(call, cwd=folder, timeout=LIMIT[what], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return left_out(peer, "there is no environment of peers: see `make bench`")
    except subprocess.TimeoutExpired:
        return left_out(peer, f"{what} took over {LIMIT[what]:.0f} s")
    if done.returncode == LEFT_OUT:
        return left_out(peer, done.stderr.strip())
    assert done.returncode == 0, done.stderr
    return True


def left_out(peer: str, why: str) -> bool:
    """Say so; false."""
    print(f"{peer} is left out: {why}", file=sys.stderr)
    return False


def alone(program: str, threads: int) -> dict[str, float]:
    """What a benchmark prints as JSON in a process of its own with so many threads; linear algebra has one."""
    environment = {**os.environ, **one_thread(), "RAYON_NUM_THREADS": str(threads)}
    done = subprocess.run([sys.executable, program], stdout=subprocess.PIPE, text=True, check=True, env=environment)
    return dict(json.loads(done.stdout))


def one_thread() -> dict[str, str]:
    """Environment of a process that has one thread."""
    return dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"), "1")
