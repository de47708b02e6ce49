"""Laws of generalised momentum, which hold for any mechanism: tau = d/dt (Y_p chi) + Y_rest chi."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid import _core
from mechanisms import Random, mechanisms, states

# Central differences of order eight.
DIFFERENCES = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
EXAMPLES = settings(max_examples=40, deadline=None)


def columns(mechanism: Random) -> list[int]:
    return list(range(10 * len(mechanism.parent)))


def momentum_rows(mechanism: Random, c, cd, backend=None, terms=()):
    core = mechanism.core(backend, terms)
    return core.momentum_regressor(c, cd, np.zeros((0, c.shape[1])), list(range(core.columns)))


def torque_rows(mechanism: Random, c, cd, cdd, terms=()):
    core = mechanism.core(terms=terms)
    return core.regressor(c, cd, cdd, np.zeros((0, c.shape[1])), list(range(core.columns)))


def weightless(mechanism: Random) -> Random:
    return Random(**{**mechanism.__dict__, "gravity": np.zeros(3)})


def terms(na: int) -> tuple:
    """One of each kind on a sum of coordinates."""
    weights = np.arange(1.0, na + 1)
    plain = [(kind, weights, 0.3, 0.0, 0.0, 0.0) for kind in ("rotor", "viscous", "coulomb", "offset", "spring")]
    return (*plain, ("stribeck", weights, 0.3, 0.1, 2.0, 0.0))


@EXAMPLES
@given(mechanisms(most=8), st.sampled_from(_core.backends()))
def test_change_of_momentum_and_the_rest_are_the_torque(mechanism, backend):
    """d/dt Y_p along the motion is dY_p/dq qd + dY_p/dqd qdd, by differences of order eight."""
    c, cd, cdd = states(mechanism, 5)
    several, step = terms(mechanism.coordinates), 2e-3
    change = sum(
        sign
        * weight
        * momentum_rows(mechanism, c + sign * k * step * cd, cd + sign * k * step * cdd, backend, several)[0]
        for k, weight in DIFFERENCES
        for sign in (1, -1)
    )
    rest = momentum_rows(mechanism, c, cd, backend, several)[1]
    wanted = torque_rows(mechanism, c, cd, cdd, several)
    np.testing.assert_allclose(change / step + rest, wanted, rtol=0, atol=1e-9 * max(np.abs(wanted).max(), 1.0))


@EXAMPLES
@given(mechanisms(most=8))
def test_momentum_is_the_torque_of_its_velocity_as_an_acceleration_from_rest(mechanism):
    free = weightless(mechanism)
    c, cd, _ = states(free, 5)
    rotor = terms(free.coordinates)[:1]
    wanted = torque_rows(free, c, 0 * c, cd, rotor)
    got = momentum_rows(mechanism, c, cd, terms=rotor)[0]
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-13 * max(np.abs(wanted).max(), 1.0))


@EXAMPLES
@given(mechanisms(most=8))
def test_power_of_momentum_is_twice_the_kinetic_energy(mechanism):
    c, cd, _ = states(mechanism, 1)
    core = mechanism.core()
    p = core.momentum(c, cd, np.zeros((0, 1)), mechanism.chi)[0, :, 0]
    M = mechanism.mass_matrix(c[:, 0])
    assert cd[:, 0] @ p == pytest.approx(cd[:, 0] @ M @ cd[:, 0], rel=1e-10, abs=1e-12 * max(np.abs(M).max(), 1.0))


@EXAMPLES
@given(mechanisms(most=6))
def test_the_rest_is_coriolis_transposed_by_polarisation_of_the_torque_at_constant_velocity(mechanism):
    """rest_k = g_k - qd . B(qd, e_k), B(a, b) = (c(a + b) - c(a) - c(b)) / 2 of the torque c without acceleration."""
    free = weightless(mechanism)
    c, cd, _ = (x[:, :1] for x in states(free, 1))
    unit = np.eye(free.coordinates)

    def bias(v):
        return torque_rows(free, np.repeat(c, v.shape[1], axis=1), v, 0 * v)

    polar = (bias(cd + unit) - bias(np.repeat(cd, len(unit), axis=1)) - bias(unit)) / 2
    wanted = torque_rows(mechanism, c, 0 * c, 0 * c)[..., 0] - np.einsum("a,apk->kp", cd[:, 0], polar)
    got = momentum_rows(mechanism, c, cd)[1, ..., 0]
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-12 * max(np.abs(wanted).max(), np.abs(polar).max(), 1.0))


@EXAMPLES
@given(mechanisms(most=8), st.integers(1, 20))
def test_every_backend_makes_the_same_rows(mechanism, samples):
    c, cd, _ = states(mechanism, samples)
    several = terms(mechanism.coordinates)
    made = [momentum_rows(mechanism, c, cd, backend, several) for backend in _core.backends()]
    for other in made[1:]:
        np.testing.assert_allclose(other, made[0], rtol=0, atol=1e-12 * max(np.abs(made[0]).max(), 1.0))


@EXAMPLES
@given(mechanisms(most=8), st.integers(1, 20))
def test_products_are_those_of_the_rows(mechanism, samples):
    c, cd, _ = states(mechanism, samples)
    made = mechanism.core().momentum(c, cd, np.zeros((0, samples)), mechanism.chi)
    wanted = np.einsum("sapk,p->sak", momentum_rows(mechanism, c, cd), mechanism.chi)
    np.testing.assert_allclose(made, wanted, rtol=0, atol=1e-12 * max(np.abs(wanted).max(), 1.0))
