"""Published parameters of a device: which of them real bodies can have."""

import numpy as np
import pytest

import haptid
from haptid.estimation import feasible_parameters, project_to_feasible
from motions import motion

# Table I of Tahmasebi et al. (2005), pi_1 to pi_14, in the amplifier's torque units: 2.73 times SI.
TABLE = {
    "normal": [
        *(0.0039, 0.0037, -0.0011, 0.0019, 0.0057, 0.0026, -0.0525, -0.3002),
        *(-0.0057, -0.0035, -0.0005, 0.0707, 0.0251, 0.0248),
    ],
    "gc": [
        *(0.0093, 0.0121, -0.0032, 0.0252, 0.0206, 0.0097, 0.0735, 0.1270),
        *(-0.0074, 0.0003, 0.0031, 0.0716, 0.0228, 0.0247),
    ],
    "fs": [
        *(0.0028, 0.0059, -0.0021, 0.0082, 0.0095, 0.0031, 0.1279, -0.1886),
        *(-0.0025, -0.0009, 0.0012, 0.0739, 0.0255, 0.0273),
    ],
    "usd": [
        *(0.0033, 0.0044, -0.0014, 0.0018, 0.0078, 0.0035, 0.0580, 0.2969),
        *(-0.0037, -0.0004, 0.0025, 0.0712, 0.0225, 0.0221),
    ],
    "usd+gc": [
        *(0.0083, 0.0090, -0.0020, 0.0251, 0.0174, 0.0086, -0.0453, -0.3070),
        *(-0.0003, 0.0015, 0.0020, 0.0665, 0.0199, 0.0238),
    ],
}
# Column [1]: the bodies of Cavusoglu et al. (2002), which have no friction; some is put in.
CAVUSOGLU = [
    0.0076,
    0.0030,
    -0.0011,
    0.0025,
    0.0066,
    0.0025,
    -0.0445,
    -0.2015,
    1e-3,
    1e-3,
    1e-3,
    0.0707,
    0.0251,
    0.0248,
]
NEGATIVE_DAMPING = {"normal": "123", "gc": "1", "fs": "12", "usd": "12", "usd+gc": "1"}
# Links in whose inertias the contradiction lies, at least: conditions 1 (arm), 2 (forearm) and 4 (both).
ARM, FOREARM = {"link be", "link c"}, {"link df", "link a"}
CONTRADICTION = {"normal": ARM, "gc": ARM, "fs": FOREARM, "usd": ARM, "usd+gc": ARM | FOREARM}


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def to_pi(model):
    """pi = to_pi beta, by the papers' eq. (4); 9.81 m/s^2 is in pi_7 and pi_8."""
    row = {name: k for k, name in enumerate(model.base.names)}
    L1, g = model.device.lengths["L1"], 9.81
    combinations = [
        {"ZZbaR": 1, "XXbeR": 0.5, "XXdfR": 0.5},
        {"XXbeR": -0.5},
        {"XXdfR": 0.5},
        {"MXaR": 2 * L1},
        {"ZZbeR": 1},
        {"ZZdfR": 1},
        {"MXbeR": g},
        {"MXdfR": g, "MXaR": g},
        *({f"F{kind}{k}": 1} for kind in "VC" for k in (1, 2, 3)),
    ]
    matrix = np.zeros((14, 14))
    for k, combination in enumerate(combinations):
        for name, share in combination.items():
            matrix[k, row[name]] = 2.73 * share
    return matrix


def test_the_combinations_are_the_papers(model, to_pi):
    """From the bodies of Cavusoglu et al.: the printed column (pi_1 and pi_2 are one off in the last digit)."""
    beta = model.prior_beta
    np.testing.assert_allclose((to_pi @ beta)[:8], CAVUSOGLU[:8], atol=2e-4)


def test_the_column_from_measured_bodies_is_possible(model, to_pi):
    found = feasible_parameters(model, np.linalg.solve(to_pi, CAVUSOGLU))
    assert found.ok
    assert 1e-3 < found.margin < 0.1


@pytest.mark.parametrize("installation", TABLE)
def test_no_identified_column_is_possible(model, to_pi, installation):
    found = feasible_parameters(model, np.linalg.solve(to_pi, TABLE[installation]))
    assert not found.ok
    assert found.margin < -1e-3
    damping = [sentence for sentence in found.failing if sentence.startswith("viscous")]
    assert damping == [f"viscous friction of motor {k}: negative" for k in NEGATIVE_DAMPING[installation]]
    (bodies,) = [sentence for sentence in found.failing if not sentence.startswith("viscous")]
    assert CONTRADICTION[installation] <= set(bodies.split(": ")[0].split(", "))
    # Without the negative damping the inertias still contradict one another.
    frictionless = np.array(TABLE[installation])
    frictionless[8:11] = 1e-3
    assert len(feasible_parameters(model, np.linalg.solve(to_pi, frictionless)).failing) == 1


@pytest.mark.parametrize("installation", TABLE)
def test_the_nearest_feasible_satisfy_the_necessary_conditions(model, to_pi, installation):
    """Conditions on pi that any bodies fulfil, derived by hand from the mass matrix; torque changes by per cents."""
    R = metric(model, to_pi, installation)
    beta = np.linalg.solve(to_pi, TABLE[installation])
    found = project_to_feasible(model, beta, R)
    assert found.ok
    p1, p2, p3, p4, p5, p6, *_ = pi = to_pi @ found.beta
    slack = 1e-8
    assert p5 >= 2 * abs(p2) - slack
    assert p6 >= 2 * abs(p3) - slack
    assert p1 >= (p5 + p6) / 2 - slack
    assert (p5 / 2 + p2) * (p6 / 2 - p3) >= (p4 / 2) ** 2 - slack
    assert p4 >= -slack
    assert (pi[8:] >= 0).all()
    assert np.linalg.norm(R @ (found.beta - beta)) < 0.08 * np.linalg.norm(R @ beta)


def metric(model, to_pi, installation):
    """The triangle of a multisine in the device's range."""
    made = motion(model, np.linalg.solve(to_pi, TABLE[installation]), seconds=20.0, dt=4e-3)
    return haptid.observe(model, made).stack()[:-1, :-1]


def test_the_nearest_possible_to_the_normal_column(model, to_pi):
    """Near a projection computed elsewhere, on another multisine and with the necessary conditions alone."""
    R = metric(model, to_pi, "normal")
    pi = to_pi @ project_to_feasible(model, np.linalg.solve(to_pi, TABLE["normal"]), R).beta
    wanted = [0.0045, 0.0028, -0.0009, 0.0020, 0.0057, 0.0026, -0.0522, -0.3003, 0, 0, 0, 0.0664, 0.0221, 0.0244]
    np.testing.assert_allclose(pi[:6], wanted[:6], atol=4e-4)
    np.testing.assert_allclose(pi[6:8], wanted[6:8], rtol=0.01)
    np.testing.assert_array_equal(pi[8:11], 0.0)
    np.testing.assert_allclose(pi[11:], wanted[11:], atol=5e-3)
