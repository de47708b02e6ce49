"""Slopes of torques by positions, velocities and accelerations are Pinocchio's derivatives of RNEA, exact ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid import _core
from mechanisms import mechanisms, states

pin = pytest.importorskip("pinocchio", reason="Pinocchio (package `pin`) has no wheel for this platform")
from test_regressor_against_pinocchio import pinocchio_model  # noqa: E402


@settings(max_examples=60, deadline=None)
@given(mechanisms(), st.integers(1, 10), st.sampled_from(_core.backends()))
def test_gradients_of_torques_are_pinocchios(mechanism, samples, backend):
    motion = states(mechanism, samples)
    columns, none = list(range(10 * len(mechanism.parent))), np.zeros((0, samples))
    found = mechanism.core(backend).torque_slopes(*motion, none, columns, mechanism.chi.tolist())
    other_model, G = pinocchio_model(mechanism), mechanism.rates
    data = other_model.createData()
    for k in range(samples):
        q, qd, qdd = (G @ x[:, k] for x in motion)
        made = pin.computeRNEADerivatives(other_model, data, q + mechanism.offset, qd, qdd)
        by_q, by_qd, by_qdd = (np.array(x) for x in made)
        by_qdd = np.triu(by_qdd) + np.triu(by_qdd, 1).T
        wanted = np.hstack([G.T @ by @ G for by in (by_q, by_qd, by_qdd)])
        np.testing.assert_allclose(found[:, :, k], wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
