"""From a log file to a validated estimate, its parts and the hand's force, without any acceleration."""

import numpy as np
import pytest

import haptid
from haptid.end_effector.force import estimate_force
from haptid.end_effector.torque_decomposition import decompose_torque
from haptid.motion.filters import Causal, HighPass
from motions import motion, multisine, truth

DT = 1e-3
CAUSAL = {"parallel_cutoff_hz": 8.0, "parallel_shape": Causal(2), "formulation": "momentum"}
WITHOUT_DELAY = haptid.Treatment(decimation=10, formulation="momentum")
RAW = haptid.Treatment(cutoff_hz=None, decimation=10, velocity=HighPass(200.0), torque_delay_s=5e-4, **CAUSAL)


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def recorded(model, folder, seed):
    """A log of a multisine, its torques in the amplifier's unit."""
    q, qd, qdd = multisine(3, 12.0, DT, seed)
    q[2] += 0.8  # inside the joint's limits
    tau = 2.73 * haptid.inverse_dynamics(model, truth(model), q, qd, qdd)
    path = folder / f"{seed}.csv"
    rows = np.vstack([DT * np.arange(q.shape[1]), q, tau]).T
    np.savetxt(path, rows, delimiter=",", header="t,q1,q2,q3,u1,u2,u3", comments="", fmt="%.15g")
    channels = haptid.Channels(
        position=haptid.Signal(("q1", "q2", "q3"), unit="rad"),
        torque=haptid.Signal(("u1", "u2", "u3"), unit=model.device.motors[0].command_unit, side="motor"),
        time="t",
    )
    return haptid.read_log(path, channels)


@pytest.mark.parametrize(("treatment", "percent"), [(WITHOUT_DELAY, 1.0), (RAW, 6.0)])
def test_a_log_becomes_an_estimate_that_predicts_another(model, tmp_path, treatment, percent):
    fit, unseen = (haptid.treat(recorded(model, tmp_path, seed), treatment) for seed in (1, 2))
    found = haptid.estimate(haptid.observe(model, fit), haptid.WLS())
    assert haptid.validate(found, unseen).relative < percent


def test_a_proposal_keeps_what_was_requested(model, tmp_path):
    log = recorded(model, tmp_path, 1)
    made = haptid.propose(model, log, formulation="momentum").treatment
    assert made.momentum
    assert made.parallel_cutoff_hz > 0
    made = haptid.propose(model, log, cutoff_hz=None, velocity=HighPass(200.0), **CAUSAL).treatment
    assert made.velocity == HighPass(200.0)
    assert made.parallel_shape == Causal(2)


@pytest.mark.parametrize("shape", [{"decimation": 10}, {"decimation": 10, **CAUSAL}], ids=["without delay", "causal"])
def test_parts_and_hand_force_are_those_with_accelerations(model, shape):
    """Of exact rates the two roads differ by Tustin's rule at most; the rows themselves are a few samples apart."""
    beta, parts, forces = truth(model), [], []
    for kind in ("acceleration", "momentum"):
        treatment = haptid.Treatment(**{"cutoff_hz": None, **shape, "formulation": kind})
        made = motion(model, beta, seconds=6.0, dt=DT, treatment=treatment, noise=0.02)
        found = haptid.estimate(haptid.observe(model, made), haptid.OLS())
        parts.append(decompose_torque(found, made))
        forces.append(estimate_force(found, made))
        np.testing.assert_allclose(parts[-1].total, haptid.predict(found, made).predicted, rtol=0, atol=1e-12)
    wanted, got = (part.rms for part in parts)
    np.testing.assert_allclose(got, wanted, rtol=0.01, atol=1e-3 * wanted.max())
    wanted, got = (np.nanstd(force.force, axis=0) for force in forces)
    np.testing.assert_allclose(got, wanted, rtol=0.05)
