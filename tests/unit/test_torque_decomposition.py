"""Parts of the model's torque: they sum to it, each is the torque of its name, and each kind of term has its own."""

import numpy as np
import pytest
from hypothesis import given, settings

import haptid
from haptid.dynamics.inverse import bias_torque, gravity_torque, mass_matrix
from haptid.end_effector.torque_decomposition import decompose_torque
from mechanisms import mechanisms
from motions import motion, multisine, truth
from random_devices import as_device, parameters

OWN = """
schema = 1
name = "one link with everything"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[terms]]
kind = "coulomb-by-direction"
joints = ["1"]
[[terms]]
kind = "stribeck"
joints = ["1"]
velocity = 0.1
exponent = 1
[[terms]]
kind = "counterbalance"
joints = ["1"]
law = "spring"
crank = 0.1
base = 0.3
[[terms]]
kind = "custom"
joints = ["1"]
name = "CG"
unit = "N m"
expression = "sin(6*q_1)"
"""


def estimated(model, beta, treatment, seconds=4.0, noise=0.02):
    made = motion(model, beta, seconds=seconds, noise=noise, treatment=treatment)
    return haptid.estimate(haptid.observe(model, made), haptid.WLS())


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "staubli_tx40"])
def test_parts_sum_to_the_predicted_torque(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    treatment = haptid.Treatment(cutoff_hz=None, decimation=4)
    estimate = estimated(model, truth(model), treatment)
    unseen = motion(model, estimate.beta, seconds=2.0, seed=9, treatment=treatment)
    parts, whole = decompose_torque(estimate, unseen), haptid.predict(estimate, unseen)
    np.testing.assert_allclose(parts.total, whole.predicted, rtol=0, atol=1e-12 * np.abs(whole.predicted).max())
    np.testing.assert_array_equal(parts.measured, whole.measured)
    np.testing.assert_array_equal(parts.t, whole.t)
    assert parts.motors == whole.motors
    assert parts.parts[:3] == ("inertia", "Coriolis and centrifugal", "gravity")
    np.testing.assert_allclose(parts.friction, parts["viscous"] + parts["Coulomb"], atol=1e-15)
    rms = np.sqrt((parts["gravity"] ** 2).mean(axis=1))
    np.testing.assert_allclose(parts.shares[2], rms / np.sqrt((parts.total**2).mean(axis=1)), rtol=1e-12)


@settings(max_examples=15, deadline=None)
@given(mechanisms(most=5, closed=False))
def test_each_part_is_what_its_name_states(mechanism):
    """Against the mass matrix, the bias and the gravity torque, and the terms' own formulas."""
    model = as_device(mechanism, ("rotor", "viscous", "coulomb", "spring"))
    chi = parameters(mechanism, model)
    beta = model.base.of(chi)
    plain = haptid.Treatment(cutoff_hz=None)
    q, qd, qdd = multisine(mechanism.coordinates, 0.3, 1e-3, 1)
    made = haptid.Motion(1e-3, q.T, np.zeros_like(q.T), plain, rates=(qd.T, qdd.T))
    estimate = estimated(model, beta, plain, noise=0.0)
    parts = decompose_torque(estimate, made)
    exact = estimate.beta
    scale = np.abs(parts.torque).max()
    inertia = np.einsum("sij,js->is", mass_matrix(model, exact, q), qdd)
    np.testing.assert_allclose(parts["inertia"], inertia, rtol=0, atol=1e-11 * scale)
    gravity = gravity_torque(model, exact, q)
    np.testing.assert_allclose(parts["gravity"], gravity, rtol=0, atol=1e-11 * scale)
    velocity = bias_torque(model, exact, q, qd) - gravity
    np.testing.assert_allclose(parts["Coriolis and centrifugal"], velocity, rtol=0, atol=1e-11 * scale)
    factors = {"viscous": qd, "Coulomb": np.sign(qd), "spring": q}
    own = dict(zip(model.base.names, exact, strict=True))
    for part, factor in factors.items():
        values = [own[f"{part.lower()}{k}"] for k in range(len(q))]
        np.testing.assert_allclose(parts[part], np.array(values)[:, None] * factor, rtol=0, atol=1e-11 * scale)


def test_every_kind_of_term_has_its_part(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(OWN)
    model = haptid.DynamicModel(haptid.read_device(path))
    treatment = haptid.Treatment(cutoff_hz=None)
    estimate = estimated(model, np.linspace(0.1, 0.5, len(model.base)), treatment, seconds=8.0)
    parts = decompose_torque(estimate, motion(model, estimate.beta, seconds=1.0, seed=5, treatment=treatment))
    assert parts.parts[3:] == ("Coulomb", "Stribeck", "counterbalance", "own columns")
    text = parts.summary()
    assert all(part in text for part in parts.parts)
    assert "joint 1" in text or "motor 1" in text
    assert "N m" in text


def test_parts_are_read_only():
    model = haptid.DynamicModel(haptid.read_device("emps"))
    estimate = estimated(model, np.array([100.0, 200.0, 20.0, 3.0]), haptid.Treatment(cutoff_hz=None))
    parts = decompose_torque(estimate, motion(model, estimate.beta, seconds=1.0, seed=5))
    with pytest.raises(ValueError, match="read-only"):
        parts.torque[0, 0, 0] = 1.0
