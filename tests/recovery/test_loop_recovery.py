"""Known parameters of devices whose loops are not linear come back, from accelerations and from momenta."""

import numpy as np
import pytest

import haptid
from closed_devices import bodies, path
from haptid.end_effector.torque_decomposition import decompose_torque

TREATMENTS = {
    "acceleration": haptid.Treatment(cutoff_hz=None, parallel_cutoff_hz=30.0, decimation=5),
    "momentum": haptid.Treatment(parallel_cutoff_hz=30.0, decimation=5, formulation="momentum"),
}


@pytest.mark.parametrize("name", ["slider_crank", "five_bar", "delta"])
@pytest.mark.parametrize("formulation", TREATMENTS)
def test_they_are_inside_their_intervals_and_predict_another_motion(name, formulation):
    model = haptid.DynamicModel(haptid.read_device(name))
    beta = model.base.of(bodies(model))
    dt = 2e-3
    made = []
    for seed in (0, 1):
        q, qd, qdd = path(model, 10.0, dt, size=0.5, seed=seed)
        tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
        tau += 0.02 * tau.std(axis=1, keepdims=True) * np.random.default_rng(seed).standard_normal(tau.shape)
        exact = {"rates": (qd.T, qdd.T)} if formulation == "acceleration" else {}
        made.append(haptid.Motion(dt, q.T, tau.T, TREATMENTS[formulation], **exact))
    found = haptid.estimate(haptid.observe(model, made[0]), haptid.WLS())
    low, high = found.conf_int().T
    assert ((low <= beta) & (beta <= high)).mean() > 0.8
    assert haptid.validate(found, made[1]).relative < 3
    parts = decompose_torque(found, made[1])
    np.testing.assert_allclose(parts.total, haptid.predict(found, made[1]).predicted, atol=1e-9)
