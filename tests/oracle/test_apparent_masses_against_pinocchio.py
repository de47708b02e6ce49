"""Jacobian and apparent masses on every back end are those of Pinocchio's mass matrix and frame Jacobian."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from haptid import _core
from mechanisms import mechanisms, states

pin = pytest.importorskip("pinocchio", reason="Pinocchio (package `pin`) has no wheel for this platform")
from test_regressor_against_pinocchio import pinocchio_model  # noqa: E402

# Condition numbers up to which rounding is multiplied by no more than their square.
WORST = 1e3
# Far above the rounding of velocities at unit rates, far below those of joints that move the handle.
ROUNDING = 1e-9
POINT = [0.1, -0.2, 0.3]


@settings(max_examples=60, deadline=None)
@given(mechanisms(), st.integers(1, 40), st.sampled_from(_core.backends()), st.data())
def test_apparent_masses_are_those_of_pinocchios_matrices(mechanism, samples, backend, drawn):
    c, core, G = states(mechanism, samples)[0], mechanism.core(backend), mechanism.rates
    link = drawn.draw(st.integers(0, len(mechanism.parent) - 1))
    rows = drawn.draw(st.permutations(range(6)).map(lambda order: order[: 1 + order[0] % 4]))
    at, free = (core, c, None, link, POINT, mechanism.chi), list(range(c.shape[0]))
    condition, masses, directions, _ = _core.apparent_mass(*at, rows, free, WORST, np.zeros((core.columns, 0)))
    jacobians = _core.end_effector_dynamics(*at, rows).reshape(samples, -1, len(free))[:, : len(rows)]

    model = pinocchio_model(mechanism)
    handle = model.addFrame(pin.Frame("handle", link + 1, 0, pin.SE3(np.eye(3), np.array(POINT)), pin.OP_FRAME))
    data, r = model.createData(), min(len(rows), len(free))
    for k in range(samples):
        q = G @ c[:, k] + mechanism.offset
        of_joints = pin.computeFrameJacobian(model, data, q, handle, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        J = of_joints[rows] @ G
        np.testing.assert_allclose(jacobians[k], J, rtol=0, atol=1e-12 * (1 + np.abs(J).max()))
        # Unit accelerations by RNEA: `crba` is wrong where joints were not added depth first.
        rest = np.zeros(model.nv)
        weight = pin.rnea(model, data, q, rest, rest)
        A = G.T @ np.column_stack([pin.rnea(model, data, q, rest, column) - weight for column in G.T])
        assume(np.linalg.cond(A) < WORST)
        singular = np.linalg.svd(J, compute_uv=False)[:r]
        # Of a handle that cannot move along a row, Pinocchio's column may be rounding.
        if singular[-1] * WORST <= singular[0] * (1 + 1e-9) or singular[-1] < ROUNDING:
            continue
        np.testing.assert_allclose(condition[k], singular[0] / singular[-1], rtol=1e-9)
        weighted = np.linalg.solve(np.linalg.cholesky(A), J.T).T
        np.testing.assert_allclose(masses[k], np.linalg.svd(weighted, compute_uv=False)[:r][::-1] ** -2.0, rtol=1e-8)
        v = directions[k]
        np.testing.assert_allclose(v @ v.T, np.eye(r), atol=1e-8)
        np.testing.assert_allclose(v @ weighted @ weighted.T @ v.T, np.diag(1 / masses[k]), atol=1e-8 / masses[k, -1])
        assert (np.take_along_axis(v, np.abs(v).argmax(axis=1)[:, None], axis=1) > -1e-9).all()
