"""Laws of mechanics, which hold for any mechanism with physical parameters."""

import numpy as np
from hypothesis import given, settings
from scipy.integrate import solve_ivp

from mechanisms import Random, mechanisms, states


@settings(max_examples=40, deadline=None)
@given(mechanisms(most=8))
def test_torque_is_linear_in_the_parameters(mechanism):
    motion = states(mechanism, 5)
    none = np.zeros((0, 5))
    rng = np.random.default_rng(1)
    one, other = rng.normal(size=(2, 10 * len(mechanism.parent)))
    core = mechanism.core()
    both = core.torque(*motion, none, 2.0 * one - 3.0 * other)
    apart = 2.0 * core.torque(*motion, none, one) - 3.0 * core.torque(*motion, none, other)
    np.testing.assert_allclose(both, apart, rtol=0, atol=1e-12 * np.abs(apart).max() + 1e-300)


@settings(max_examples=40, deadline=None)
@given(mechanisms(most=8, closed=False))
def test_mass_matrix_is_symmetric_positive_definite(mechanism):
    M = mechanism.mass_matrix(states(mechanism, 1)[0][:, 0])
    np.testing.assert_allclose(M, M.T, rtol=0, atol=1e-12 * np.abs(M).max())
    assert np.linalg.eigvalsh(M).min() > 0


@settings(max_examples=30, deadline=None)
@given(mechanisms(most=6))
def test_power_of_the_bias_torque_is_that_of_the_changing_mass(mechanism):
    """qd' (dM/dt - 2 C) qd = 0: half of dM/dt takes the same power as the velocity torques, gravity apart."""
    c, cd, _ = (x[:, 0] for x in states(mechanism, 1))
    still = np.zeros_like(c)
    velocity_torque = bias(mechanism, c, cd) - bias(mechanism, c, still)
    step = 1e-5
    dM = (mechanism.mass_matrix(c + step * cd) - mechanism.mass_matrix(c - step * cd)) / (2 * step)
    power = cd @ velocity_torque
    scale = np.abs(cd) @ np.abs(dM) @ np.abs(cd) + np.abs(cd) @ np.abs(velocity_torque)
    assert abs(0.5 * cd @ dM @ cd - power) <= 1e-7 * scale + rounding(mechanism, c, step) * (cd @ cd + 1)


@settings(max_examples=30, deadline=None)
@given(mechanisms(most=5))
def test_christoffel_torques_make_a_skew_matrix(mechanism):
    """dM/dt - 2 C is skew with C from the Christoffel symbols of M, and this C gives the regressor's torques."""
    c, cd, _ = (x[:, 0] for x in states(mechanism, 1))
    n, step = len(c), 1e-5
    shifts = step * np.eye(n)
    dM = np.array([(mechanism.mass_matrix(c + e) - mechanism.mass_matrix(c - e)) / (2 * step) for e in shifts])
    symbols = 0.5 * (dM.transpose(1, 2, 0) + dM.transpose(1, 0, 2) - dM)  # of (dM_ij/dk + dM_ik/dj - dM_jk/di)
    C = symbols @ cd
    skew = np.einsum("kij,k->ij", dM, cd) - 2 * C
    scale = 1e-6 * np.abs(dM).max() + rounding(mechanism, c, step)
    np.testing.assert_allclose(skew, -skew.T, rtol=0, atol=scale * n * (1 + np.abs(cd).max()))
    torque = bias(mechanism, c, cd) - bias(mechanism, c, np.zeros(n))
    np.testing.assert_allclose(C @ cd, torque, rtol=0, atol=scale * n * n * (cd @ cd + 1))


def test_energy_is_kept_along_free_motion():
    """Free motion from the regressor's own equations keeps kinetic plus potential energy."""
    from mechanisms import draw

    for seed, closed in ((3, False), (8, True), (21, False)):
        mechanism = draw(seed, joints=3, closed=closed)
        n = mechanism.coordinates
        if np.linalg.matrix_rank(mechanism.rates) < n:
            continue

        def derivative(_t, state, mechanism=mechanism, n=n):
            c, cd = state[:n], state[n:]
            return np.concatenate([cd, np.linalg.solve(mechanism.mass_matrix(c), -bias(mechanism, c, cd))])

        start = np.concatenate([x[:, 0] for x in states(mechanism, 1, seed)[:2]])
        path = solve_ivp(derivative, (0, 0.5), start, rtol=1e-9, atol=1e-10)
        kinetic = [0.5 * s[n:] @ mechanism.mass_matrix(s[:n]) @ s[n:] for s in path.y.T]
        potential = [potential_energy(mechanism, s[:n]) for s in path.y.T]
        energy = np.add(kinetic, potential)
        assert np.ptp(energy) < 1e-6 * max(kinetic)
        assert np.ptp(potential) > 1e-3 * max(kinetic)  # it did fall


def rounding(mechanism: Random, c: np.ndarray, step: float) -> float:
    """What rounding in M and in the gravity torque leaves in a difference over `step`."""
    size = np.abs(mechanism.mass_matrix(c)).max() + np.abs(bias(mechanism, c, np.zeros_like(c))).max()
    return float(100 * np.finfo(float).eps * size / step)


def bias(mechanism: Random, c: np.ndarray, cd: np.ndarray) -> np.ndarray:
    """Torque without acceleration, (n,)."""
    return mechanism.torque(c[:, None], cd[:, None], np.zeros((len(c), 1)))[:, 0]


def potential_energy(mechanism: Random, c: np.ndarray) -> float:
    """-m g' p over the links' centres of mass, by homogeneous transforms: no part of the core is used."""
    q = mechanism.rates @ c + mechanism.offset
    poses, energy = [], 0.0
    for i, parent in enumerate(mechanism.parent):
        joint = np.eye(4)
        if mechanism.prismatic[i]:
            joint[2, 3] = q[i]
        else:
            joint[:2, :2] = [[np.cos(q[i]), -np.sin(q[i])], [np.sin(q[i]), np.cos(q[i])]]
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = mechanism.rotation[i], mechanism.translation[i]
        poses.append((np.eye(4) if parent < 0 else poses[parent]) @ place @ joint)
        centre = poses[i][:3, :3] @ mechanism.com[i] + poses[i][:3, 3]
        energy -= mechanism.mass[i] * mechanism.gravity @ centre
    return energy
