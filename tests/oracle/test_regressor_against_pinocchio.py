"""The regressor times the parameters is Pinocchio's RNEA, on trees, and projected, on closed chains."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from haptid import _core
from mechanisms import Random, draw, mechanisms, states

pin = pytest.importorskip("pinocchio", reason="Pinocchio (package `pin`) has no wheel for this platform")


def pinocchio_model(mechanism: Random):
    pin_model = pin.Model()
    pin_model.gravity.linear = mechanism.gravity
    for i, parent in enumerate(mechanism.parent):
        joint = pin.JointModelPZ() if mechanism.prismatic[i] else pin.JointModelRZ()
        placement = pin.SE3(mechanism.rotation[i], mechanism.translation[i])
        number = pin_model.addJoint(parent + 1, joint, placement, f"joint{i}")
        body = pin.Inertia(mechanism.mass[i], mechanism.com[i], mechanism.inertia[i])
        pin_model.appendBodyToJoint(number, body, pin.SE3.Identity())
    return pin_model


def oracle_torque(mechanism: Random, c, cd, cdd):
    """The tree's torques by RNEA, projected on the coordinates by the transposed rates."""
    pin_model = pinocchio_model(mechanism)
    data, G = pin_model.createData(), mechanism.rates
    q = G @ c + mechanism.offset[:, None]
    tree = [pin.rnea(pin_model, data, q[:, k], G @ cd[:, k], G @ cdd[:, k]) for k in range(c.shape[1])]
    return G.T @ np.array(tree).T


@settings(max_examples=80, deadline=None)
@given(mechanisms(), st.integers(1, 20), st.sampled_from(_core.backends()))
def test_regressor_times_parameters_is_inverse_dynamics(mechanism, samples, backend):
    c, cd, cdd = states(mechanism, samples)
    columns = list(range(10 * len(mechanism.parent)))
    none = np.zeros((0, samples))
    core = mechanism.core(backend)
    wanted = oracle_torque(mechanism, c, cd, cdd)
    got = np.einsum("apk,p->ak", core.regressor(c, cd, cdd, none, columns), mechanism.chi)
    scale = np.abs(wanted).max()
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-12 * scale)
    straight = core.torque(c, cd, cdd, none, mechanism.chi)
    np.testing.assert_allclose(straight, wanted, rtol=0, atol=1e-12 * scale)


@settings(max_examples=40, deadline=None)
@given(mechanisms())
def test_mass_matrix_is_pinocchios(mechanism):
    c = states(mechanism, 1)[0][:, 0]
    pin_model = pinocchio_model(mechanism)
    data, G = pin_model.createData(), mechanism.rates
    upper = np.triu(pin.crba(pin_model, data, G @ c + mechanism.offset))
    tree = upper + np.triu(upper, 1).T
    wanted = G.T @ tree @ G
    np.testing.assert_allclose(mechanism.mass_matrix(c), wanted, rtol=0, atol=1e-11 * np.abs(tree).max())


@settings(max_examples=40, deadline=None)
@given(mechanisms(closed=False), st.integers(1, 20), st.sampled_from(_core.backends()))
@example(draw(157593214, 1, False), 1, _core.backends()[0])  # the torque nearly balances weight
def test_accelerations_are_those_of_articulated_bodies(mechanism, samples, backend):
    c, cd, tau = states(mechanism, samples)
    pin_model = pinocchio_model(mechanism)
    data = pin_model.createData()
    wanted = np.array([pin.aba(pin_model, data, c[:, k], cd[:, k], tau[:, k]) for k in range(samples)]).T
    core = mechanism.core(backend)
    got, failed = core.acceleration(c, cd, tau, np.zeros((0, samples)), mechanism.chi)
    assert failed is None
    condition = np.linalg.cond(core.mass_matrix(c, mechanism.chi)).max()
    # Rounding is relative to the accelerations by torque and by weight, whose difference may be small.
    free = np.array([pin.aba(pin_model, data, c[:, k], cd[:, k], 0 * tau[:, k]) for k in range(samples)]).T
    size = max(np.abs(wanted).max(), np.abs(free).max())
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-14 * condition * size)
