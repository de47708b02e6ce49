"""The parameters pi_1 to pi_14 of Tahmasebi et al. (2005) from the device file's own targets."""

import numpy as np
import pytest

import haptid
from haptid.dynamics.base_parameters import formula
from haptid.inference.targets import target_map

ALPHA = 2.73  # command per N m
# Table I, column [1] times alpha, in units of command.
TABLE1 = [0.0076, 0.0030, -0.0011, 0.0025, 0.0066, 0.0025, -0.0445, -0.2015]
# Cavusoglu et al. (2002): masses, central moments of a and c, moments of be and df about their joint.
MASS = {"a": 0.0202, "c": 0.0249, "be": 0.2359, "df": 0.1906}
MOMENTS = {
    "a": (0.4864e-4, 0.001843e-4, 0.4864e-4),
    "c": (0.959e-4, 0.959e-4, 0.0051e-4),
    "be": (11.09e-4, 10.06e-4, 0.591e-4),
    "df": (7.11e-4, 0.629e-4, 6.246e-4),
}
BASE_YY = 11.87e-4
L1, L2, L3, L5, L6, G = 0.215, 0.170, 0.0325, -0.0368, 0.0527, 9.81


def equation_4(mass, moments, base_yy):
    """Eq. (4) from central bodies, with 4 I_be,yy in pi_1 where 1 is printed, (8,)."""
    ma, mc, mbe, mdf = (mass[body] for body in ("a", "c", "be", "df"))
    (ax, ay, az), (cx, cy, cz), (bx, by, bz), (dx, dy, dz) = (moments[body] for body in ("a", "c", "be", "df"))
    return np.array(
        [
            (4 * (ay + az + by + bz + cy + cz + dy + dz) + 8 * base_yy
             + L1**2 * mc + L2**2 * ma + 4 * L3**2 * mc + 4 * L1**2 * ma) / 8,
            (4 * by - 4 * bz + 4 * cy - 4 * cz + 4 * L1**2 * ma + L1**2 * mc) / 8,
            (4 * ay - 4 * az + 4 * dy - 4 * dz - L2**2 * ma - 4 * L3**2 * mc) / 8,
            L1 * (L2 * ma + L3 * mc),
            (4 * bx + 4 * cx + 4 * L1**2 * ma + L1**2 * mc) / 4,
            (4 * ax + 4 * dx + L2**2 * ma + 4 * L3**2 * mc) / 4,
            G / 2 * (2 * L1 * ma + 2 * L5 * mbe + L1 * mc),
            G / 2 * (L2 * ma + 2 * L3 * mc - 2 * L6 * mdf),
        ]
    )  # fmt: skip


def standard(model, mass, moments, base_yy):
    """The same bodies as standard parameters in link frames, moved to the joints by Huygens and Steiner, (p,)."""
    chi = np.zeros(len(model.device.parameters))
    chi[model.device.parameters.index["ZZba"]] = base_yy
    middle = {"a": (L2 / 2, L2 / 2), "c": (L1 / 2, L1 / 2), "be": (L5, 0.0), "df": (-L6, 0.0)}
    for body, (x, moved) in middle.items():
        ix, iy, iz = moments[body]
        along, across = (iz, iy) if body in ("be", "c") else (iy, iz)  # the papers' long axis: z, or y
        steiner = mass[body] * moved**2
        values = {"XX": along, "YY": across + steiner, "ZZ": ix + steiner, "MX": mass[body] * x, "M": mass[body]}
        for kind, value in values.items():
            chi[model.device.parameters.index[kind + body]] = value
    return chi


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def test_targets_of_the_prior_bodies_are_equation_4_and_table_1(model):
    rows = np.array([target.row for target in model.device.targets[:8]])
    found = rows @ np.nan_to_num(model.device.chi_prior)
    np.testing.assert_allclose(found, equation_4(MASS, MOMENTS, BASE_YY), rtol=1e-13)
    np.testing.assert_allclose(ALPHA * found, TABLE1, atol=2e-4)
    reference = [0.00283279, 0.00113189, -0.00039120, 0.00091230, 0.00242640, 0.00093189, -0.01629804, -0.07375521]
    np.testing.assert_allclose(found, reference, atol=5e-9)


def test_targets_of_any_bodies_are_equation_4(model):
    rng = np.random.default_rng(0)
    rows = np.array([target.row for target in model.device.targets[:8]])
    for _ in range(20):
        mass = {body: value * rng.uniform(0.1, 3) for body, value in MASS.items()}
        moments = {body: tuple(rng.uniform(0.1, 3, 3) * value) for body, value in MOMENTS.items()}
        wanted = equation_4(mass, moments, 3 * BASE_YY)
        np.testing.assert_allclose(rows @ standard(model, mass, moments, 3 * BASE_YY), wanted, rtol=1e-12, atol=1e-18)


def test_the_eight_base_parameters_and_pi_span_one_space(model):
    C = target_map(model)
    assert C.shape == (14, 14)
    assert np.linalg.matrix_rank(C[:8, :8]) == 8
    np.testing.assert_array_equal(C[:8, 8:], 0)
    np.testing.assert_array_equal(C[8:], np.eye(14)[8:])
    rows = np.array([target.row for target in model.device.targets])
    np.testing.assert_allclose(C @ model.base.regrouping, rows, atol=1e-15)
    np.testing.assert_allclose(np.linalg.solve(C, rows), model.base.regrouping, atol=1e-12)


def test_the_groupings_of_equation_4_are_found_in_link_frames(model):
    """pi_5 is a base parameter, pi_7 is one times g; the others are sums that `target_map` finds."""
    C, names = target_map(model), list(model.base.names)
    found = {
        target.name: formula(row, tuple(names), int(np.argmax(row != 0)))
        for target, row in zip(model.device.targets, np.round(C, 12), strict=True)
    }
    assert found["pi_1"] == "ZZbaR + 0.5 XXbeR + 0.5 XXdfR"
    assert found["pi_2"] == "-0.5 XXbeR"
    assert found["pi_3"] == "0.5 XXdfR"
    assert found["pi_4"] == "0.43 MXaR"
    assert found["pi_5"] == "ZZbeR"
    assert found["pi_6"] == "ZZdfR"
    assert found["pi_7"] == "9.81 MXbeR"
    assert found["pi_8"] == "9.81 MXdfR + 9.81 MXaR"


def test_torque_of_the_targets_is_the_reference_one(model):
    """All fourteen of Table I, Normal, in units of command, against the closed form at one state."""
    normal = [0.0039, 0.0037, -0.0011, 0.0019, 0.0057, 0.0026, -0.0525, -0.3002,
              -0.0057, -0.0035, -0.0005, 0.0707, 0.0251, 0.0248]  # fmt: skip
    beta = np.linalg.solve(target_map(model), np.array(normal))
    column = lambda *x: np.array(x)[:, None]  # noqa: E731
    tau = haptid.inverse_dynamics(model, beta, column(0.3, 0.4, 0.5), column(0.7, -0.5, 0.9), column(1.1, -0.8, 0.6))
    np.testing.assert_allclose(tau[:, 0], [0.07822066, -0.07405567, -0.11915555], atol=5e-9)
