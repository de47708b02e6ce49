"""The inverse dynamic model from base parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptid._values import Array, expect
from haptid.device import Device
from haptid.signals import external


def inverse_dynamics(device: Device, beta: ArrayLike, qa: Array, qda: Array, qdda: Array) -> Array:
    """Torque of every row (motor or joint, as the device says), at the joint side, (rows, samples), N m or N.

    Args:
        device: the mechanism.
        beta: its base parameters, (p,), SI.
        qa: positions of the active joints, (active, samples), rad or m.
        qda: their velocities.
        qdda: their accelerations.

    Raises:
        ShapeError: an array does not fit the device.
    """
    beta, qa = np.asarray(beta, dtype=float), np.asarray(qa, dtype=float)
    expect("beta", beta.shape, (len(device.base),))
    for name, array in (("qa", qa), ("qda", qda), ("qdda", qdda)):
        expect(name, np.shape(array), (len(device.active), qa.shape[1]))
    c, cd, cdd = (np.ascontiguousarray(device.frame @ x) for x in (qa, qda, qdda))
    S = device.parameters.S[:, list(device.base.kept)]
    columns = [int(k) for k in np.flatnonzero(S.any(axis=1))]
    chi = (S @ beta)[columns]
    return np.asarray(device.mechanism.torque(c, cd, cdd, external(device, c, cd, cdd), columns, chi.tolist()))
