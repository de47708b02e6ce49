"""Estimators with a simulated model: the truth lies in their intervals; noise in the columns biases them less."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import haptid
from bench_identification import CASES, device_of, log_of, record, truth_of
from haptid import errors, estimation
from haptid.estimation.least_squares import solve
from haptid.estimation.methods.instrumental import second_stage
from haptid.estimation.methods.kalman import FilterState, information_rows
from haptid.estimation.methods.simulation_based import simulate_along
from haptid.experiment import bench
from haptid.observation.rows import Rows
from haptid.simulation import PID

ARM, PHANTOM = "open arm, 3 joints", "PHANToM, one parallelogram"
# Share of a log that is left out at either end, samples.
ENDS = 1000


@cache
def made(name, seed=1):
    """Log behind encoders, its controller, and the truth."""
    case = CASES[name]
    read = record(case, seed, 4000, 8.0, bench.Physics(5e-4))
    law = PID(case.kp, case.kd, reference=(read.target[ENDS:-ENDS],), velocity_cutoff_hz=100)
    return device_of(case), log_of(case, read), law, device_of(case).base.of(truth_of(case))


@cache
def observed(name, cutoff_hz, decimation):
    model, log, _, _ = made(name)
    treatment = haptid.Treatment(cutoff_hz=cutoff_hz, decimation=decimation, torque_delay_s=5e-4, reversal_speed=0.05)
    return haptid.observe(model, haptid.treat(log, treatment))


@pytest.mark.parametrize(
    ("name", "kind"),
    [(ARM, estimation.IV), (PHANTOM, estimation.DIDIM), (PHANTOM, estimation.CLIE), (ARM, estimation.CLOE)],
)
def test_the_closed_loop_gives_the_truth_back(name, kind):
    _, _, law, beta = made(name)
    found = haptid.estimate(observed(name, 30, 10), kind(law))
    low, high = found.conf_int().T
    assert ((low <= beta) & (beta <= high)).mean() >= 0.7
    assert (np.abs(found.beta - beta) <= 6 * found.se).all()
    assert haptid.fit_errors(found).relative < 1.2
    assert found.method.name == kind.__name__


@pytest.mark.parametrize("method", [estimation.OutputErrorMethod(), estimation.EKF(torque_noise=(0.05,) * 3)])
def test_the_open_loop_and_the_filter_come_near(method):
    """Dry friction that turns over smoothly costs them a little: stated in the documentation."""
    _, _, _, beta = made(ARM)
    found = haptid.estimate(observed(ARM, 30, 10), method)
    low, high = found.conf_int().T
    if isinstance(method, estimation.EKF):
        assert np.isinf(found.se).all()
        assert found.status == "ok"
        assert any("point estimates only" in note for note in found.notes)
    else:
        assert ((low <= beta) & (beta <= high)).mean() >= 0.6
    assert haptid.fit_errors(found).relative < 1.2
    assert np.median(np.abs(found.beta / beta - 1)) < 0.03


def test_noise_in_the_columns_biases_least_squares_and_not_the_others():
    """Encoders at half the rate, differentiated up to 90 Hz: the mean error of three logs, in which scatter is less."""
    away = {}
    for seed in (1, 2, 3):
        model, log, law, beta = made(PHANTOM, seed)
        half = haptid.Log(log.path, "", log.t[::2], log.position[::2], log.torque[::2], log.channels)
        law = PID(law.kp, law.kd, reference=(law.reference[0][::2],), velocity_cutoff_hz=100, rate_hz=1000)
        motion = haptid.treat(half, haptid.Treatment(cutoff_hz=90, torque_delay_s=5e-4))
        observation = haptid.observe(model, motion)
        carried = np.sqrt((observation.stack()[:-1, :-1] ** 2).sum(axis=0))
        for method in (haptid.OLS(), estimation.DIDIM(law)):
            found = haptid.estimate(observation, method)
            away.setdefault(method.name, []).append(carried * (found.beta - beta))
    bias = {name: np.linalg.norm(np.mean(errors, axis=0)) for name, errors in away.items()}
    assert bias["DIDIM"] < bias["OLS"] / 2  # benchmarks/noisy_columns.py has the bias of many logs


def test_instruments_that_are_the_columns_change_nothing():
    observation = observed(ARM, 30, 10)
    weights = haptid.WLS().weights(observation)
    free = solve(observation, weights)
    rows = second_stage(observation, observation, weights)
    np.testing.assert_allclose(solve(rows, weights).beta, free.beta, rtol=1e-8, atol=1e-10)


def test_two_stages_are_the_classical_one():
    """(Z'W)^-1 Z'y, instruments of another filter."""
    log = made(ARM)[1]
    calm = haptid.treat(log, haptid.Treatment(cutoff_hz=12, decimation=10, torque_delay_s=5e-4, reversal_speed=0.05))
    observation = observed(ARM, 30, 10)
    instruments = simulate_along(
        observation, [haptid.treat(replace(log, position=calm.q), observation.motions[0].treatment)]
    )
    weights, p = np.ones(3), len(observation.base)
    parts = list(zip(Rows(observation), Rows(instruments), strict=True))
    W, y = (
        np.concatenate([x.reshape(-1, n) for x in xs])
        for n, xs in ((p, [s.W for s, _ in parts]), (1, [s.y for s, _ in parts]))
    )
    Z = np.concatenate([(z.W * s.used[:, :, None]).reshape(-1, p) for s, z in parts])
    beta = np.linalg.solve(Z.T @ W, Z.T @ y)
    found = solve(second_stage(observation, instruments, weights), weights).beta
    np.testing.assert_allclose(found, beta.ravel(), rtol=1e-5, atol=1e-7)


def test_a_robust_fit_inside_and_a_possible_one_around():
    _, _, law, beta = made(ARM)
    observation = observed(ARM, 30, 10)
    for method in (
        estimation.DIDIM(law, weighting=estimation.IRLS(), tolerance=0.5),
        estimation.PhysicallyConsistent(estimation.DIDIM(law)),
    ):
        found = haptid.estimate(observation, method)
        assert haptid.fit_errors(found).relative < 1.2
        assert np.median(np.abs(found.beta / beta - 1)) < 0.02
    assert found.feasible.ok


def test_a_measurement_is_kalman_s():
    rng = np.random.default_rng(0)
    S, x, noise = np.tril(rng.normal(size=(5, 5))) + 3 * np.eye(5), rng.normal(size=5), np.array([0.3, 0.5])
    after = FilterState(x, S).updated(np.array([1.0, -1.0]), noise)
    P, H = S @ S.T, np.eye(2, 5)
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(noise**2))
    np.testing.assert_allclose(after.x, x + gain @ (np.array([1.0, -1.0]) - x[:2]), rtol=1e-10)
    np.testing.assert_allclose(after.S @ after.S.T, (np.eye(5) - gain @ H) @ P, rtol=1e-8, atol=1e-10)
    rows = information_rows(FilterState(x, S).information(2), after.information(2))
    more = after.information(2)[0] - FilterState(x, S).information(2)[0]
    np.testing.assert_allclose(rows[:2, :2].T @ rows[:2, :2], more, rtol=1e-6, atol=1e-9)


def test_what_is_missing_is_reported():
    observation = observed(ARM, 30, 10)
    for kind in (estimation.IV, estimation.DIDIM, estimation.CLIE, estimation.CLOE):
        with pytest.raises(errors.SettingError) as raised:
            haptid.estimate(observation, kind())
        assert raised.value.where == "controller"
    law = made(ARM)[2]
    with pytest.raises(errors.SettingError, match="one for each of 1, 2, 3"):
        haptid.estimate(observation, estimation.IV(PID((1.0, 2.0), 1.0)))
    with pytest.raises(errors.ConvergenceError) as moved:
        haptid.estimate(observation, estimation.DIDIM(law, most=1, tolerance=1e-9))
    assert moved.value.found > moved.value.limit == 1e-9
    for wrong in ({"most": 0}, {"tolerance": -1.0}, {"segment": float("inf")}):
        with pytest.raises(errors.SettingError):
            estimation.DIDIM(law, **wrong)
    for wrong in ({"widen": 0.0}, {"torque_noise": (0.0, 1.0, 1.0)}):
        with pytest.raises(errors.SettingError):
            estimation.EKF(**wrong)
    with pytest.raises(errors.SettingError) as rows:
        haptid.estimate(observation, estimation.OutputErrorMethod(), estimation.Sandwich())
    assert rows.value.where == "OutputErrorMethod"
    with pytest.raises(errors.SettingError) as noise:
        haptid.estimate(observation, estimation.EKF(torque_noise=(1.0,)))
    assert noise.value.where == "torque_noise"
