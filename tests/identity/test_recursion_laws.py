"""Recursions say what rows say: torques, momenta and masses of given parameters; accelerations undo torques."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from closed_devices import NAMES, bodies, poses
from haptid import _core, errors
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.inverse import core_mass, core_momentum, core_torque
from haptid.dynamics.regressor import rows
from mechanisms import Random, mechanisms, states

EXAMPLES = settings(max_examples=40, deadline=None)
BACKENDS = st.sampled_from(_core.backends())


def terms(na: int) -> list:
    """One of each kind, on sums of coordinates."""
    weights = np.arange(1.0, na + 1)
    smooth = [(kind, weights, 0.3, 0.2, 0.0, 0.0) for kind in ("coulomb", "coulomb+", "coulomb-", "spring")]
    sharp = [(kind, weights[::-1].copy(), 0.0, 0.0, 0.0, 0.0) for kind in ("rotor", "viscous", "coulomb", "offset")]
    stribeck = [("stribeck", weights, 0.3, 0.1, exponent, 0.05) for exponent in (1.0, 1.6, 2.0)]
    return [*smooth, *sharp, *stribeck, ("external", weights, 0.0, 0.0, 0.0, 0.0)]


def drawn(mechanism: Random, core: _core.Mechanism, samples: int, sets: int):
    """A motion, the column that the caller makes, and sets of physical parameters of all columns."""
    c, cd, cdd = states(mechanism, samples)
    rng = np.random.default_rng(2)
    own = rng.normal(size=(core.columns - 10 * len(mechanism.parent) and 1, samples))
    chi = np.array([[*mechanism.chi, *np.zeros(core.columns - len(mechanism.chi))]]) * rng.uniform(0.5, 2.0, (sets, 1))
    chi[:, len(mechanism.chi) :] = rng.uniform(0.1, 1.0, (sets, core.columns - len(mechanism.chi)))
    return c, cd, cdd, own, chi


def by_rows(Y: np.ndarray, chi: np.ndarray) -> tuple[np.ndarray, float]:
    """Rows (..., columns, samples) times each sample's own set, and how much was added up."""
    of = chi[np.arange(Y.shape[-1]) * len(chi) // Y.shape[-1]].T
    return (Y * of).sum(axis=-2), max(1.0, np.abs(Y * of).sum(axis=-2).max(initial=0.0))


@EXAMPLES
@given(mechanisms(most=8), st.integers(1, 40), st.sampled_from([1, 2, 5]), BACKENDS)
def test_torques_are_rows_times_parameters(mechanism, each, sets, backend):
    core = mechanism.core(backend, terms(mechanism.coordinates))
    c, cd, cdd, own, chi = drawn(mechanism, core, each * sets, sets)
    wanted, scale = by_rows(core.regressor(c, cd, cdd, own, list(range(core.columns))), chi)
    np.testing.assert_allclose(core.torque(c, cd, cdd, own, chi), wanted, rtol=0, atol=1e-13 * scale)


@EXAMPLES
@given(mechanisms(most=8), st.integers(1, 40), st.sampled_from([1, 3]), BACKENDS)
def test_momenta_are_rows_times_parameters(mechanism, each, sets, backend):
    core = mechanism.core(backend, terms(mechanism.coordinates))
    c, cd, _, own, chi = drawn(mechanism, core, each * sets, sets)
    wanted, scale = by_rows(core.momentum_regressor(c, cd, own, list(range(core.columns))), chi)
    np.testing.assert_allclose(core.momentum(c, cd, own, chi), wanted, rtol=0, atol=1e-13 * scale)


@EXAMPLES
@given(mechanisms(most=8), st.integers(1, 40), BACKENDS)
def test_mass_matrices_are_the_torques_of_unit_accelerations(mechanism, samples, backend):
    core = mechanism.core(backend, [term for term in terms(mechanism.coordinates) if term[0] == "rotor"])
    c, _, _, own, chi = drawn(mechanism, core, samples, 1)
    still, none = np.zeros_like(c), own[:0]
    rest = core.torque(c, still, still, none, chi)
    made = core.mass_matrix(c, chi)
    rounding = 1e-13 * (np.abs(rest).max() + np.abs(made).max())
    for a, unit in enumerate(np.eye(len(c))):
        column = core.torque(c, still, still + unit[:, None], none, chi) - rest
        np.testing.assert_allclose(made[:, :, a].T, column, rtol=0, atol=rounding)
    np.testing.assert_array_equal(made, made.transpose(0, 2, 1))


@EXAMPLES
@given(mechanisms(most=7, closed=False), st.integers(1, 40), st.sampled_from([1, 2, 5]), BACKENDS)
def test_accelerations_undo_torques(mechanism, each, sets, backend):
    """M cdd + h = tau, whatever set a sample is of."""
    core = mechanism.core(backend, terms(mechanism.coordinates))
    c, cd, _, own, chi = drawn(mechanism, core, each * sets, sets)
    tau = np.random.default_rng(3).normal(size=c.shape)
    cdd, failed = core.acceleration(c, cd, tau, own, chi)
    assert failed is None
    M, h = core.mass_matrix(c, chi), core.torque(c, cd, np.zeros_like(c), own, chi)
    scale = np.abs(np.einsum("sij,js->is", np.abs(M), np.abs(cdd))).max() + np.abs(h).max() + 1.0
    np.testing.assert_allclose(np.einsum("sij,js->is", M, cdd) + h, tau, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("backend", _core.backends())
@pytest.mark.parametrize("samples", [7, 3000])
def test_the_first_mass_matrix_that_is_not_positive_definite_is_named(backend, samples):
    """A link that slides has its mass as mass matrix: none, or less than none, from one sample on."""
    core = _core.Mechanism(
        [-1], np.eye(3)[None], np.zeros((1, 3)), [True], [0.0] * 3, np.eye(1), np.zeros(1), [], backend
    )
    still, bad = np.zeros((1, samples)), samples - 4
    chi = np.zeros((samples, 10))
    chi[:, 9] = 2.0
    cdd, failed = core.acceleration(still, still, still + 3.0, still[:0], chi)
    assert failed is None
    np.testing.assert_array_equal(cdd, 1.5)
    for mass in (0.0, -1.0):
        chi[bad:, 9] = mass
        cdd, failed = core.acceleration(still, still, still + 3.0, still[:0], chi)
        assert failed == bad
        np.testing.assert_array_equal(cdd[:, :bad], 1.5)


@settings(max_examples=15, deadline=None)
@given(mechanisms(most=5, closed=False))
def test_what_nothing_pushes_keeps_its_energy(mechanism):
    free = Random(**{**mechanism.__dict__, "gravity": np.zeros(3)})
    core, (c, cd, _) = free.core(), states(free, 3)
    none, step = np.zeros((0, 3)), 2e-4

    def slope(c, cd):
        return cd, core.acceleration(c, cd, np.zeros_like(c), none, free.chi)[0]

    def energy(c, cd):
        return 0.5 * np.einsum("is,sij,js->s", cd, core.mass_matrix(c, free.chi), cd)

    before = energy(c, cd)
    for _ in range(10):  # Runge and Kutta's method of order four
        k1 = slope(c, cd)
        k2 = slope(c + step / 2 * k1[0], cd + step / 2 * k1[1])
        k3 = slope(c + step / 2 * k2[0], cd + step / 2 * k2[1])
        k4 = slope(c + step * k3[0], cd + step * k3[1])
        c, cd = (x + step / 6 * (a + 2 * b + 2 * d + e) for x, a, b, d, e in zip((c, cd), k1, k2, k3, k4, strict=True))
    np.testing.assert_allclose(energy(c, cd), before, rtol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_loops_whose_rates_vary(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    qa, qda, qdda = poses(model, 41)
    c, cd, cdd = (model.device.row_map @ x for x in (qa, qda, qdda))
    chi = model.device.parameters.S @ bodies(model)
    Y = rows(model, c, cd, cdd)
    wanted, scale = by_rows(Y, chi[None])
    tau = core_torque(model, chi, c, cd, cdd)
    np.testing.assert_allclose(tau, wanted, rtol=0, atol=1e-13 * scale)
    core, loops = model.mechanism, model.loops(c, cd)
    momenta = core.momentum_regressor(c, cd, np.zeros((0, 41)), list(range(core.columns)), loops)
    wanted, scale = by_rows(momenta, chi[None])
    np.testing.assert_allclose(core_momentum(model, chi, c, cd), wanted, rtol=0, atol=1e-13 * scale)
    still = np.zeros_like(c)
    for a, unit in enumerate(np.eye(len(c))):
        column = core_torque(model, chi, c, still, still + unit[:, None]) - core_torque(model, chi, c, still, still)
        np.testing.assert_allclose(core_mass(model, chi, c)[:, :, a].T, column, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(ForwardDynamics(model, chi).acceleration(c, cd, tau), cdd, rtol=1e-7, atol=1e-7)


def test_a_set_without_inertia_is_an_error_that_names_the_row():
    model = haptid.DynamicModel(haptid.read_device("arm3"))
    chi = np.zeros((2, model.mechanism.columns))
    for set_, size in zip(chi, (1.0, -1.0), strict=True):
        for j in range(3):
            set_[10 * j : 10 * j + 10] = size * np.array([0.3, 0, 0, 0.3, 0, 0.3, 0.1, 0, 0, 1.0])
    still = np.zeros((3, 6))
    assert np.isfinite(ForwardDynamics(model, chi[:1]).acceleration(still, still, still)).all()
    with pytest.raises(errors.SimulationError, match="no inertia"):
        ForwardDynamics(model, chi).acceleration(still, still, still)


def test_sets_that_do_not_fit_are_rejected():
    core = haptid.DynamicModel(haptid.read_device("arm3")).mechanism
    c, none = np.zeros((3, 5)), np.zeros((0, 5))
    with pytest.raises(ValueError, match="chi has shape"):
        core.torque(c, c, c, none, np.zeros(core.columns + 1))
    with pytest.raises(ValueError, match="chi has shape"):
        core.torque(c, c, c, none, np.zeros((core.columns, 2)).T)
    with pytest.raises(ValueError, match="equally large sets"):
        core.torque(c, c, c, none, np.zeros((2, core.columns)))
