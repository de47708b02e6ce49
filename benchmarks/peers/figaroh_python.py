"""figaroh's own regressor of a whole motion, and the condition number of its base columns."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from figaroh.tools.qrdecomposition import cond_num
from figaroh.tools.regressor import build_regressor_basic

from peers.common import MANY, TRAJECTORY, Case, base_columns, picked, samples
from peers.pinocchio_python import model_of
from stopwatch import Work


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    model = model_of(case)
    robot, n = SimpleNamespace(model=model, data=model.createData()), len(case["parent"])
    settings = {"act_idxv": list(range(n)), "is_joint_torques": True}
    q, v, a = samples(case, MANY, "q", "qd", "qdd")
    base = base_columns(case)

    def regressor(count: int) -> np.ndarray:
        return build_regressor_basic(robot, q[:count], v[:count], a[:count], settings)

    def shaped(W: np.ndarray) -> np.ndarray:
        return picked(case, np.swapaxes(W.reshape(n, MANY, -1), 0, 1))

    return {
        "regressor, stored": Work(MANY, lambda: regressor(MANY), shaped),
        "condition number of a motion": Work(1, lambda: cond_num(regressor(TRAJECTORY)[:, base])),
    }
