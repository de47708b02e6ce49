"""figaroh's own regressor of a whole motion, and the condition number of its base columns."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from figaroh.tools.qrdecomposition import cond_num
from figaroh.tools.regressor import build_regressor_basic

from peers.common import MANY, TRAJECTORY, Case, place, samples
from peers.pinocchio_python import model_of
from stopwatch import Work


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    model, (rows, columns) = model_of(case), place(case)
    robot, n = SimpleNamespace(model=model, data=model.createData()), len(case["parent"])
    settings = {"act_idxv": list(range(n)), "is_joint_torques": True}
    q, v, a = samples(case, MANY, "q", "qd", "qdd")
    base = np.unique(columns)

    def regressor(count: int) -> np.ndarray:
        return build_regressor_basic(robot, q[:count], v[:count], a[:count], settings)

    return {
        "regressor, stored": Work(MANY, lambda: regressor(MANY), lambda W: W.reshape(n, MANY, -1)[rows, :, columns].T),
        "condition number of a motion": Work(1, lambda: cond_num(regressor(TRAJECTORY)[:, base])),
    }
