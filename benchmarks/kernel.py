"""Regressor and reduction against peers that do the same work, as ratios in one run.

A 7-joint arm with 43 base columns. Agreement of the numbers is checked before any time is taken. Every time is the
fastest of many short runs, and the peers (`peers/`, in an environment of their own) run between ours.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import haptid
from haptid import _core

HERE = Path(__file__).parent
PEERS = HERE.parent / ".venv-bench" / "bin" / "python"
# A regressor of so many samples stays in the second cache; so many are reduced on one thread; and many are shared out.
IN_CACHE, ALONE, SAMPLES = 128, 1984, 8192


def best_of(work: Callable[[], object], times: int = 5) -> float:
    """Seconds of the fastest of a few runs."""
    taken = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
    return min(taken)


def run() -> dict[str, float]:
    """Microseconds per sample, ratios to the peers, and the machine's own limits."""
    arm = Arm()
    arm.check_reduction()
    with tempfile.TemporaryDirectory() as folder:
        theirs = peers(arm, Path(folder))
    ours = {"regressor in cache": arm.regressor(IN_CACHE), "regressor, stored": arm.regressor(SAMPLES)}
    ours |= {"regressor + reduction, one thread": arm.reduction(ALONE), "the same, all threads": arm.reduction(SAMPLES)}
    ours["reduction of a ready W by numpy"] = arm.numpy_reduction(ALONE)
    ratios = {f"{name} / ours": theirs[name] / ours["regressor in cache"] for name in theirs if "/s" not in name}
    ratios["numpy's QR / ours fused"] = (
        ours["reduction of a ready W by numpy"] / ours["regressor + reduction, one thread"]
    )
    operations = {"operations of the fold per sample": arm.fold_operations}
    return {"base columns": float(len(arm.columns)), **ours, **theirs, **ratios, **operations}


class Arm:
    """The arm, its samples and its wanted columns."""

    def __init__(self) -> None:
        device = haptid.read_device("arm7")
        rng = np.random.default_rng(0)
        n = len(device.joints)
        self.device = device
        self.q, (self.qd, self.qdd) = rng.uniform(-2, 2, (n, SAMPLES)), rng.normal(size=(2, n, SAMPLES))
        self.tau = rng.normal(size=(n, SAMPLES))
        self.columns = [c for c in base_columns(device) if c < 10 * n]
        self.core = _core.Mechanism(*haptid.device.mechanism_arguments(device))
        self.reached = np.array(self.core.reach(self.columns))
        # A Householder reflection of p + 1 columns below a triangle takes 2 (p + 1)^2 operations for every row.
        self.fold_operations = float(2 * ((self.reached.sum(axis=1) + 1) ** 2).sum())

    def motion(self, samples: int) -> list[np.ndarray]:
        """The first samples, and no external columns."""
        some = [np.ascontiguousarray(x[:, :samples]) for x in (self.q, self.qd, self.qdd)]
        return [*some, np.zeros((0, samples))]

    def regressor(self, samples: int) -> float:
        """Microseconds per sample, into memory that is there."""
        motion = self.motion(samples)
        out = np.zeros((len(self.tau), len(self.columns), samples))
        return (
            best_of(lambda: self.core.regressor(*motion, self.columns, None, out), 800_000 // samples) / samples * 1e6
        )

    def reduce(self, samples: int) -> list[tuple[list[int], np.ndarray]]:
        """All rows in one block, without filter."""
        some = (np.ascontiguousarray(self.tau[:, :samples]), self.columns, np.ones(1), 1, 0, samples, samples)
        made: list[tuple[list[int], np.ndarray]] = self.core.reduce(
            *self.motion(samples), *some, np.ones((len(self.tau), samples))
        )
        return made

    def reduction(self, samples: int) -> float:
        """Microseconds per sample."""
        return best_of(lambda: self.reduce(samples), 400_000 // samples) / samples * 1e6

    def observation(self, samples: int) -> np.ndarray:
        """W and the torques beside it, as a user would stack them."""
        Y = self.core.regressor(*self.motion(samples), self.columns)
        return np.column_stack([np.concatenate([*Y.transpose(0, 2, 1)]), self.tau[:, :samples].ravel()])

    def numpy_reduction(self, samples: int) -> float:
        """Microseconds per sample of the QR alone."""
        W = self.observation(samples)
        return best_of(lambda: np.linalg.qr(W, mode="r"), 10) / samples * 1e6

    def check_reduction(self) -> None:
        """Our triangles have the inner products of W."""
        wide = [embed(made, len(self.columns)) for made in self.reduce(ALONE)]
        ours = sum(R.T @ R for R in wide)
        R = np.linalg.qr(self.observation(ALONE), mode="r")
        assert np.allclose(ours, R.T @ R, rtol=0, atol=1e-9 * np.abs(ours).max())


def embed(made: tuple[list[int], np.ndarray], columns: int) -> np.ndarray:
    """A motor's triangle over all columns."""
    reached, triangles = made
    wide = np.zeros((len(reached) + 1, columns + 1))
    wide[:, [*reached, columns]] = triangles[0]
    return wide


def peers(arm: Arm, folder: Path) -> dict[str, float]:
    """Microseconds per sample of the peers, once they have been found to agree; nothing where they are not there."""
    if not PEERS.exists():
        return {}
    samples, columns = 1000, np.array(arm.columns)
    rows, chosen = np.nonzero(arm.reached)
    joints = arm.device.joints
    motion = arm.motion(samples)
    np.savez(
        folder / "case.npz",
        parent=[joint.parent for joint in joints],
        rotation=np.round([joint.rotation for joint in joints], 15),
        translation=[joint.translation for joint in joints],
        gravity=arm.device.gravity,
        wanted=np.column_stack([rows, columns[chosen]]),
        **dict(zip(("q", "qd", "qdd"), motion, strict=False)),
    )
    ask(folder, "values")
    ours = arm.core.regressor(*motion, arm.columns)[rows, chosen].T
    for name, theirs in np.load(folder / "values.npz").items():
        disagreement = np.abs(theirs - ours).max() / np.abs(ours).max()
        assert disagreement < 1e-12, (name, disagreement)
    ask(folder, "times")
    times: dict[str, float] = json.loads((folder / "times.json").read_text(encoding="utf-8"))
    return times


def ask(folder: Path, what: str) -> None:
    """Run the peers."""
    subprocess.run([str(PEERS), str(HERE / "peers" / "regressor.py"), str(folder), what], check=True, cwd=folder)


def base_columns(device: haptid.Device) -> list[int]:
    """The core's columns that the base parameters need."""
    S = device.parameters.S[:, list(device.base.kept)]
    return [int(c) for c in np.flatnonzero(S.any(axis=1))]
