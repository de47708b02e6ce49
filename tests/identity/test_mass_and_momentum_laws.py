"""Mass matrix, bias and gravity torque, and momentum: laws on random mechanisms with rotors and friction."""

import numpy as np
from hypothesis import given, settings

import haptid
from haptid.dynamics.inverse import bias_torque, gravity_torque, mass_matrix, momentum, raw_parameters
from mechanisms import mechanisms, states
from random_devices import as_device, parameters


def made(mechanism, kinds=("rotor", "viscous", "coulomb")):
    model = as_device(mechanism, kinds)
    return model, model.base.of(parameters(mechanism, model))


@settings(max_examples=30, deadline=None)
@given(mechanisms(most=6))
def test_mass_matrix_is_that_of_the_bodies_and_rotors(mechanism):
    model, beta = made(mechanism)
    qa = states(mechanism, 3)[0]
    rotors = np.diag(parameters(mechanism, model)[-len(model.terms) :][: mechanism.coordinates])
    for got, c in zip(mass_matrix(model, beta, qa), qa.T, strict=True):
        wanted = mechanism.mass_matrix(c) + rotors
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


@settings(max_examples=30, deadline=None)
@given(mechanisms(most=6))
def test_torque_is_mass_times_acceleration_and_bias(mechanism):
    model, beta = made(mechanism, kinds=("rotor",))
    qa, qda, qdda = states(mechanism, 4)
    parts = np.einsum("sij,js->is", mass_matrix(model, beta, qa), qdda) + bias_torque(model, beta, qa, qda)
    wanted = haptid.inverse_dynamics(model, beta, qa, qda, qdda)
    np.testing.assert_allclose(parts, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
    still = bias_torque(model, beta, qa, np.zeros_like(qda))
    np.testing.assert_allclose(gravity_torque(model, beta, qa), still, rtol=0, atol=1e-12 * np.abs(wanted).max())


@settings(max_examples=30, deadline=None)
@given(mechanisms(most=6))
def test_momentum_is_mass_times_velocity_and_its_power_twice_the_energy(mechanism):
    model, beta = made(mechanism)
    c, cd, _ = states(mechanism, 4)
    p, _ = momentum(model, raw_parameters(model, beta), c, cd)
    wanted = np.einsum("sij,js->is", mass_matrix(model, beta, c), cd)
    np.testing.assert_allclose(p, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())


@settings(max_examples=30, deadline=None)
@given(mechanisms(most=5))
def test_momentum_changes_by_torque_and_velocity_product(mechanism):
    """The bodies' torque along any motion is dp/dt + g - C' cd; C' cd is the gradient of the kinetic energy."""
    model, beta = made(mechanism, kinds=("rotor",))
    chi, h = raw_parameters(model, beta), 1e-5
    c, cd, cdd = states(mechanism, 3)
    ahead, behind = (momentum(model, chi, c + s * cd + 0.5 * s**2 * cdd, cd + s * cdd)[0] for s in (h, -h))
    p, rest = momentum(model, chi, c, cd)
    wanted = haptid.inverse_dynamics(model, beta, c, cd, cdd) - rest
    turned = gravity_torque(model, beta, c) - rest
    scale = np.abs(wanted).max() + np.abs(p).max()
    np.testing.assert_allclose((ahead - behind) / (2 * h), wanted, rtol=0, atol=1e-6 * scale * len(c) ** 2)
    for k, e in enumerate(np.eye(len(c))):
        up, down = (
            0.5 * np.einsum("is,sij,js->s", cd, mass_matrix(model, beta, c + s * e[:, None]), cd) for s in (h, -h)
        )
        np.testing.assert_allclose(turned[k], (up - down) / (2 * h), rtol=0, atol=1e-6 * scale * len(c) ** 2)
