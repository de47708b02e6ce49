"""Friction by load in forward dynamics: inverse of the inverse model, agreement with a solver, recovery."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

import haptid
from haptid import errors, estimation
from haptid.dynamics.forward import ForwardDynamics, sets_of
from haptid.estimation.nonlinear.load_friction import fit_load_friction
from haptid.simulation import PID, Segments, closed_loop, open_loop, smooth
from motions import multisine
from small_study import DEVICE
from true_parameters import true_parameters

LOAD = """
[[terms]]
kind = "load-friction"
motors = "all"
width = 0.1
[[terms]]
kind = "rotor-inertia"
motors = "all"
"""
COUPLED = '[[motors]]\nname = "1"\n[[motors]]\nname = "2"\ndrives = { 1 = 1, 2 = 1 }\n'
SIZES = {"FV": 0.05, "FC": 0.2, "FLM": 0.15, "IA": 0.02}


def truth(model):
    return model.base.of(true_parameters(model, **SIZES))


def made(folder, motors):
    """With the loads of its true bodies."""
    text = DEVICE.replace('kind = "coulomb"\n', 'kind = "coulomb"\nwidth = 0.1\n')
    (folder / "device.toml").write_text(text + motors + LOAD)
    read = haptid.DynamicModel(haptid.read_device(folder / "device.toml"))
    return read.loaded(truth(read))


@pytest.fixture(scope="module", params=["", COUPLED], ids=["plain", "coupled"])
def model(request, tmp_path_factory):
    return made(tmp_path_factory.mktemp("device"), request.param)


def test_gradients_of_the_inverse_model_are_those_of_differences(model):
    _, (c, cd, cdd) = states_of(model, 20)
    forward, step = ForwardDynamics(model, sets_of(model, truth(model))), 1e-6
    found = forward.gradients(c, cd, cdd)
    for k, move in enumerate(step * np.eye(2)[:, :, None]):
        by_c = forward.inverse(c + move, cd, cdd) - forward.inverse(c - move, cd, cdd)
        by_cd = forward.inverse(c, cd + move, cdd) - forward.inverse(c, cd - move, cdd)
        for got, change in zip(found, (by_c, by_cd), strict=True):
            np.testing.assert_allclose(got[:, :, k].T, change / (2 * step), rtol=1e-6, atol=1e-6)


def states_of(model, many=200):
    qa = np.random.default_rng(0).normal(size=(3, 2, many))
    return qa, [np.ascontiguousarray(model.device.row_map @ x) for x in qa]


def test_accelerations_undo_the_inverse_model(model):
    """Of every set for itself: the truth, and twice its friction by load."""
    beta = truth(model)
    twice = np.where([name.startswith("FL") for name in model.base.names], 2.0 * beta, beta)
    qa, (c, cd, cdd) = states_of(model)
    torques = [haptid.inverse_dynamics(model, b, *qa) for b in (beta, twice)]
    assert np.abs(torques[0] - torques[1]).max() > 0.1
    forward = ForwardDynamics(model, sets_of(model, np.array([beta, twice])))
    found = forward.acceleration(np.tile(c, 2), np.tile(cd, 2), np.concatenate(torques, axis=1))
    np.testing.assert_allclose(found, np.tile(cdd, 2), rtol=1e-9, atol=1e-9)


def test_inertia_is_the_slope_of_the_inverse_model(model):
    beta, step = truth(model), 1e-6
    _, (c, cd, cdd) = states_of(model, 20)
    found = ForwardDynamics(model, sets_of(model, beta)).inertia(c, cd, cdd)
    back = np.linalg.inv(model.device.row_map)
    for k in range(2):
        ahead, behind = (
            haptid.inverse_dynamics(model, beta, back @ c, back @ cd, back @ (cdd + side * step * np.eye(2)[:, [k]]))
            for side in (1, -1)
        )
        np.testing.assert_allclose(found[:, :, k], (ahead - behind).T / (2 * step), rtol=1e-6, atol=1e-7)


def test_it_falls_as_a_solver_finds(model):
    """Oracle: accelerations from the inverse model by fixed point, along a solver with steps of its own."""
    beta, dt, back = truth(model), 2e-3, np.linalg.inv(model.device.row_map)

    def slope(_t, x):
        cdd = np.zeros(2)
        inverse = np.linalg.inv(haptid.dynamics.mass_matrix(model, beta, back @ x[:2, None])[0])
        for _ in range(40):  # friction that is a share of the load makes each miss a share of the one before
            qa = (back @ y[:, None] for y in (x[:2], x[2:], cdd))
            cdd = cdd + inverse @ (0.5 - haptid.inverse_dynamics(model, beta, *qa)[:, 0])
        return np.append(x[2:], cdd)

    start = np.array([0.3, -0.2, 0.1, 0.4])
    wanted = integrate.solve_ivp(slope, (0, 0.3), start, rtol=1e-7, atol=1e-9, t_eval=dt * np.arange(150)).y
    still = np.zeros((150, 2))
    motion = haptid.Motion(dt, still, still, haptid.Treatment(cutoff_hz=None))
    forward = ForwardDynamics(model, sets_of(model, beta))
    begin = start[:2, None], start[2:, None]
    steps = open_loop(forward, motion, np.full((2, 150), 0.5), begin, Segments.of(150, 150, 0))
    np.testing.assert_allclose(steps.course(motion).c, wanted[:2], atol=1e-5)


@pytest.mark.parametrize("kind", [estimation.IV, estimation.CLOE])
def test_estimators_that_simulate_find_it_again(tmp_path, kind):
    model = made(tmp_path, "")
    beta, dt = truth(model), 4e-3
    target = multisine(2, 4.0, dt, 1)[0].T
    law = PID(60.0, 6.0, reference=(target,))
    planned = haptid.Motion(dt, target, np.zeros_like(target), haptid.Treatment(cutoff_hz=None))
    forward = ForwardDynamics(model, sets_of(model, beta))
    course = closed_loop(forward, law, planned, 0, Segments.of(len(planned), len(planned), 0)).course(planned)
    noisy = course.tau.T + 0.01 * np.random.default_rng(0).normal(size=target.shape)
    moved = haptid.Motion(dt, course.c.T, noisy, haptid.Treatment(cutoff_hz=60))
    here = fit_load_friction(model, [moved], kind(law))
    found = haptid.estimate(haptid.observe(here, moved), kind(law))
    low, high = found.conf_int().T
    assert ((low <= beta) & (beta <= high)).mean() >= 0.7
    for name in ("FLM1", "FLM2"):
        assert found[name].value == pytest.approx(0.15, rel=0.2)
    assert haptid.fit_errors(found).relative < 5.0


def test_sharp_loads_are_smoothed_and_the_filter_rejects_them(model):
    sharp = [t.with_constant("width", 0.0) if t.name.startswith("FL") else t for t in model.terms]
    harsh = replace(model, terms=tuple(sharp))
    q, qd, qdd = multisine(2, 2.0, 4e-3, 1)
    tau = haptid.inverse_dynamics(harsh, truth(harsh), q, qd, qdd)
    moved = haptid.Motion(4e-3, q.T, tau.T, haptid.Treatment(cutoff_hz=None), rates=(qd.T, qdd.T))
    soft = {t.name: t.constant("width") for t in smooth(harsh, [moved], 1e-2).terms if t.dry}
    assert soft["FC1"] == 0.1
    assert 0 < soft["FLM1"] < 0.1
    with pytest.raises(errors.MissingAccelerationError):
        haptid.estimate(haptid.observe(model, moved), estimation.EKF())
