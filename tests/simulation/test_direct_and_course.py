"""The simulated model: accelerations undo the inverse model, stretches join, the closed loop is what a solver says."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

import haptid
from bench_identification import CASES, device_of, log_of, record, truth_of
from haptid import errors
from haptid.dynamics.forward import ForwardDynamics, ParametricForwardDynamics, sets_of
from haptid.dynamics.regressor import regressor_columns
from haptid.experiment import bench
from haptid.simulation import PID, Stretches, closed_loop, open_loop, sensitivity, smooth
from haptid.simulation.control import recorded
from mechanisms import mechanisms, states
from random_devices import as_device, parameters

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ARM, PHANTOM = "open arm, 3 joints", "PHANToM, one parallelogram"


def base_of(model):
    return np.asarray(model.device.parameters.S[:, list(model.base.independent_columns)])


@settings(deadline=None, max_examples=8)
@given(mechanisms(4), st.integers(0, 99))
def test_accelerations_undo_the_inverse_model(mechanism, seed):
    model = as_device(mechanism)
    chi = parameters(mechanism, model)
    raw = model.device.parameters.S @ chi
    c, cd, cdd = states(mechanism, 5, seed)
    beta = model.base.of(chi)
    forward = ForwardDynamics(model, raw)
    M, _ = forward.parts(c, cd)
    if np.linalg.cond(M).max() > 1e6:  # coordinates that hardly move anything
        return
    tau = haptid.inverse_dynamics(model, beta, c, cd, cdd)
    np.testing.assert_allclose(forward.acceleration(c, cd, tau), cdd, rtol=1e-6, atol=1e-6 * np.abs(cdd).max())


@pytest.mark.parametrize("name", ["five_bar", "cea_medical_branch"])
def test_slopes_are_those_of_differences(name):
    model, rng, step = haptid.DynamicModel(haptid.read_device(name)), np.random.default_rng(1), 1e-5
    c = model.device.row_map @ (
        model.device.closure.draw(rng, 9) if name == "five_bar" else rng.uniform(-0.3, 0.3, (3, 9))
    )
    cd, cdd = rng.normal(size=(2, *c.shape))
    forward = ForwardDynamics(model, np.abs(rng.normal(size=model.mechanism.columns)))
    found = forward.slopes(c, cd, cdd)
    for k, move in enumerate(step * np.eye(len(c))[:, :, None]):
        by_c = forward.inverse(c + move, cd, cdd) - forward.inverse(c - move, cd, cdd)
        by_cd = forward.inverse(c, cd + move, cdd) - forward.inverse(c, cd - move, cdd)
        for got, change in zip(found, (by_c, by_cd), strict=True):
            np.testing.assert_allclose(got[:, :, k].T, change / (2 * step), rtol=1e-5, atol=1e-5 * np.abs(got).max())


@pytest.mark.parametrize("name", ["five_bar", "phantom_premium_15", "cea_medical_branch"])
def test_loops_too_and_every_set_for_itself(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    rng = np.random.default_rng(0)
    c = model.device.row_map @ (
        model.device.closure.draw(rng, 6) if name == "five_bar" else rng.uniform(-0.3, 0.3, (3, 6))
    )
    cd = rng.normal(size=c.shape)
    raw = np.zeros((2, model.mechanism.columns))
    for k in range(2):
        for j in range(len(model.device.joints)):
            raw[k, 10 * j : 10 * j + 10] = [0.02 + k, 0, 0, 0.02 + k, 0, 0.03 + k, 0.01, 0, 0, 1.0]
        raw[k, 10 * len(model.device.joints) :] = 0.01
    tau = rng.normal(size=c.shape)
    both = ForwardDynamics(model, raw).acceleration(np.tile(c, 2), np.tile(cd, 2), np.tile(tau, 2))
    each = [ForwardDynamics(model, one).acceleration(c, cd, tau) for one in raw]
    np.testing.assert_allclose(both, np.concatenate(each, axis=1), rtol=1e-12)
    M, h = ForwardDynamics(model, raw[0]).parts(c, cd)
    np.testing.assert_allclose(np.einsum("sij,js->is", M, each[0]) + h.T, tau, atol=1e-9 * np.abs(h).max())


@given(st.integers(1, 60), st.integers(1, 30), st.integers(0, 30))
def test_stretches_own_every_sample_once(samples, length, settle):
    stretches = Stretches.of(samples, length, settle)
    assert sorted(stretches.sample[stretches.own]) == list(range(samples))
    values = stretches.sample[:, None, :].astype(float)
    np.testing.assert_array_equal(stretches.joined(values)[0], np.arange(samples))


def slide(tmp_path):
    """A mass on a rail with viscous friction: linear, so that its closed loop is a matrix exponential."""
    (tmp_path / "slide.toml").write_text(
        """
schema = 1
name = "slide"
gravity = [0.0, 0.0, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
type = "prismatic"
[[terms]]
kind = "viscous"
joints = "all"
"""
    )
    return haptid.DynamicModel(haptid.read_device(tmp_path / "slide.toml"))


def test_closed_loop_of_a_mass_is_the_exponential(tmp_path):
    model, mass, viscous, dt = slide(tmp_path), 2.0, 3.0, 2e-3
    target = np.sin(2 * np.pi * np.arange(1500) * dt)[:, None]
    law = PID(400.0, 40.0, 100.0, reference=(target,))
    beta = np.array([{"M1": mass, "FV1": viscous}[name] for name in model.base.names])
    motion = haptid.Motion(dt, target, np.zeros_like(target), haptid.Treatment(cutoff_hz=None))
    steps = closed_loop(ForwardDynamics(model, sets_of(model, beta)), law, motion, 0, Stretches.of(1500, 1500, 0))
    A = np.zeros((3, 3))
    A[0, 1], A[1, 1], A[1, 2] = 1.0, -viscous / mass, 1.0 / mass
    step = linalg.expm(A * dt)
    x, integral, found = np.array([steps.c[0, 0, 0], steps.cd[0, 0, 0]]), None, []
    speed = np.gradient(target[:, 0], dt)
    for r, v in zip(target[:, 0], speed, strict=True):
        if integral is None:  # begins as if it held friction and the rest asked for nothing
            integral = viscous * x[1] - 400 * (r - x[0]) - 40 * (v - x[1])
        integral += dt * 100 * (r - x[0])
        found.append(x[0])
        x = (step @ [*x, 400 * (r - x[0]) + 40 * (v - x[1]) + integral])[:2]
    np.testing.assert_allclose(steps.course(motion).c[0], found, atol=1e-10)


def test_the_open_loop_of_a_mass_falls_as_it_should(tmp_path):
    model, dt = slide(tmp_path), 1e-2
    beta = np.array([{"M1": 2.0, "FV1": 0.0}[name] for name in model.base.names])
    motion = haptid.Motion(dt, np.zeros((100, 1)), np.ones((100, 1)), haptid.Treatment(cutoff_hz=None))
    start = np.zeros((1, 1)), np.ones((1, 1))
    steps = open_loop(
        ForwardDynamics(model, sets_of(model, beta)), motion, np.ones((1, 100)), start, Stretches.of(100, 100, 0)
    )
    t = dt * np.arange(100)
    np.testing.assert_allclose(steps.course(motion).c[0], t + t**2 / 4, atol=1e-12)


@cache
def recording(name, seconds):
    """On the bench, exact."""
    return record(CASES[name], 1, None, seconds)


def simulated(name, share, stretch=400, settle=300, seconds=3.2):
    """Recording, and the model along it."""
    case = CASES[name]
    model, made = device_of(case), recording(name, seconds)
    log = haptid.Log("bench", "", made.t, made.position, made.command, log_of(case, made).channels)
    motion = haptid.treat(log, haptid.Treatment(cutoff_hz=60))
    law = PID(case.kp, case.kd, reference=(made.target,), velocity_cutoff_hz=100)
    forward = ForwardDynamics(smooth(model, [motion], share), sets_of(model, model.base.of(truth_of(case))))
    stretches = Stretches.of(len(motion), stretch, settle)
    return made, motion, law, forward, closed_loop(forward, law, motion, 0, stretches)


@pytest.mark.parametrize("name", [ARM, PHANTOM])
def test_the_closed_loop_is_that_of_the_bench(name):
    """MuJoCo with its own friction and steps: nearer as dry friction turns over faster; whatever the stretches."""
    away = []
    for share in (0.05, 0.01):
        made, motion, _, forward, steps = simulated(name, share)
        exact = forward.model.device.row_map @ made.q[:, list(forward.model.device.active)].T
        away.append(np.sqrt(((steps.course(motion).c - exact) ** 2).mean()))
    assert away[1] < 0.6 * away[0]
    assert away[1] < 2e-4  # 1.1e-4 rad of the arm: what friction that turns over within 1 % of the speed leaves


def test_short_stretches_are_the_whole():
    _, motion, _, _, whole = simulated(PHANTOM, 0.05, stretch=4000)
    *_, parts = simulated(PHANTOM, 0.05)
    apart = whole.course(motion).c - parts.course(motion).c
    assert np.abs(apart[:, 50:-50]).max() < 2e-6


def test_sensitivities_are_differences_of_simulations():
    _, motion, law, forward, steps = simulated(ARM, 0.05)
    model, base = forward.model, base_of(device_of(CASES[ARM]))
    made = sensitivity(forward, law, motion, steps, base)
    beta = device_of(CASES[ARM]).base.of(truth_of(CASES[ARM]))
    for k in (0, 4, 13, 17, 20):  # inertia, gravity, rotor, viscous, Coulomb
        h = 1e-5 * max(abs(beta[k]), 1e-3)
        sets = beta + h * np.array([[1.0], [-1.0]]) * np.eye(len(beta))[k]
        both = closed_loop(
            ForwardDynamics(model, sets_of(device_of(CASES[ARM]), sets)), law, motion, 0, steps.stretches
        )
        count = steps.stretches.count
        for exact, found in ((both.c, made.c[:, :, k]), (both.tau, made.tau[:, :, k])):
            slope = (exact[:, :, :count] - exact[:, :, count:]) / (2 * h)
            assert np.linalg.norm(found - slope) < 0.015 * np.linalg.norm(slope)  # half a control period's lag


def test_parameters_of_their_own_at_every_state():
    model = device_of(CASES[ARM])
    rng = np.random.default_rng(0)
    beta = model.base.of(truth_of(CASES[ARM])) * rng.uniform(0.9, 1.1, (4, len(model.base)))
    c, cd, tau = rng.uniform(-1, 1, (3, 3, 4))
    found = ParametricForwardDynamics(model, base_of(model)).acceleration(c, cd, tau, beta)
    each = [
        ForwardDynamics(model, sets_of(model, b)).acceleration(c[:, [k]], cd[:, [k]], tau[:, [k]])
        for k, b in enumerate(beta)
    ]
    np.testing.assert_allclose(found, np.concatenate(each, axis=1), rtol=1e-9)
    cdd, by_state, by_beta, inverse = ParametricForwardDynamics(model, base_of(model)).linearised(
        c[:, 0], cd[:, 0], tau[:, 0], beta[0]
    )
    np.testing.assert_allclose(cdd, found[:, 0], rtol=1e-9)
    M, _ = ForwardDynamics(model, sets_of(model, beta[0])).parts(c[:, :1], cd[:, :1])
    np.testing.assert_allclose(inverse @ M[0], np.eye(3), atol=1e-9)
    Y = regressor_columns(model, c[:, :1].copy(), cd[:, :1].copy(), np.ascontiguousarray(cdd[:, None]), base_of(model))[
        :, :, 0
    ]
    np.testing.assert_allclose(by_beta, -inverse @ Y, rtol=1e-8, atol=1e-8)
    assert by_state.shape == (3, 6)


def test_what_is_wrong_with_a_controller_is_said():
    made, motion, _, forward, _ = simulated(ARM, 0.05)
    stretches = Stretches.of(len(motion), 400, 0)

    def loop(**settings):
        return closed_loop(forward, PID(**{"kp": 300.0, "kd": 9.0, **settings}), motion, 0, stretches)

    for wrong, word in (
        ({"kp": (1.0, 2.0)}, "one for each of 1, 2, 3"),
        ({"kd": float("nan")}, "finite"),
        ({"rate_hz": 1500.0}, "multiple of the log's 1000 Hz"),
        ({"rate_hz": -1.0}, "above zero"),
        ({"reference": ()}, "one for each motion"),
        ({"reference": haptid.Signal(("target1", "target2", "target3"), "rad")}, "no file"),
    ):
        with pytest.raises(errors.SettingError, match=word):
            loop(**wrong)
    with pytest.raises(errors.ShapeError, match="reference"):
        loop(reference=(made.target[:5],))
    with pytest.raises(errors.SimulationError) as raised:
        loop(kp=-3000.0, reference=(made.target,))
    assert raised.value.found > raised.value.limit
    with pytest.raises(errors.SimulationError) as raised:
        closed_loop(ForwardDynamics(forward.model, 0 * forward.chi), PID(1.0, 1.0), motion, 0, stretches)
    assert raised.value.found < raised.value.limit


def test_a_limit_holds_the_torque():
    made, motion, _, forward, free = simulated(ARM, 0.05)
    limit = 0.5 * np.abs(free.tau).max(axis=(0, 2))
    law = PID(300.0, 9.0, reference=(made.target,), saturation=tuple(limit))
    held = closed_loop(forward, law, motion, 0, Stretches.of(len(motion), 400, 0))
    assert (np.abs(held.tau).max(axis=(0, 2)) <= limit * (1 + 1e-12)).all()
    assert not held.free.all()


def test_the_reference_is_read_from_the_log_s_own_file(tmp_path):

    text = (EXAMPLES / "phantom" / "experiment.toml").read_text().replace("seconds = 20.0", "seconds = 4.0")
    (tmp_path / "experiment.toml").write_text(text)
    job = bench.Job("phantom_premium_15", tmp_path / "experiment.toml", tmp_path / "log.parquet")
    bench.make_log(job)
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2", "q3"), "rad"),
        haptid.Signal(("command1", "command2", "command3"), "counts", "motor"),
        time="t",
    )
    log = haptid.read_log(job.out, channels, time_range=(1.0, 3.0))
    target = recorded(log, haptid.Signal(("target1", "target2", "target3"), "rad"))
    assert target.shape == log.position.T.shape
    assert np.abs(target - log.position.T).max() < 0.05
