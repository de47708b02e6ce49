"""Known parameters come back from quantised encoders without any acceleration, inside their own intervals."""

import numpy as np
import pytest

import haptid
from haptid.motion.filters import Causal, HighPass
from motions import multisine, truth

DT = 1e-3
COUNT = 1.4e-4  # rad
PLAIN = {"decimation": 10, "formulation": "momentum"}
WITHOUT_DELAY = haptid.Treatment(reversal_speed=0.1, **PLAIN)
CAUSAL = haptid.Treatment(reversal_speed=0.1, parallel_cutoff_hz=10.0, parallel_shape=Causal(2), **PLAIN)


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def recorded(model, beta, treatment, seed, noise):
    """A multisine as encoders see it, and its exact torque with white noise of a share of its own size."""
    q, qd, qdd = multisine(len(model.device.active), 15.0, DT, seed, size=0.8)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau += noise * tau.std(axis=1, keepdims=True) * np.random.default_rng(seed).standard_normal(tau.shape)
    return haptid.Motion(DT, (COUNT * np.round(q / COUNT)).T, tau.T, treatment)


def test_they_are_inside_their_intervals_about_95_times_in_100(model):
    beta, inside, runs = truth(model), 0, 8
    for seed in range(runs):
        found = haptid.estimate(haptid.observe(model, recorded(model, beta, WITHOUT_DELAY, seed, 0.1)), haptid.WLS())
        low, high = found.conf_int().T
        inside += int(((low <= beta) & (beta <= high)).sum())
    assert 0.90 < inside / (runs * len(beta)) <= 1.0


@pytest.mark.parametrize(("treatment", "within"), [(WITHOUT_DELAY, 0.01), (CAUSAL, 0.01)])
def test_bodies_come_back_and_predict_another_motion(model, treatment, within):
    beta = truth(model)
    found = haptid.estimate(haptid.observe(model, recorded(model, beta, treatment, 3, 0.0)), haptid.WLS())
    inertial = [k for k, name in enumerate(model.base.names) if name[:2] not in ("FV", "FC")]
    np.testing.assert_allclose(found.beta[inertial], beta[inertial], rtol=within)
    assert haptid.validate(found, recorded(model, beta, treatment, 4, 0.0)).relative < 100 * within


def test_a_lagging_velocity_takes_its_lag_times_inertia_from_the_viscous_terms(model):
    """tau = M qdd + FV qd seen through a velocity late by a lag: what is left looks like less damping, or negative."""
    beta = truth(model)
    viscous = [k for k, name in enumerate(model.base.names) if name.startswith("FV")]
    found = []
    for cutoff in (200.0, 30.0, 15.0):
        velocity = HighPass(cutoff)
        treatment = haptid.Treatment(
            cutoff_hz=None,
            reversal_speed=0.1,
            parallel_cutoff_hz=10.0,
            parallel_shape=Causal(),
            velocity=velocity,
            **PLAIN,
        )
        made = recorded(model, beta, treatment, 3, 0.0)
        found.append(haptid.estimate(haptid.observe(model, made), haptid.WLS()).beta[viscous])
    assert (np.diff(found, axis=0) < 0).all()
    assert (found[-1] < 0).any()
