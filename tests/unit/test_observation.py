"""An observation is the rows themselves, as far as any least squares can tell."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import haptid
from haptid.dynamics.regressor import rows
from haptid.errors import (
    IdentifiabilityError,
    LogMismatchError,
    ModelMismatchError,
    MotionTooShortError,
    NoRowsError,
    SettingError,
    SharedRowsError,
    TreatmentError,
)
from haptid.estimation import BlockJackknife
from haptid.observation import Block, concatenated
from haptid.observation.plan import shared_block
from motions import motion, truth


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def beta(model):
    return truth(model)


def dense(model, motion):
    """W and y without any of the observation's machinery, motor by motor, (3, n, p) and (3, n)."""
    N = model.device.coupling
    Y = rows(model, N @ motion.q.T, N @ motion.qd.T, N @ motion.qdd.T)
    W = np.einsum("ark,rp->akp", Y, model.device.parameters.S[:, list(model.base.independent_columns)])
    return W, motion.tau.T


def test_triangles_hold_the_dense_rows(model, beta):
    made = motion(model, beta, noise=0.1)
    observation = haptid.observe(model, made)
    W, y = dense(model, made)
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
    np.testing.assert_allclose(found.classical_covariance, variance * np.linalg.inv(stacked.T @ stacked), rtol=1e-7)


def test_weighted_least_squares_weighs_motors_by_their_residual(model, beta):
    made = motion(model, beta, noise=0.1)
    found = haptid.estimate(haptid.observe(model, made), haptid.WLS(passes=1))
    W, y = dense(model, made)
    first = np.linalg.lstsq(W.reshape(-1, len(beta)), y.ravel(), rcond=None)[0]
    reached = [motor.columns.size for motor in found.observation.motors]
    sigma = np.linalg.norm(y - W @ first, axis=1) / np.sqrt(y.shape[1] - np.array(reached))
    np.testing.assert_allclose(found.weights, 1 / sigma, rtol=1e-8)
    wanted = np.linalg.lstsq(
        (W / sigma[:, None, None]).reshape(-1, len(beta)), (y / sigma[:, None]).ravel(), rcond=None
    )[0]
    np.testing.assert_allclose(found.beta, wanted, rtol=1e-8)


def test_jackknife_is_what_refitting_without_each_block_gives(model, beta):
    """The brute-force road: leave a block out, fit again, look how far the estimate moved."""
    made = motion(model, beta, seconds=6.0, noise=0.1, phi=0.9)
    observation = haptid.observe(model, made)
    found = haptid.estimate(observation, haptid.OLS(), BlockJackknife())
    p, shifts, leverage = len(beta), [], []
    blocks = [(a, b) for a in range(3) for b in range(len(observation.blocks))]
    whole = observation.stack()
    inverse = np.linalg.inv(whole[:-1, :-1])

    def wide(a, b):
        motor = observation.motors[a]
        R = np.zeros((motor.r_factors.shape[1], p + 1))
        R[:, [*motor.columns, p]] = motor.r_factors[b]
        return R

    for left in blocks:
        rest = np.concatenate([wide(*block) for block in blocks if block != left])
        shifts.append(np.linalg.lstsq(rest[:, :-1], rest[:, -1], rcond=None)[0] - found.beta)
        leverage.append(((wide(*left)[:, :-1] @ inverse @ inverse.T) ** 2).sum(axis=0))
    shifts, leverage = np.array(shifts), np.array(leverage)
    np.testing.assert_allclose(found.covariance, (len(blocks) - 1) / len(blocks) * shifts.T @ shifts, rtol=1e-7)
    dof = leverage.sum(axis=0) ** 2 / (leverage**2).sum(axis=0) - 1
    np.testing.assert_allclose(found.dof, dof, rtol=1e-7)
    half = stats.t.ppf(0.975, dof) * np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(found.conf_int(), np.column_stack([found.beta - half, found.beta + half]), rtol=1e-9)
    half = stats.t.ppf(0.9, dof) * np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(found.conf_int(0.8), np.column_stack([found.beta - half, found.beta + half]), rtol=1e-9)
    assert found.parameters[1].conf_int(0.8) == tuple(found.conf_int(0.8)[1])


def test_observations_add_and_do_not_care_about_order(model, beta):
    one, other = (haptid.observe(model, motion(model, beta, seed=s, noise=0.1)) for s in (1, 2))
    both, back = one + other, other + one
    assert both.rows == one.rows + other.rows
    W = np.concatenate([dense(model, m)[0].reshape(-1, len(beta)) for m in both.motions])
    y = np.concatenate([dense(model, m)[1].ravel() for m in both.motions])
    found = haptid.estimate(both, haptid.OLS())
    np.testing.assert_allclose(found.beta, np.linalg.lstsq(W, y, rcond=None)[0], rtol=1e-8)
    np.testing.assert_allclose(haptid.estimate(back, haptid.OLS()).beta, found.beta, rtol=1e-9)


def test_the_same_rows_are_not_counted_twice(model, beta):
    observation = haptid.observe(model, motion(model, beta))
    with pytest.raises(SharedRowsError) as raised:
        observation + observation
    assert raised.value.where == observation.blocks[0].log


@given(
    st.lists(
        st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 12), st.integers(1, 4)), max_size=6),
        max_size=5,
    )
)
def test_a_shared_block_is_found_among_any_groups(groups):
    groups = [[Block(log, start, start + length) for log, start, length in group] for group in groups]

    def shares(one, other):
        return one.log == other.log and one.start < other.stop and other.start < one.stop

    truth = {
        one
        for group, others in itertools.permutations(groups, 2)
        for one, other in itertools.product(group, others)
        if shares(one, other)
    }
    found = shared_block(groups)
    assert found in truth if truth else found is None


def test_joining_many_observations_does_not_compare_every_pair_of_blocks(model, beta):
    """Work is counted by how often blocks are compared by their start."""
    compared = 0

    class Start(float):
        def __lt__(self, other):
            nonlocal compared
            compared += 1
            return float.__lt__(self, other)

    observation = haptid.observe(model, motion(model, beta))
    count = 200
    several = [
        replace(observation, blocks=tuple(Block(f"log {k}", Start(b.start), b.stop) for b in observation.blocks))
        for k in range(count)
    ]
    blocks = count * len(observation.blocks)
    whole = concatenated(several)
    assert len(whole.blocks) == blocks
    assert whole.rows == count * observation.rows
    assert compared < 3 * blocks * np.log2(blocks)


def test_rows_of_the_fit_are_rejected_as_unseen(model, beta):
    made = motion(model, beta, noise=0.1)
    found = haptid.estimate(haptid.observe(model, made), haptid.OLS())
    with pytest.raises(SharedRowsError) as raised:
        haptid.validate(found, made)
    assert raised.value.found[0] < raised.value.found[1]


def test_every_other_block_is_unseen_by_the_rest(model, beta):
    observation = haptid.observe(model, motion(model, beta, noise=0.1))
    even, odd = observation.alternate()
    assert even.rows + odd.rows == observation.rows
    assert even.shares_rows_with(odd) is None
    assert 5 < haptid.validate(haptid.estimate(even, haptid.OLS()), odd).relative < 15
    with pytest.raises(SharedRowsError):
        haptid.validate(haptid.estimate(even, haptid.OLS()), observation)


def test_validation_is_the_error_of_the_predicted_torque(model, beta):
    made, unseen = (motion(model, beta, seed=s, noise=0.1) for s in (1, 2))
    found = haptid.estimate(haptid.observe(model, made), haptid.OLS())
    validation = haptid.validate(found, unseen)
    W, y = dense(model, unseen)
    error = y - W @ found.beta
    assert validation.relative == pytest.approx(100 * np.linalg.norm(error) / np.linalg.norm(y))
    for k, motor in enumerate(validation.motors):
        assert motor.relative == pytest.approx(100 * np.linalg.norm(error[k]) / np.linalg.norm(y[k]))
        assert motor.rmse == pytest.approx(np.sqrt(np.mean(error[k] ** 2)))
    assert f"{validation.relative:.2f} %" in validation.summary()
    prediction = haptid.predict(found, unseen)
    np.testing.assert_allclose(prediction.predicted, W @ found.beta, atol=1e-12)


def test_prediction_passes_through_the_same_filter_as_the_rows(model, beta):
    """Filtering W beta is filtering W: the residual of the plots has the norm that the r_factors say."""
    treatment = haptid.Treatment(cutoff_hz=None, decimation=7, reversal_speed=0.05)
    made = motion(model, beta, noise=0.1, treatment=treatment)
    found = haptid.estimate(haptid.observe(model, made), haptid.WLS())
    prediction = haptid.predict(found, made)
    for k, motor in enumerate(found.observation.motors):
        used = prediction.used[k]
        assert used.sum() == motor.rows.sum()
        residual = (prediction.measured[k] - prediction.predicted[k])[used]
        assert motor.residual(found.beta) == pytest.approx(np.linalg.norm(residual), rel=1e-9)


def test_slow_rows_are_dropped_motor_by_motor(model, beta):
    treatment = haptid.Treatment(cutoff_hz=None, decimation=5, reversal_speed=(0.0, 0.2, 0.0))
    made = motion(model, beta, treatment=treatment)
    observation = haptid.observe(model, made)
    first, second, third = (motor.rows.sum() for motor in observation.motors)
    assert first == third
    assert second < first
    prediction = haptid.predict(haptid.estimate(observation, haptid.OLS()), made)
    speed = np.interp(prediction.t, made.t, np.abs(made.qd[:, 1]))
    assert speed[prediction.used[1]].min() >= 0.2 - 1e-3
    assert not prediction.used[1][speed < 0.19].any()


def test_blocks_of_a_long_motion_grow(model, beta, monkeypatch):
    monkeypatch.setattr("haptid.observation.plan.MOST_BLOCKS", 4)
    made = motion(model, beta, noise=0.1)
    observation = haptid.observe(model, made)
    assert len(observation.blocks) <= 4
    assert observation.blocks[0].stop - observation.blocks[0].start == pytest.approx(4.0)
    whole = haptid.estimate(observation, haptid.OLS()).beta
    monkeypatch.undo()
    np.testing.assert_allclose(haptid.estimate(haptid.observe(model, made), haptid.OLS()).beta, whole, rtol=1e-9)


def test_the_result_does_not_depend_on_the_segments(model, beta, monkeypatch):
    treatment = haptid.Treatment(cutoff_hz=None, decimation=5, reversal_speed=0.05)
    made = motion(model, beta, noise=0.1, treatment=treatment)
    whole = haptid.observe(model, made)
    monkeypatch.setattr("haptid.observation.plan.SEGMENT", 1500)
    parts = haptid.observe(model, made)
    for a, b in zip(whole.motors, parts.motors, strict=True):
        np.testing.assert_array_equal(a.rows, b.rows)
        np.testing.assert_allclose(a.r_factors, b.r_factors, atol=1e-13)


def test_several_motions_are_one_observation(model, beta):
    motions = [motion(model, beta, seed=seed) for seed in (1, 2)]
    first, second = (haptid.observe(model, each) for each in motions)
    for both in (haptid.observe(model, *motions), sum([first, second])):
        assert both.blocks == first.blocks + second.blocks
        np.testing.assert_array_equal(both.stack(), (first + second).stack())


def test_progress_runs_to_the_end(model, beta, monkeypatch):
    monkeypatch.setattr("haptid.observation.plan.SEGMENT", 1500)
    shares = []
    haptid.observe(model, motion(model, beta), progress=shares.append)
    assert len(shares) > 3
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_an_unexcited_parameter_is_named(model, beta):
    made = motion(model, beta)
    still = replace(made, q=made.q * [0, 1, 1], rates=tuple(rate * [0, 1, 1] for rate in made.rates))
    with pytest.raises(IdentifiabilityError) as raised:
        haptid.estimate(haptid.observe(model, still), haptid.OLS())
    assert raised.value.where.startswith(("ZZbaR", "XX", "FV1", "FC1"))


def test_too_few_rows(model, beta):
    made = motion(model, beta, seconds=0.004)
    with pytest.raises(NoRowsError) as raised:
        haptid.estimate(haptid.observe(model, made), haptid.OLS())
    assert (raised.value.found, raised.value.limit) == (12, 14)


def test_a_motor_that_is_always_slow(model, beta):
    made = motion(model, beta, treatment=haptid.Treatment(cutoff_hz=None, reversal_speed=1e3))
    with pytest.raises(NoRowsError) as raised:
        haptid.observe(model, made)
    assert raised.value.found == 0


def test_channels_that_do_not_fit_the_device(model, beta):
    made = motion(model, beta)
    with pytest.raises(LogMismatchError) as raised:
        haptid.observe(model, haptid.Motion(1e-3, made.q[:, :2], made.tau, made.treatment))
    assert (raised.value.where, raised.value.found, raised.value.limit) == ("position", 2, 3)
    with pytest.raises(LogMismatchError) as raised:
        haptid.observe(model, haptid.Motion(1e-3, made.q, made.tau[:, :1], made.treatment))
    assert (raised.value.where, raised.value.found, raised.value.limit) == ("torque", 1, 3)


def test_values_of_two_devices_are_kept_apart(model, beta):
    made = motion(model, beta, noise=0.1)
    found = haptid.estimate(haptid.observe(model, made), haptid.OLS())
    other = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    with pytest.raises(ModelMismatchError) as raised:
        haptid.validate(found, haptid.observe(other, motion(other, beta, seed=2)))
    assert raised.value.found == (model.device.name, other.device.name)
    with pytest.raises(ModelMismatchError):
        found.observation + haptid.observe(other, motion(other, beta, seed=2))


def test_what_one_block_alone_determines_has_no_interval(model, beta):
    """All of the motion in one block: without it nothing is left, so nothing says how far to trust it."""
    treatment = haptid.Treatment(cutoff_hz=None, block_s=1e300)
    made = motion(model, beta, noise=0.1, treatment=treatment)
    whole = haptid.observe(model, made)
    assert len(whole.blocks) == 8  # a block is never longer than an eighth of its motion
    assert np.isfinite(haptid.estimate(whole, haptid.OLS()).se).all()
    single = replace(whole, blocks=whole.blocks[:1], motors=tuple(m.pick(np.array([0])) for m in whole.motors))
    single_block = haptid.estimate(single, haptid.OLS())
    assert single_block.status == "uncertain"
    assert len(single_block.single_block) > 5
    assert np.isinf(single_block.se[list(single_block.single_block)]).all()
    assert np.isinf(single_block.conf_int()[list(single_block.single_block)]).all()
    assert "standard error cannot be estimated" in " ".join(single_block.notes)


def test_a_guard_reaches_beyond_the_filter(model, beta):
    """Without decimation there is no filter, and rows within the guard of a reversal are dropped all the same."""
    rows = []
    for guard in (None, 0.0, 0.05):
        treatment = haptid.Treatment(cutoff_hz=None, reversal_speed=0.05, reversal_guard_s=guard)
        rows.append(haptid.observe(model, motion(model, beta, treatment=treatment)).rows)
    assert rows[0] == rows[1]
    assert rows[2] < 0.9 * rows[1]


def test_low_speed_has_one_figure_or_one_for_each_row(model, beta):
    treatment = haptid.Treatment(cutoff_hz=None, reversal_speed=(0.1, 0.2))
    with pytest.raises(TreatmentError) as raised:
        haptid.observe(model, motion(model, beta, treatment=treatment))
    assert raised.value.where == "reversal_speed"


def test_a_decimation_longer_than_the_motion_is_rejected_before_any_work(model, beta):
    treatment = haptid.Treatment(cutoff_hz=None, decimation=10**9)
    with pytest.raises(MotionTooShortError) as raised:
        haptid.observe(model, motion(model, beta, treatment=treatment))
    assert raised.value.found < raised.value.limit


def test_rows_without_torque_have_no_weight(model, beta):
    made = motion(model, beta)
    with pytest.raises(IdentifiabilityError, match="zero"):
        haptid.estimate(haptid.observe(model, replace(made, tau=0 * made.tau)), haptid.WLS())


DIFFERENTIAL = """
schema = 1
name = "differential wrist"
gravity = [0.0, 0.0, -9.81]
convention = "modified-dh"
[[joints]]
name = "a"
alpha = "pi/2"
[[joints]]
name = "b"
alpha = "pi/2"
[[motors]]
name = "l"
drives = { a = 1, b = 1 }
[[motors]]
name = "r"
drives = { a = 1, b = -1 }
[[terms]]
kind = "coulomb"
joints = "all"
"""


@pytest.fixture
def differential(tmp_path):
    (tmp_path / "wrist.toml").write_text(DIFFERENTIAL)
    return haptid.DynamicModel(haptid.read_device(tmp_path / "wrist.toml"))


def test_both_joints_of_a_differential_are_guarded(differential):
    """Each motor feels both joints' friction: rows are dropped where either is slow."""
    assert [len(differential.coulomb_terms(row)) for row in (0, 1)] == [2, 2]
    treatment = haptid.Treatment(cutoff_hz=None, reversal_speed=0.2)
    made = motion(differential, np.ones(len(differential.base)), treatment=treatment)
    prediction = haptid.predict(haptid.estimate(haptid.observe(differential, made), haptid.OLS()), made)
    for joint in (0, 1):
        speed = np.interp(prediction.t, made.t, np.abs(made.qd[:, joint]))
        assert speed[prediction.used[0]].min() >= 0.19


def test_motor_and_joint_rows_are_the_same_model(differential, tmp_path):
    """Torques at the joints are the coupling's transpose times those at the motors, whatever the parameters."""
    text = DIFFERENTIAL + "[transmission]\ntorque_rows = 'joint'\n"
    (tmp_path / "joint.toml").write_text(text)
    joint = haptid.DynamicModel(haptid.read_device(tmp_path / "joint.toml"))
    assert joint.base.names == differential.base.names
    beta = np.random.default_rng(0).uniform(0.5, 1.5, len(joint.base))
    q, v, a = np.random.default_rng(1).normal(size=(3, 2, 30))
    at_motors = haptid.inverse_dynamics(differential, beta, q, v, a)
    np.testing.assert_allclose(
        haptid.inverse_dynamics(joint, beta, q, v, a), differential.device.coupling.T @ at_motors, atol=1e-12
    )


def test_what_only_acts_where_nothing_measures_has_no_effect(tmp_path):
    """Friction of a joint without motor, whose torque is nowhere measured, is no base parameter."""
    text = DIFFERENTIAL.split("[[motors]]")[0] + '[[motors]]\nname = "a"\n[[terms]]\nkind = "viscous"\njoints = "all"\n'
    (tmp_path / "free.toml").write_text(text)
    free = haptid.DynamicModel(haptid.read_device(tmp_path / "free.toml"))
    assert "FVb" in free.base.no_effect
    assert "FVa" in free.base.names
    assert free.device.measured == (True, False)


@pytest.mark.parametrize("passes", [0, 1.5, True])
def test_settings_of_the_weights_that_mean_nothing(passes):
    with pytest.raises(SettingError) as raised:
        haptid.WLS(passes)
    assert raised.value.where == "passes"
