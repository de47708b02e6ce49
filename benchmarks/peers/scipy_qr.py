"""SciPy's QR and least squares of a ready W, the torque beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import linalg

from peers.common import ALONE, Case
from stopwatch import Work


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    W = np.asfortranarray(case["W"])
    A, y, p = W[:, :-1], W[:, -1], W.shape[1]
    return {
        "regressor and reduction": Work(
            ALONE, lambda: linalg.qr(W, mode="r", check_finite=False)[0][:p], lambda R: R.T @ R
        ),
        "regressor to solution": Work(ALONE, lambda: linalg.lstsq(A, y, lapack_driver="gelsy", check_finite=False)[0]),
    }
