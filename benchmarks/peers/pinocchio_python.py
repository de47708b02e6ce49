"""Pinocchio from Python, a call for each sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from peers.common import IN_CACHE, MANY, STEP, STEPS, TRAJECTORY, Case, base_columns, picked, samples
from stopwatch import Work


def model_of(case: Case) -> pin.Model:
    """The same robot."""
    model = pin.Model()
    model.gravity.linear = case["gravity"]
    for k, parent in enumerate(case["parent"]):
        placement = pin.SE3(case["rotation"][k], case["translation"][k])
        at = model.addJoint(int(parent) + 1, pin.JointModelRZ(), placement, f"joint{k}")
        model.appendBodyToJoint(
            at, pin.Inertia(case["mass"][k], case["com"][k], case["inertia"][k]), pin.SE3.Identity()
        )
    handle = pin.SE3(np.eye(3), case["point"])
    model.addFrame(pin.Frame("handle", int(case["link"]) + 1, handle, pin.FrameType.OP_FRAME))
    return model


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    model = model_of(case)
    data, handle = model.createData(), model.getFrameId("handle")
    q, v, a = samples(case, IN_CACHE, "q", "qd", "qdd")
    Q, V, A, T = samples(case, MANY, "q", "qd", "qdd", "tau")
    n = len(case["parent"])
    W = np.zeros((MANY, n, 10 * n))

    def stored() -> np.ndarray:
        for k in range(MANY):
            W[k] = pin.computeJointTorqueRegressor(model, data, Q[k], V[k], A[k])
        return W

    def mass() -> np.ndarray:
        upper = np.array([pin.crba(model, data, x) for x in Q])
        return np.triu(upper) + np.swapaxes(np.triu(upper, 1), 1, 2)

    def simulated() -> np.ndarray:
        x, rate = Q.copy(), V.copy()
        for k in range(MANY):
            for _ in range(STEPS):
                rate[k] += STEP * pin.aba(model, data, x[k], rate[k], T[k])
                x[k] += STEP * rate[k]
        return np.concatenate([x, rate], axis=1)

    def felt() -> np.ndarray:
        M, J = np.empty((MANY, n, n)), np.empty((MANY, 3, n))
        for k, x in enumerate(Q):
            M[k] = pin.crba(model, data, x)
            J[k] = pin.computeFrameJacobian(model, data, x, handle, pin.LOCAL_WORLD_ALIGNED)[:3]
        M = np.triu(M) + np.swapaxes(np.triu(M, 1), 1, 2)
        return 1.0 / np.linalg.eigvalsh(J @ np.linalg.solve(M, np.swapaxes(J, 1, 2)))

    base = base_columns(case)

    def condition() -> np.ndarray:
        some = range(TRAJECTORY)
        rows = np.concatenate([pin.computeJointTorqueRegressor(model, data, Q[k], V[k], A[k])[:, base] for k in some])
        return np.linalg.cond(rows)

    def cached() -> None:
        for k in range(IN_CACHE):
            pin.computeJointTorqueRegressor(model, data, q[k], v[k], a[k])

    return {
        "regressor in cache": Work(IN_CACHE, cached, lambda _: picked(case, stored()[:IN_CACHE])),
        "regressor, stored": Work(MANY, stored, lambda Y: picked(case, Y)),
        "inverse dynamics": Work(MANY, lambda: [pin.rnea(model, data, Q[k], V[k], A[k]) for k in range(MANY)]),
        "mass matrix": Work(MANY, mass),
        "forward dynamics": Work(MANY, lambda: [pin.aba(model, data, Q[k], V[k], T[k]) for k in range(MANY)]),
        "simulation step": Work(MANY * STEPS, simulated),
        "apparent masses": Work(MANY, felt),
        "condition number of a motion": Work(1, condition),
    }
