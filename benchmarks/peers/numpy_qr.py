"""NumPy's QR and least squares of a ready W, the torque beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from peers.common import ALONE, Case
from stopwatch import Work


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    W = case["W"]
    A, y = np.ascontiguousarray(W[:, :-1]), np.ascontiguousarray(W[:, -1])
    return {
        "regressor and reduction": Work(ALONE, lambda: np.linalg.qr(W, mode="r"), lambda R: R.T @ R),
        "regressor to solution": Work(ALONE, lambda: np.linalg.lstsq(A, y)[0]),
    }
