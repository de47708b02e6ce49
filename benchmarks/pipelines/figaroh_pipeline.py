"""figaroh's own functions, step by step, as its `BaseIdentification` calls them: W is whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from figaroh.identification.identification_tools import (
    calculate_first_second_order_differentiation,
    low_pass_filter_data,
    relative_stdev,
)
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate
from pyarrow import parquet
from scipy import signal

from pipelines.script import model_of
from pipelines.setting import CUTOFF_HZ, DECIMATION, JOINTS, RATE_HZ

Case = dict[str, np.ndarray]
# Its filter divides the frequency by twice the sampling rate, and Nyquist's is half of that.
SETTINGS = {
    "ts": 1 / RATE_HZ,
    "cut_off_frequency_butterworth": 4 * CUTOFF_HZ,
    "act_idxv": list(range(JOINTS)),
    "is_joint_torques": True,
    "has_actuator_inertia": True,
}
NAMES = {f"column{k}": 0.0 for k in range(11 * JOINTS)}


def pipeline(case: Case) -> tuple[Callable[[Path], dict[str, float]], Callable[[], np.ndarray]]:
    """The work on a log, and the torque of its last model on the other motion."""
    model = model_of(case)
    # Bodies need no mass here; all ten columns of each are made.
    robot, found = SimpleNamespace(model=model, data=model.createData()), np.zeros(11 * JOINTS)

    def work(path: Path) -> dict[str, float]:
        table = parquet.read_table(path, use_threads=False)
        q, tau = (np.column_stack([table[f"{kind}{k + 1}"] for k in range(JOINTS)]) for kind in ("q", "tau"))
        smooth = low_pass_filter_data(q, SETTINGS)
        q, qd, qdd = calculate_first_second_order_differentiation(model, smooth, SETTINGS)
        edge = (len(tau) - len(smooth)) // 2
        tau = tau[edge : edge + len(q)]
        W = build_regressor_basic(robot, q, qd, qdd, SETTINGS)
        left, names = get_index_eliminate(W, NAMES)
        W, y = decimated(build_regressor_reduced(W, left), tau)
        decomposer = QRDecomposer(relative_tolerance=1e-6)
        W_base, _, _, phi = decomposer.double_decomposition(y, W, names)
        assert np.isfinite(relative_stdev(W_base, phi, y)).all()
        base = [names[k] for k in decomposer.get_base_indices()]
        found[:] = 0.0
        found[[list(NAMES).index(name) for name in base]] = phi
        return {}

    def torque() -> np.ndarray:
        W = build_regressor_basic(robot, case["q"].T, case["qd"].T, case["qdd"].T, SETTINGS)
        return (W @ found).reshape(JOINTS, -1)

    return work, torque


def decimated(W: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Column by column and joint by joint, as its class does."""
    samples = len(tau)
    parts = [W[k * samples : (k + 1) * samples] for k in range(JOINTS)]
    kept = [
        np.column_stack([signal.decimate(column, DECIMATION, zero_phase=True) for column in part.T]) for part in parts
    ]
    return np.concatenate(kept), np.concatenate([signal.decimate(y, DECIMATION, zero_phase=True) for y in tau.T])
