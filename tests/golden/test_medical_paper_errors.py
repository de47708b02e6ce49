"""What is printed in Janot et al. (2007) and does not hold, T1 to T9 of docs/medical.md, each shown by numbers.

T8, the condition number, is in test_cea_essential.py; all groupings by both roads are in test_exact_regroupings.py.
"""

import numpy as np
import pytest

import haptid
from haptid.demos import read_demo
from haptid.dynamics.inverse import core_torque, mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation import GivenParameters, apparent_mass, characterise
from haptid.end_effector.characterisation.velocity_forces import velocity_product_acceleration

DEMO = read_demo("medical")
DEVICE = haptid.DynamicModel(haptid.read_device(DEMO.device))
D3, D4, D6, D7, D9 = (DEVICE.device.lengths[name] for name in ("d3", "d4", "d6", "d7", "d9"))
# What the printed groupings have beside the right ones of sign set A, by base and standard parameter.
PRINTED = {
    "T1": {"ZZ1R": {"XX4": -2.0, "XX8": -2.0}},
    "T2": {"ZZ1R": {"M9": D9**2, "M6": -(D6**2)}},
    "T3": {"XZ2R": {"MZ5": -D3, "MZ6": -D3, "MZ7": -D3}},
    "T4": {
        "XZ3R": {"XZ5": 2.0, "MZ6": -2 * D6},
        "YZ3R": {"YZ5": 2.0},
        "MX3R": {"MX6": 2 * D6 / D3},
        "MY8R": {"MX7": -2 * D7 / D3},
    },
}
TABLES = {key: dict(zip(table.rows, table.column("identified"), strict=True)) for key, table in DEMO.tables.items()}


def states(count=40, seed=0):
    rng = np.random.default_rng(seed)
    q = np.array([rng.uniform(-1, 1, count), rng.uniform(-1.4, -0.4, count), np.pi + rng.uniform(0.3, 1.2, count)])
    return q, rng.uniform(-2, 2, (3, count)), rng.uniform(-9, 9, (3, count))


@pytest.mark.parametrize("claim", PRINTED)
def test_printed_groupings_give_another_torque(claim):
    """Of bodies drawn at random: the right groupings give the torque of the tree, the printed ones do not."""
    assert np.array_equal(DEVICE.device.row_map, np.eye(3))
    index, rng = DEVICE.device.parameters.index, np.random.default_rng(1)
    chi = np.zeros(len(DEVICE.device.parameters.names))
    for change in PRINTED[claim].values():
        chi[[index[name] for name in change]] = rng.uniform(0.5, 1.5, len(change))
    whole = core_torque(DEVICE, DEVICE.device.parameters.S @ chi, *states())
    beta = DEVICE.base.of(chi)
    np.testing.assert_allclose(haptid.inverse_dynamics(DEVICE, beta, *states()), whole, atol=1e-11)
    for name, change in PRINTED[claim].items():
        beta[DEVICE.base.names.index(name)] += sum(c * chi[index[other]] for other, c in change.items())
    missed = haptid.inverse_dynamics(DEVICE, beta, *states()) - whole
    assert np.linalg.norm(missed) > 5e-3 * np.linalg.norm(whole)


def test_t1_a_larger_end_piece_is_harder_to_turn():
    """With the printed sign a body could be added that makes the shoulder easier to turn."""
    still, one = np.array([[0.0], [-1.0], [np.pi + 0.8]]), np.array([[1.0], [0.0], [0.0]])
    for name in ("XX4", "XX8"):
        chi = np.zeros(len(DEVICE.device.parameters.names))
        chi[DEVICE.device.parameters.index[name]] = 1e-3
        torque = core_torque(DEVICE, DEVICE.device.parameters.S @ chi, still, 0 * still, one)
        assert torque[0, 0] == pytest.approx(1e-3)


@pytest.mark.parametrize("branch", TABLES)
def test_t5_the_neglected_force_needs_the_inverse_jacobian(branch):
    """A handle that moves straight at constant speed: the force is F_d as mended, not as printed."""
    identified, (qa, _, _) = GivenParameters.of(DEVICE, without_friction(TABLES[branch])), states(20)
    J = handle_motion(DEVICE, qa).jacobian[:, :3]
    v = np.random.default_rng(2).uniform(-1, 1, (20, 3))
    qd = np.linalg.solve(J, v[:, :, None])[:, :, 0].T
    turning = velocity_product_acceleration(DEVICE, qa, qd)[:, :3]
    qdd = -np.linalg.solve(J, turning[:, :, None])[:, :, 0].T
    felt = hand(J, haptid.inverse_dynamics(DEVICE, identified.beta, qa, qd, qdd))
    ours = characterise(identified, qa, worst_condition=1e4).neglected_force_of(v).values
    np.testing.assert_allclose(ours, felt, atol=1e-9)
    H = haptid.inverse_dynamics(DEVICE, identified.beta, qa, qd, 0 * qd)
    printed = hand(J, H - np.einsum("nij,nj->in", mass_matrix(DEVICE, identified.beta, qa), turning))
    weight = hand(J, haptid.inverse_dynamics(DEVICE, identified.beta, qa, 0 * qd, 0 * qd))
    assert np.linalg.norm(printed - felt) > 0.3 * np.linalg.norm(felt - weight)


def without_friction(table):
    return {name: value for name, value in table.items() if not name.startswith(("FC", "OFF"))}


def hand(J, torque):
    """Force at the handle of motors' torques (3, n), (n, 3)."""
    return np.linalg.solve(J.mT, torque.T[:, :, None])[:, :, 0]


@pytest.mark.parametrize("branch", TABLES)
def test_t6_printed_friction_can_drive(branch):
    """Friction takes power in every motion; with the printed signs it gives some in many."""
    fc = np.array([TABLES[branch][name] for name in ("FC1", "FC2R", "FC5R")])
    qa, _, _ = states(400)
    J = handle_motion(DEVICE, qa).jacobian[:, :3]
    v = np.random.default_rng(3).normal(size=(400, 3))
    qd = np.linalg.solve(J, v[:, :, None])[:, :, 0]
    exact = np.einsum("ni,ni->n", hand(J, (fc * np.sign(qd)).T), v)
    printed = np.einsum("ni,ni,ni->n", hand(J, np.repeat(fc[:, None], 400, axis=1)), np.sign(v), v)
    np.testing.assert_allclose(exact, np.abs(qd) @ fc, rtol=1e-9)
    assert (printed < 0).mean() > 0.2
    c = characterise(GivenParameters.of(DEVICE, TABLES[branch]), qa[:, :1], worst_condition=1e4)
    found = c.coulomb_friction(v[0]).values[0] @ v[0]
    assert found == pytest.approx(exact[0])


def test_t7_a_relative_deviation_needs_the_absolute_value():
    negative = [value for table in DEMO.tables.values() for value in table.column("identified") if value < 0]
    relative = [value for table in DEMO.tables.values() for value in table.column("relative")]
    assert len(negative) == 8
    assert min(relative) > 0


def smallest(table, d3, d4, q2, f):
    """Smallest mass in the plane of the branch, by hand, (poses,): least eigenvalue of J^-T A J^-1."""
    A25 = d3 * table["MX3R"] * np.cos(f - q2)
    A = np.array([[table["ZZ2R"] + 0 * A25, A25], [A25, table["ZZ3R"] + 0 * A25]]).transpose(2, 0, 1)
    J = np.array([[-d3 * np.sin(q2), -d4 * np.sin(f)], [-d3 * np.cos(q2), -d4 * np.cos(f)]]).transpose(2, 0, 1)
    inverse = np.linalg.inv(J)
    return np.linalg.eigvalsh(inverse.mT @ A @ inverse)[:, 0]


@pytest.mark.parametrize("branch", TABLES)
def test_t9_the_smallest_mass_is_the_same_in_both_sweeps(branch):
    """With the inferred lengths within 2 %, and about ZZ3R / d4^2; so the two published ranges cannot both be."""
    identified, table = GivenParameters.of(DEVICE, TABLES[branch]), TABLES[branch]
    arm, forearm = (apparent_mass(identified, sweep.along(DEVICE)).mass.values[:, 2] for sweep in DEMO.sweeps)
    both = np.concatenate([arm, forearm])
    assert np.ptp(both) < 0.02 * both.mean()
    np.testing.assert_allclose(both, table["ZZ3R"] / D4**2, rtol=0.02)
    first, second = (sweep.published[2] for sweep in DEMO.sweeps)
    assert first[1] < second[0]


@pytest.mark.parametrize("branch", TABLES)
def test_t9_no_lengths_have_both_ranges(branch):
    """For lengths of 0.15 to 0.4 m and any fixed angles, what the sweeps have in common spoils one of the ranges."""
    table, (first, second) = TABLES[branch], (sweep.published[2] for sweep in DEMO.sweeps)
    qa = DEMO.sweeps[0].along(DEVICE)
    by_hand = smallest(table, D3, D4, qa[1], qa[2] - np.pi)
    np.testing.assert_allclose(
        apparent_mass(GivenParameters.of(DEVICE, table), qa).mass.values[:, 2], by_hand, rtol=1e-9
    )
    lengths, angles = np.linspace(0.15, 0.4, 8), np.radians(np.linspace(-80, -20, 5))
    arm, forearm = angles, np.radians(np.linspace(50, 70, 5))
    for d3 in lengths:
        for d4 in lengths:
            for f, q2 in ((f, q2) for f in np.radians(np.linspace(20, 80, 5)) for q2 in angles):
                one = smallest(table, d3, d4, arm, f + 0 * arm)
                other = smallest(table, d3, d4, q2 + 0 * forearm, forearm)
                assert not (inside(one, first) and inside(other, second)), (d3, d4, f, q2)


def inside(values, limits):
    """Whether a sweep's values are all within a published range, and 3 % of it."""
    return values.min() > 0.97 * limits[0] and values.max() < 1.03 * limits[1]
