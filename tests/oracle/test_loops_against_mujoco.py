"""Closed chains against MuJoCo, exactly: its mass matrix, forces and Jacobians of the pins, with rigid pins.

Its own solver lets pins give way a little. Here its tree's quantities go into the equations of a mechanism with pins
that do not, M qdd + h = f + A'u + J'l and J qdd + dJ/dt qd = 0, and those are solved for forces or accelerations.
"""

import sys
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest

import haptid
from closed_devices import bodies as light
from haptid.experiment.bench import mjcf
from haptid.experiment.bench.mjcf import cut_sites, depth_first
from true_parameters import true_parameters

NAMES = ("four_bar", "slider_crank", "five_bar", "delta", "cea_medical_branch", "phantom_premium_15")
# Differences are rounding, of this share of the largest figure compared.
TIGHT = 1e-9
STATES = 20


@dataclass
class Tree:
    """MuJoCo's quantities of one state: mass matrix, forces, Jacobian of the pins and its rate, motors' directions."""

    M: np.ndarray
    bias: np.ndarray
    passive: np.ndarray
    J: np.ndarray
    Jd: np.ndarray
    A: np.ndarray

    def basis(self, active):
        """Rates of all joints by those of the active ones, (joints, active), as the pins allow them."""
        _, s, Vt = np.linalg.svd(self.J)
        rank = int((s > 1e-9 * s[0]).sum())
        assert rank == len(self.M) - len(active)  # the pins leave the active joints free
        N = Vt[rank:].T
        return N @ np.linalg.inv(N[active])

    def still(self, qd, active):
        """Accelerations of all joints where those of the active ones are zero."""
        rest = np.setdiff1d(np.arange(len(self.M)), active)
        qdd = np.zeros(len(self.M))
        qdd[rest] = np.linalg.lstsq(self.J[:, rest], -self.Jd @ qd, rcond=1e-12)[0]
        close(self.J @ qdd, -self.Jd @ qd, np.abs(self.Jd).max() * np.abs(qd).max())
        return qdd


def tree_of(model, mj_model, data, q, qd):
    """MuJoCo at one state on the loop, its joints in its own order."""
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, qd, 0.0
    mujoco.mj_forward(mj_model, data)
    M = np.zeros((mj_model.nv, mj_model.nv))
    mujoco.mj_fullM(mj_model, data, M)
    kinds, rows = data.efc_type, data.efc_J.reshape(-1, mj_model.nv)
    dry = np.isin(kinds, (mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF, mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON))
    friction = -(rows[dry].T * data.efc_frictionloss[dry]) @ np.sign(rows[dry] @ qd)
    constant = data.qfrc_actuator.copy()
    J = rows[kinds == mujoco.mjtConstraint.mjCNSTR_EQUALITY].copy()
    A = np.empty((mj_model.nv, len(model.device.motors)))
    for k in range(len(model.device.motors)):
        data.ctrl[:] = 0.0
        data.ctrl[k] = 1.0
        mujoco.mj_fwdActuation(mj_model, data)
        A[:, k] = data.qfrc_actuator - constant
    return Tree(
        M, data.qfrc_bias.copy(), data.qfrc_passive + friction + constant, J, rates(model, mj_model, data, J), A
    )


def rates(model, mj_model, data, J):
    """How the Jacobian of the pins changes, by MuJoCo's derivative of a point's Jacobian; that of relations stays."""
    found = np.zeros_like(J)
    for k, pair in enumerate(cut_sites(model)):
        for name, sign in zip(pair, (1.0, -1.0), strict=True):
            site, moved = mj_model.site(name), np.zeros((3, mj_model.nv))
            mujoco.mj_jacDot(mj_model, data, moved, None, data.site(name).xpos, int(site.bodyid[0]))
            found[3 * k : 3 * k + 3] += sign * moved
    return found


def weights(model):
    """True parameters with bodies and friction, (p,)."""
    if model.device.name.startswith(("PHANToM", "CEA")):
        return true_parameters(model)
    return light(model)


@pytest.fixture(scope="module", params=NAMES)
def compared(request):
    """A device, its parameters, states on its loops, and MuJoCo's quantities there."""
    model = haptid.DynamicModel(haptid.read_device(request.param))
    chi, rng = weights(model), np.random.default_rng(7)
    qa = model.device.closure.draw(rng, STATES)
    qda, qdda = rng.uniform(-1, 1, (2, *qa.shape)) * np.array([5.0, 50.0])[:, None, None]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sys.modules["haptid.experiment.bench.bodies"], "LIGHT", 1e-20
        )  # the simulator's rotors of weightless links, not felt at all
        mj_model = mujoco.MjModel.from_xml_string(mjcf(model, chi))
    data, order = mujoco.MjData(mj_model), list(depth_first(model))
    q, qd, qdd = (x[order] for x in model.tree(qa, qda, qdda))
    active = [order.index(j) for j in model.device.active]
    trees = [tree_of(model, mj_model, data, q[:, k], qd[:, k]) for k in range(STATES)]
    return model, model.base.of(chi), (qa, qda, qdda), (q, qd, qdd), active, trees


def on_drives(model, rows):
    """Torques of rows as torques of the drives, (active, samples)."""
    return np.linalg.solve(model.device.coupling.T, model.device.row_map.T @ rows)


def close(found, wanted, size=0.0):
    """Equal but for rounding, which is of the largest figure, or of `size` where what is compared cancels."""
    np.testing.assert_allclose(found, wanted, rtol=0, atol=TIGHT * max(np.abs(wanted).max(), size))


def test_pins_allow_the_motion_and_no_other(compared):
    model, _, (qa, _, _), (_, qd, qdd), active, trees = compared
    G = np.broadcast_to(model.device.closure.follow(qa).G, (STATES, *model.device.closure.constant.shape))
    G = G[:, list(depth_first(model))]
    for k, tree in enumerate(trees):
        close(tree.basis(active), G[k])
        close(tree.J @ qdd[:, k], -tree.Jd @ qd[:, k], np.abs(tree.J).max() * np.abs(qdd[:, k]).max())


def test_inverse_dynamics_with_rigid_pins(compared):
    """The motors' torques and the pins' forces that make given accelerations: the equations leave no rest."""
    model, beta, motion, (_, _, qdd), _, trees = compared
    found = []
    for k, tree in enumerate(trees):
        wanted = tree.M @ qdd[:, k] + tree.bias - tree.passive
        both = np.column_stack([tree.A, tree.J.T])
        solved = np.linalg.lstsq(both, wanted, rcond=1e-12)[0]
        np.testing.assert_allclose(both @ solved, wanted, rtol=0, atol=TIGHT * np.abs(wanted).max())
        found.append(solved[: len(model.device.motors)])
    close(on_drives(model, haptid.inverse_dynamics(model, beta, *motion)).T, np.array(found))


def test_forward_dynamics_with_rigid_pins(compared):
    """The accelerations that given motor torques make."""
    model, beta, (qa, qda, _), (_, qd, _), active, trees = compared
    u = np.random.default_rng(1).uniform(-0.2, 0.2, (len(model.device.motors), STATES))
    tau = np.linalg.solve(model.device.row_map.T, model.device.coupling.T @ u)
    rest = haptid.inverse_dynamics(model, beta, qa, qda, np.zeros_like(qa))
    cdd = np.linalg.solve(haptid.dynamics.mass_matrix(model, beta, qa), (tau - rest).T[..., None])[..., 0]
    ours = np.linalg.solve(model.device.row_map, cdd.T).T
    theirs = []
    for k, tree in enumerate(trees):
        Z, still = tree.basis(active), tree.still(qd[:, k], active)
        force = Z.T @ (tree.A @ u[:, k] + tree.passive - tree.bias - tree.M @ still)
        theirs.append(np.linalg.solve(Z.T @ tree.M @ Z, force))
    close(ours, np.array(theirs))


def test_mass_matrix_and_bias_of_the_closed_chain(compared):
    model, beta, (qa, qda, _), (_, qd, _), active, trees = compared
    back = np.linalg.inv(model.device.row_map)
    M = haptid.dynamics.mass_matrix(model, beta, qa)
    h = haptid.dynamics.bias_torque(model, beta, qa, qda).T
    for k, tree in enumerate(trees):
        Z = tree.basis(active) @ back
        close(M[k], Z.T @ tree.M @ Z)
        close(h[k], Z.T @ (tree.bias + tree.M @ tree.still(qd[:, k], active)))
