"""A good script with Pinocchio and SciPy: in chunks, so that W is never whole.

Positions are filtered both ways and differentiated; W of every sample, with a column for each rotor, passes one filter
with the torque; chunks are folded into one triangle. Base columns come from its pivots, intervals from its inverse.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
from pyarrow import parquet
from scipy import linalg, signal

from pipelines.setting import CUTOFF_HZ, DECIMATION, JOINTS, RATE_HZ

CHUNK, WIDTH = 20_000, 11 * JOINTS
# Of the largest pivot: below, it is rounding and noise.
RANK = 1e-6
Case = dict[str, np.ndarray]


def model_of(case: Case) -> pin.Model:
    """The same robot."""
    model = pin.Model()
    model.gravity.linear = case["gravity"]
    for k, parent in enumerate(case["parent"]):
        placement = pin.SE3(case["rotation"][k], case["translation"][k])
        model.addJoint(int(parent) + 1, pin.JointModelRZ(), placement, f"joint{k}")
    return model


def pipeline(case: Case) -> tuple[Callable[[Path], dict[str, float]], Callable[[], np.ndarray]]:
    """The work on a log, and the torque of its last model on the other motion."""
    model = model_of(case)
    data, found = model.createData(), np.zeros(WIDTH)

    def rows(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        W = np.zeros((len(q), JOINTS, WIDTH))
        for k in range(len(q)):
            W[k, :, : 10 * JOINTS] = pin.computeJointTorqueRegressor(model, data, q[k], qd[k], qdd[k])
        joints = np.arange(JOINTS)
        W[:, joints, 10 * JOINTS + joints] = qdd
        return W

    def work(path: Path) -> dict[str, float]:
        table = parquet.read_table(path, use_threads=False)
        q, tau = (np.column_stack([table[f"{kind}{k + 1}"] for k in range(JOINTS)]) for kind in ("q", "tau"))
        q = signal.filtfilt(*signal.butter(4, CUTOFF_HZ, fs=RATE_HZ), q, axis=0)
        qd = np.gradient(q, 1 / RATE_HZ, axis=0)
        qdd = np.gradient(qd, 1 / RATE_HZ, axis=0)
        R, count = np.zeros((0, WIDTH + 1)), 0
        for start in range(0, len(q), CHUNK):
            now = slice(start, start + CHUNK)
            y = np.concatenate([rows(q[now], qd[now], qdd[now]), tau[now, :, None]], axis=2)
            kept = signal.decimate(y, DECIMATION, ftype="fir", axis=0).reshape(-1, WIDTH + 1)
            R = linalg.qr(np.concatenate([R, kept]), mode="r")[0][: WIDTH + 1]
            count += len(kept)
        beta, se, base = solved(R, count)
        assert np.isfinite(se).all()
        found[:] = 0.0
        found[base] = beta
        return {}

    return work, lambda: (rows(case["q"].T, case["qd"].T, case["qdd"].T) @ found).T


def solved(R: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Base parameters, their deviations, and which columns they stand for."""
    Q, T, order = linalg.qr(R[:, :-1], pivoting=True)
    rank = int((np.abs(np.diag(T)) > RANK * np.abs(T[0, 0])).sum())
    z, inverse = Q.T @ R[:, -1], linalg.solve_triangular(T[:rank, :rank], np.eye(rank))
    noise = np.linalg.norm(z[rank:]) / np.sqrt(count - rank)
    return inverse @ z[:rank], noise * np.linalg.norm(inverse, axis=1), order[:rank]
