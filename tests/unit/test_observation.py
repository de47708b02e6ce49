"""An observation is the rows themselves, as far as any least squares can tell."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import haptid
from haptid.errors import (
    ChannelCountError,
    DifferentModelError,
    NoRowsError,
    SameRowsError,
    SeenRowsError,
    TooFewRowsError,
    UnexcitedError,
)
from haptid.signals import rows
from motions import motion, truth


@pytest.fixture(scope="module")
def device():
    return haptid.read_device("phantom_premium_15")


@pytest.fixture(scope="module")
def beta(device):
    return truth(device)


def dense(device, motion):
    """W and y without any of the observation's machinery, motor by motor, (3, n, p) and (3, n)."""
    N = device.coupling
    Y = rows(device, N @ motion.q.T, N @ motion.qd.T, N @ motion.qdd.T)
    W = np.einsum("ark,rp->akp", Y, device.parameters.S[:, list(device.base.kept)])
    return W, motion.tau.T


def test_triangles_hold_the_dense_rows(device, beta):
    made = motion(device, beta, noise=0.1)
    observation = haptid.observe(device, made)
    W, y = dense(device, made)
    assert observation.rows == y.size
    for k, motor in enumerate(observation.motors):
        full = np.column_stack([W[k][:, motor.columns], y[k]])
        np.testing.assert_allclose(motor.whole.T @ motor.whole, full.T @ full, rtol=1e-10, atol=1e-14)
        assert motor.norm == pytest.approx(np.linalg.norm(y[k]))
        assert motor.residual(beta) == pytest.approx(np.linalg.norm(y[k] - W[k] @ beta))
    stacked, z = W.reshape(-1, len(beta)), y.ravel()
    singular = np.linalg.svd(stacked, compute_uv=False)
    assert observation.condition[0] == pytest.approx(singular[0] / singular[-1], rel=1e-9)
    found = haptid.estimate(observation, haptid.OLS())
    wanted, rest, *_ = np.linalg.lstsq(stacked, z, rcond=None)
    np.testing.assert_allclose(found.beta, wanted, rtol=1e-9)
    variance = rest[0] / (len(z) - len(beta))
    np.testing.assert_allclose(found.textbook_covariance, variance * np.linalg.inv(stacked.T @ stacked), rtol=1e-7)


def test_weighted_least_squares_weighs_motors_by_their_residual(device, beta):
    made = motion(device, beta, noise=0.1)
    found = haptid.estimate(haptid.observe(device, made), haptid.WLS(passes=1))
    W, y = dense(device, made)
    first = np.linalg.lstsq(W.reshape(-1, len(beta)), y.ravel(), rcond=None)[0]
    reached = [motor.columns.size for motor in found.observation.motors]
    sigma = np.linalg.norm(y - W @ first, axis=1) / np.sqrt(y.shape[1] - np.array(reached))
    np.testing.assert_allclose(found.weights, 1 / sigma, rtol=1e-8)
    wanted = np.linalg.lstsq(
        (W / sigma[:, None, None]).reshape(-1, len(beta)), (y / sigma[:, None]).ravel(), rcond=None
    )[0]
    np.testing.assert_allclose(found.beta, wanted, rtol=1e-8)


def test_jackknife_is_what_refitting_without_each_block_gives(device, beta):
    """The brute-force road: leave a block out, fit again, look how far the estimate moved."""
    made = motion(device, beta, seconds=6.0, noise=0.1, phi=0.9)
    observation = haptid.observe(device, made)
    found = haptid.estimate(observation, haptid.OLS())
    p, shifts, leverage = len(beta), [], []
    blocks = [(a, b) for a in range(3) for b in range(len(observation.blocks))]
    whole = observation.stack()
    inverse = np.linalg.inv(whole[:-1, :-1])

    def wide(a, b):
        motor = observation.motors[a]
        R = np.zeros((motor.triangles.shape[1], p + 1))
        R[:, [*motor.columns, p]] = motor.triangles[b]
        return R

    for left in blocks:
        rest = np.concatenate([wide(*block) for block in blocks if block != left])
        shifts.append(np.linalg.lstsq(rest[:, :-1], rest[:, -1], rcond=None)[0] - found.beta)
        leverage.append(((wide(*left)[:, :-1] @ inverse @ inverse.T) ** 2).sum(axis=0))
    shifts, leverage = np.array(shifts), np.array(leverage)
    np.testing.assert_allclose(found.covariance, (len(blocks) - 1) / len(blocks) * shifts.T @ shifts, rtol=1e-7)
    freedom = leverage.sum(axis=0) ** 2 / (leverage**2).sum(axis=0) - 1
    np.testing.assert_allclose(found.freedom, freedom, rtol=1e-7)
    half = stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(found.interval95, np.column_stack([found.beta - half, found.beta + half]), rtol=1e-9)


def test_observations_add_and_do_not_care_about_order(device, beta):
    one, other = (haptid.observe(device, motion(device, beta, seed=s, noise=0.1)) for s in (1, 2))
    both, back = one + other, other + one
    assert both.rows == one.rows + other.rows
    W = np.concatenate([dense(device, m)[0].reshape(-1, len(beta)) for m in both.motions])
    y = np.concatenate([dense(device, m)[1].ravel() for m in both.motions])
    found = haptid.estimate(both, haptid.OLS())
    np.testing.assert_allclose(found.beta, np.linalg.lstsq(W, y, rcond=None)[0], rtol=1e-8)
    np.testing.assert_allclose(haptid.estimate(back, haptid.OLS()).beta, found.beta, rtol=1e-9)


def test_the_same_rows_are_not_counted_twice(device, beta):
    observation = haptid.observe(device, motion(device, beta))
    with pytest.raises(SameRowsError, match="twice"):
        observation + observation


def test_rows_of_the_fit_are_refused_as_unseen(device, beta):
    made = motion(device, beta, noise=0.1)
    found = haptid.estimate(haptid.observe(device, made), haptid.OLS())
    with pytest.raises(SeenRowsError, match="in the fit"):
        haptid.validate(found, made)


def test_every_other_block_is_unseen_by_the_rest(device, beta):
    observation = haptid.observe(device, motion(device, beta, noise=0.1))
    even, odd = observation.alternate()
    assert even.rows + odd.rows == observation.rows
    assert even.shares_rows_with(odd) is None
    assert 5 < haptid.validate(haptid.estimate(even, haptid.OLS()), odd).relative < 15
    with pytest.raises(SeenRowsError):
        haptid.validate(haptid.estimate(even, haptid.OLS()), observation)


def test_validation_is_the_error_of_the_predicted_torque(device, beta):
    made, unseen = (motion(device, beta, seed=s, noise=0.1) for s in (1, 2))
    found = haptid.estimate(haptid.observe(device, made), haptid.OLS())
    validation = haptid.validate(found, unseen)
    W, y = dense(device, unseen)
    error = y - W @ found.beta
    assert validation.relative == pytest.approx(100 * np.linalg.norm(error) / np.linalg.norm(y))
    for k, motor in enumerate(validation.motors):
        assert motor.relative == pytest.approx(100 * np.linalg.norm(error[k]) / np.linalg.norm(y[k]))
        assert motor.rmse == pytest.approx(np.sqrt(np.mean(error[k] ** 2)))
    assert f"{validation.relative:.2f} %" in validation.summary()
    prediction = haptid.predict(found, unseen)
    np.testing.assert_allclose(prediction.predicted, W @ found.beta, atol=1e-12)


def test_prediction_passes_through_the_same_filter_as_the_rows(device, beta):
    """Filtering W beta is filtering W: the residual of the plots has the norm that the triangles say."""
    treatment = haptid.Treatment(cutoff_hz=None, decimation=7, low_speed=0.05)
    made = motion(device, beta, noise=0.1, treatment=treatment)
    found = haptid.estimate(haptid.observe(device, made), haptid.WLS())
    prediction = haptid.predict(found, made)
    for k, motor in enumerate(found.observation.motors):
        used = prediction.used[k]
        assert used.sum() == motor.rows.sum()
        residual = (prediction.measured[k] - prediction.predicted[k])[used]
        assert motor.residual(found.beta) == pytest.approx(np.linalg.norm(residual), rel=1e-9)


def test_slow_rows_are_dropped_motor_by_motor(device, beta):
    treatment = haptid.Treatment(cutoff_hz=None, decimation=5, low_speed=(0.0, 0.2, 0.0))
    made = motion(device, beta, treatment=treatment)
    observation = haptid.observe(device, made)
    first, second, third = (motor.rows.sum() for motor in observation.motors)
    assert first == third
    assert second < first
    prediction = haptid.predict(haptid.estimate(observation, haptid.OLS()), made)
    speed = np.interp(prediction.t, made.t, np.abs(made.qd[:, 1]))
    assert speed[prediction.used[1]].min() >= 0.2 - 1e-3
    assert not prediction.used[1][speed < 0.19].any()


def test_blocks_of_a_long_motion_grow(device, beta, monkeypatch):
    monkeypatch.setattr("haptid.observation.MOST_BLOCKS", 4)
    made = motion(device, beta, noise=0.1)
    observation = haptid.observe(device, made)
    assert len(observation.blocks) <= 4
    assert observation.blocks[0].stop - observation.blocks[0].start == pytest.approx(4.0)
    whole = haptid.estimate(observation, haptid.OLS()).beta
    monkeypatch.undo()
    np.testing.assert_allclose(haptid.estimate(haptid.observe(device, made), haptid.OLS()).beta, whole, rtol=1e-9)


def test_the_result_does_not_depend_on_the_segments(device, beta, monkeypatch):
    treatment = haptid.Treatment(cutoff_hz=None, decimation=5, low_speed=0.05)
    made = motion(device, beta, noise=0.1, treatment=treatment)
    whole = haptid.observe(device, made)
    monkeypatch.setattr("haptid.observation.SEGMENT", 1500)
    parts = haptid.observe(device, made)
    for a, b in zip(whole.motors, parts.motors, strict=True):
        np.testing.assert_array_equal(a.rows, b.rows)
        np.testing.assert_allclose(a.triangles, b.triangles, atol=1e-13)


def test_progress_runs_to_the_end(device, beta, monkeypatch):
    monkeypatch.setattr("haptid.observation.SEGMENT", 1500)
    shares = []
    haptid.observe(device, motion(device, beta), progress=shares.append)
    assert len(shares) > 3
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_an_unexcited_parameter_is_named(device, beta):
    made = motion(device, beta)
    still = replace(made, q=made.q * [0, 1, 1], rates=tuple(rate * [0, 1, 1] for rate in made.rates))
    with pytest.raises(UnexcitedError, match=r"(ZZbaR|XX|FV1|FC1).*not excited"):
        haptid.estimate(haptid.observe(device, still), haptid.OLS())


def test_too_few_rows(device, beta):
    made = motion(device, beta, seconds=0.004)
    with pytest.raises(TooFewRowsError, match="12 rows cannot tell 14"):
        haptid.estimate(haptid.observe(device, made), haptid.OLS())


def test_a_motor_that_is_always_slow(device, beta):
    made = motion(device, beta, treatment=haptid.Treatment(cutoff_hz=None, low_speed=1e3))
    with pytest.raises(NoRowsError, match="low_speed"):
        haptid.observe(device, made)


def test_channels_that_do_not_fit_the_device(device, beta):
    made = motion(device, beta)
    with pytest.raises(ChannelCountError, match=r"2 position channels.*wants 3"):
        haptid.observe(device, haptid.Motion(1e-3, made.q[:, :2], made.tau, made.treatment))
    with pytest.raises(ChannelCountError, match=r"1 torque channels.*wants 3"):
        haptid.observe(device, haptid.Motion(1e-3, made.q, made.tau[:, :1], made.treatment))


def test_values_of_two_devices_are_kept_apart(device, beta):
    made = motion(device, beta, noise=0.1)
    found = haptid.estimate(haptid.observe(device, made), haptid.OLS())
    other = haptid.read_device("phantom_premium_15")
    with pytest.raises(DifferentModelError, match="two devices"):
        haptid.validate(found, haptid.observe(other, motion(other, beta, seed=2)))
    with pytest.raises(DifferentModelError):
        found.observation + haptid.observe(other, motion(other, beta, seed=2))
