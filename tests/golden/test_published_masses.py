"""The handle of the CEA branch: closed form, published tables, figure 7; and what belongs to the PHANToM."""

import numpy as np
import pytest

import haptid
from haptid.dynamics.inverse import mass_matrix
from haptid.end_effector.characterisation import GivenParameters, apparent_mass, characterise, sweep

D3, D4 = 0.225, 0.275
# Janot et al. (2007), tables 1 and 2, identified values, SI.
UPPER = {
    "ZZ1R": 0.051,
    "MX1R": 0.006,
    "MY1R": 0.030,
    "FC1": 0.12,
    "XX2R": -0.023,
    "ZZ2R": 0.029,
    "MX2R": -0.019,
    "FC2R": 0.11,
    "OFF2": 0.020,
    "XX3R": -0.011,
    "ZZ3R": 0.014,
    "MX3R": 0.039,
    "MX5R": 0.068,
    "FC5R": 0.11,
    "OFF5": 0.030,
}
LOWER = {
    "ZZ1R": 0.046,
    "MX1R": -0.005,
    "MY1R": -0.040,
    "FC1": 0.13,
    "XX2R": -0.021,
    "ZZ2R": 0.027,
    "MX2R": -0.023,
    "FC2R": 0.11,
    "OFF2": 0.020,
    "XX3R": -0.010,
    "ZZ3R": 0.012,
    "MX3R": 0.034,
    "MX5R": 0.067,
    "FC5R": 0.11,
    "OFF5": 0.020,
}


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("cea_medical_branch"))


def identified(model, table):
    return GivenParameters.of(model, table)


def closed_form(table, qa):
    """Mass matrix (poses, 3, 3) and Jacobian (poses, 3, 3) of the reported parameters, by hand."""
    q1, q2, q5 = qa
    f = q5 - np.pi
    p, zero = table, 0 * q1
    A11 = p["ZZ1R"] + p["XX2R"] * np.sin(q2) ** 2 + p["XX3R"] * np.sin(f) ** 2
    A11 = A11 + 2 * D3 * p["MX3R"] * np.cos(q2) * np.cos(f)
    A25 = D3 * p["MX3R"] * np.cos(f - q2)
    A = np.array([[A11, zero, zero], [zero, p["ZZ2R"] + zero, A25], [zero, A25, p["ZZ3R"] + zero]])
    # The tip is Rz(q1) (rho, 0, -D3 sin q2 - D4 sin f).
    rho = D3 * np.cos(q2) + D4 * np.cos(f)
    c, s = np.cos(q1), np.sin(q1)
    out, up = (-D3 * np.sin(q2), -D4 * np.sin(f)), (-D3 * np.cos(q2), -D4 * np.cos(f))
    J = np.array([[-s * rho, c * out[0], c * out[1]], [c * rho, s * out[0], s * out[1]], [zero, up[0], up[1]]])
    return A.transpose(2, 0, 1), J.transpose(2, 0, 1)


def poses(count=60, seed=0):
    rng = np.random.default_rng(seed)
    return np.array([rng.uniform(-1, 1, count), rng.uniform(-1.4, -0.3, count), rng.uniform(0.6, 1.3, count) + np.pi])


@pytest.mark.parametrize("table", [UPPER, LOWER])
def test_masses_are_those_of_the_closed_form(model, table):
    qa, m = poses(), identified(model, table)
    A, J = closed_form(table, qa)
    np.testing.assert_allclose(mass_matrix(model, m.beta, qa), A, atol=1e-12)
    wanted = np.linalg.inv(J).mT @ A @ np.linalg.inv(J)
    found = apparent_mass(m, qa, worst_condition=1e4)
    np.testing.assert_allclose(found.mass.values, np.linalg.eigvalsh(wanted)[:, ::-1], rtol=1e-9)
    rebuilt = np.einsum("pe,pei,pej->pij", found.mass.values, found.directions, found.directions)
    np.testing.assert_allclose(rebuilt, wanted, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ("table", "wanted"),
    [(UPPER, (0.032049, 0.029, -0.003652, 0.014)), (LOWER, (0.028516, 0.027, -0.003184, 0.012))],
)
def test_reference_mass_matrix(model, table, wanted):
    A = mass_matrix(model, identified(model, table).beta, np.array([[0.2], [-1.0], [1.0 + np.pi]]))[0]
    np.testing.assert_allclose([A[0, 0], A[1, 1], A[1, 2], A[2, 2]], wanted, atol=5e-7)


@pytest.mark.parametrize("table", [UPPER, LOWER])
def test_out_of_the_plane_the_mass_is_that_of_a_point_at_the_tip(model, table):
    qa = poses()
    qa[0] = 0.0
    c = characterise(identified(model, table), qa, worst_condition=1e4)
    rho = D3 * np.cos(qa[1]) + D4 * np.cos(qa[2] - np.pi)
    A, _ = closed_form(table, qa)
    np.testing.assert_allclose(c.mass_along([0, 1, 0]).values, A[:, 0, 0] / rho**2, rtol=1e-9)


def test_figure_7(model):
    """Ranges for our lengths; they are inferred, so figure 7 is a shape and an order of magnitude."""
    degrees = np.radians
    arm = sweep([0.0, 0.0, degrees(48) + np.pi], 1, degrees(np.linspace(-80, -20, 61)))
    forearm = sweep([0.0, degrees(-58), 0.0], 2, degrees(np.linspace(50, 70, 41)) + np.pi)
    ranges = {
        "arm": [(0.54, 0.86), (0.31, 0.50), (0.158, 0.184)],
        "forearm": [(0.58, 0.86), (0.35, 0.61), (0.158, 0.184)],
    }
    for name, qa in (("arm", arm), ("forearm", forearm)):
        both = [apparent_mass(identified(model, table), qa).mass.values for table in (UPPER, LOWER)]
        for k, (low, high) in enumerate(ranges[name]):
            values = np.concatenate([value[:, k] for value in both])
            assert abs(values.min() - low) < 0.01, (name, k, values.min())
            assert abs(values.max() - high) < 0.01, (name, k, values.max())


def test_branches_are_close_to_each_other(model):
    qa = poses()
    upper, lower = (apparent_mass(identified(model, table), qa).mass.values for table in (UPPER, LOWER))
    assert (np.abs(upper / lower - 1) < 0.25).all()


def test_coulomb_friction_of_the_first_joint_alone(model):
    """Sideways motion turns joint 1 alone: friction is fc1 / rho, and the printed form agrees there."""
    qa = poses()
    qa[0] = 0.0
    c = characterise(identified(model, UPPER), qa, worst_condition=1e4)
    rho = D3 * np.cos(qa[1]) + D4 * np.cos(qa[2] - np.pi)
    np.testing.assert_allclose(c.coulomb_friction([0, 1, 0]).values[:, 1], 0.12 / np.abs(rho), rtol=1e-9)
    np.testing.assert_allclose(np.abs(c.coulomb_by_axis.values[:, 1]), 0.12 / np.abs(rho), rtol=1e-9)


def test_the_phantom_holds_less_force_the_further_it_reaches():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    c = characterise(GivenParameters(model, model.prior_beta), np.zeros((3, 1)))
    limits = {"1": 0.2, "2": 0.2, "3": 0.2}
    force, direction = c.greatest_force(limits)
    # At zero the arm is level and the forearm hangs: motor 1 turns the tip at 0.215 m and carries no weight.
    np.testing.assert_allclose(c.force_along([1, 0, 0], limits).values, 0.2 / 0.215, rtol=1e-9)
    assert force.values[0] <= 0.2 / 0.215 + 1e-12
    np.testing.assert_allclose(c.force_along(direction[0], limits).values, force.values, rtol=1e-9)
