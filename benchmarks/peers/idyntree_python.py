"""iDynTree from Python, a call for each sample; its regressor also has the six rows of the base."""

from __future__ import annotations

from pathlib import Path

import idyntree.bindings as idyn
import numpy as np

from peers.common import IN_CACHE, MANY, Case, picked, samples, urdf
from stopwatch import Work

# Order of its ten parameters, m mx my mz Ixx Ixy Ixz Iyy Iyz Izz, from XX XY XZ YY YZ ZZ MX MY MZ M.
ORDER = np.array([4, 5, 6, 7, 8, 9, 1, 2, 3, 0])
BASE = 6


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    loader = idyn.ModelLoader()
    assert loader.loadModelFromString(urdf(case), "urdf")
    model, robot, n = loader.model(), idyn.KinDynComputations(), len(case["parent"])
    assert robot.loadRobotModel(model)
    links = [model.getLinkIndex(f"link{k}") for k in range(n)]
    joints = [model.getJoint(model.getJointIndex(f"joint{k}")).getDOFsOffset() for k in range(n)]
    assert joints == list(range(n)), "joints in the same order"
    gravity, still = case["gravity"], np.zeros(BASE)
    q, v, a = samples(case, MANY, "q", "qd", "qdd")
    Y = idyn.MatrixDynSize(BASE + n, 10 * model.getNrOfLinks())
    M = idyn.MatrixDynSize(BASE + n, BASE + n)
    none, torque = idyn.LinkWrenches(model), idyn.FreeFloatingGeneralizedTorques(model)
    none.zero()
    columns = (np.array(links)[:, None] * 10 + np.arange(10)).ravel()

    def regressor(k: int) -> None:
        robot.setRobotState(q[k], v[k], gravity)
        robot.inverseDynamicsInertialParametersRegressor(still, a[k], Y)

    def chosen(_: object) -> np.ndarray:
        made = np.empty((IN_CACHE, n, 10 * n))
        for k in range(IN_CACHE):
            regressor(k)
            made[k] = Y.toNumPy()[BASE:, columns]
        return picked(case, made, ORDER)

    def inverse() -> np.ndarray:
        made = np.empty((MANY, n))
        for k in range(MANY):
            robot.setRobotState(q[k], v[k], gravity)
            robot.inverseDynamics(still, a[k], none, torque)
            made[k] = torque.jointTorques().toNumPy()
        return made

    def mass() -> np.ndarray:
        made = np.empty((MANY, n, n))
        for k in range(MANY):
            robot.setRobotState(q[k], v[k], gravity)
            robot.getFreeFloatingMassMatrix(M)
            made[k] = M.toNumPy()[BASE:, BASE:]
        return made

    return {
        "regressor in cache": Work(IN_CACHE, lambda: [regressor(k) for k in range(IN_CACHE)], chosen),
        "inverse dynamics": Work(MANY, inverse),
        "mass matrix": Work(MANY, mass),
    }
