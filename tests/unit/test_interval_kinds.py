"""Covariance estimators other than the default: their definitions, and what they share."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, optimize, stats

import haptid
from haptid import errors
from haptid.estimation import (
    GLS,
    TLS,
    BlockJackknife,
    Bootstrap,
    Bounds,
    Classical,
    ClusterRobust,
    EqualityConstraints,
    FixedB,
    Profile,
    Ridge,
    Sandwich,
)
from haptid.estimation.intervals.model_based import burg
from haptid.estimation.least_squares import solve
from haptid.observation.rows import Rows
from motions import motion, truth

KINDS = [ClusterRobust(), BlockJackknife(), Classical(), FixedB(), Bootstrap(99), Sandwich()]


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def observation(model):
    return haptid.observe(model, motion(model, truth(model), seconds=10.0, dt=2e-3, noise=0.1, phi=0.8))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_kinds_say_how_far_the_same_estimate_may_be_off(observation, kind):
    plain = haptid.estimate(observation, haptid.WLS())
    found = haptid.estimate(observation, haptid.WLS(), kind)
    np.testing.assert_array_equal(found.beta, plain.beta)
    assert np.linalg.eigvalsh(found.covariance / np.outer(found.se, found.se))[0] > -1e-9
    assert (found.dof >= 1).all()
    assert found.intervals.name == kind.name


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("method", [haptid.WLS(), GLS(), TLS(), Ridge(strength=1.0)], ids=lambda method: method.name)
def test_combinations_have_the_deviations_of_their_covariance(model, kind, method):
    made = haptid.observe(model, motion(model, truth(model), seconds=8.0, dt=2e-3, noise=0.01))
    found = haptid.estimate(made, method, kind)
    C = np.random.default_rng(0).normal(size=(3, len(found.beta)))
    spread = found.spread(C)
    expected = C @ found.covariance @ C.T
    np.testing.assert_allclose(spread.covariance, expected, rtol=1e-6, atol=1e-9 * expected.max())


def test_of_a_white_residual_all_are_about_the_classical(model):
    made = haptid.observe(model, motion(model, truth(model), seconds=30.0, dt=4e-3, noise=0.1))
    classical = haptid.estimate(made, haptid.WLS(), Classical()).se
    for kind in KINDS:
        ratio = haptid.estimate(made, haptid.WLS(), kind).se / classical
        assert 0.8 < np.median(ratio) < 1.25, kind.name


def test_the_sandwich_is_the_sandwich(observation):
    """All rows in memory, with the covariance of the residual's models as Toeplitz matrices."""
    found = haptid.estimate(observation, haptid.WLS(), Sandwich())
    (rows,) = Rows(observation)
    middle = np.zeros((len(found.beta),) * 2)
    e = rows.residual(found.beta)
    for motor, W, own, weight in zip(observation.motors, rows.W, e, found.weights, strict=True):
        other_model, n = burg([own], 20), W.shape[0]
        gamma = np.fft.irfft(other_model.spectrum(1 << 16), 1 << 16)[:n]
        taken = n / (n - len(motor.columns))
        middle += weight**4 * taken * W.T @ linalg.matmul_toeplitz(gamma, W)
    R = observation.stack(found.weights)[:-1, :-1]
    bread = np.linalg.inv(R.T @ R)
    np.testing.assert_allclose(found.se, np.sqrt(np.diag(bread @ middle @ bread)), rtol=1e-3)


def test_the_jackknife_of_a_fit_with_a_prior_is_that_of_fits_without_each_block(model):
    made = haptid.observe(model, motion(model, truth(model), seconds=8.0, dt=2e-3, noise=0.1))
    method = Ridge(strength=1.0)
    found = haptid.estimate(made, method, BlockJackknife())
    known = method.knowledge(made)
    shifts = []
    for m, motor in enumerate(made.motors):
        for b in range(len(motor.rows)):
            r_factors = np.array(motor.r_factors)
            r_factors[b] = 0.0
            less = replace(motor, r_factors=r_factors, rows=np.where(np.arange(len(motor.rows)) == b, 0, motor.rows))
            motors = (*made.motors[:m], less, *made.motors[m + 1 :])
            shifts.append(solve(replace(made, motors=motors), found.weights, (), known).beta - found.beta)
    many = len(shifts)
    outer = np.array(shifts).T @ np.array(shifts) * (many - 1) / many
    root = found.fit.solution.root
    pull = root @ found.fit.solution.pull.T
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(outer + pull @ pull.T), rtol=1e-6)


def test_fixed_b_with_all_cosines_is_the_variance_of_independent_blocks(observation):
    found = haptid.estimate(observation, haptid.WLS(), FixedB(share=1.0))
    moments = found.fit.moments
    series = np.zeros((len(observation.blocks), len(found.beta)))
    np.add.at(series, moments.block, moments.leave_out_shifts @ found.fit.solution.root.T)
    n = len(series)
    np.testing.assert_allclose(found.covariance, n * np.cov(series, rowvar=False), rtol=1e-6)


def test_the_bootstrap_of_a_seed_is_the_same_again(observation):
    a, b = (haptid.estimate(observation, haptid.WLS(), Bootstrap(50, seed=3)) for _ in range(2))
    np.testing.assert_array_equal(a.covariance, b.covariance)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_what_is_known_exactly_has_no_deviation(observation, kind):
    found = haptid.estimate(observation, EqualityConstraints({"FC1": 0.02}), kind)
    assert found["FC1"].value == pytest.approx(0.02)
    assert found["FC1"].se == pytest.approx(0.0, abs=1e-12)


# --- profile likelihood -----------------------------------------------------------------------------------------


def test_a_profile_is_the_cluster_robust_interval_where_no_limit_is_near(observation):
    plain = haptid.estimate(observation, haptid.WLS())
    far = {name: (float(b) - 1e3, None) for name, b in zip(plain.base.names, plain.beta, strict=True)}
    found = haptid.estimate(observation, Bounds(far), Profile())
    np.testing.assert_allclose(found.conf_int(), plain.conf_int(), rtol=1e-5)


def test_a_profile_near_a_limit_is_narrower_and_stays_within(observation):
    plain = haptid.estimate(observation, haptid.WLS())
    k = plain.base.names.index("FC2")
    low = float(plain.beta[k] + plain.se[k])
    cut = haptid.estimate(observation, Bounds({"FC2": (low, None)}))
    found = haptid.estimate(observation, Bounds({"FC2": (low, None)}), Profile())
    ends = found.conf_int()
    assert ends[k, 0] == pytest.approx(low, rel=1e-6)
    width = np.diff(ends, axis=1) / np.diff(cut.conf_int(), axis=1)
    assert width.max() < 1.5
    assert width.min() < 0.9
    assert (ends[:, 0] <= found.beta).all()
    assert (found.beta <= ends[:, 1]).all()


@pytest.mark.parametrize("level", [0.8, 0.95, 0.99])
def test_ends_of_a_profile_are_where_the_best_fit_is_too_bad(observation, level):
    """By definition, with a solver of its own: the best fit with the parameter at an end, the others within limits.

    Unless the end of the unconstrained interval comes first.
    """
    plain = haptid.estimate(observation, haptid.WLS())
    j = plain.base.names.index("FC2")
    limit = float(plain.beta[j] + plain.se[j])
    found = haptid.estimate(observation, Bounds({"FC2": (limit, None)}), Profile())
    R, free = found.fit.solution.R, plain.beta
    others = np.arange(len(free)) != np.arange(len(free))[:, None]

    def best(k, value):
        low = np.where(np.arange(len(free)) == j, limit, -np.inf)[others[k]]
        y = R @ free - R[:, k] * value
        return 2 * optimize.lsq_linear(R[:, others[k]], y, (low, np.inf), tol=1e-14, lsmr_tol="auto").cost

    half = stats.t.ppf((1 + level) / 2, plain.dof) * plain.se
    limits = np.sum((R @ (found.beta - free)) ** 2) + (half / np.linalg.norm(found.fit.solution.root, axis=1)) ** 2
    ends = plain.conf_int(level)

    def is_an_end(k, value, side):
        if value == pytest.approx(ends[k, side], rel=1e-9):
            return best(k, value) <= limits[k] * (1 + 1e-4)
        return best(k, value) == pytest.approx(limits[k], rel=1e-4)

    for k, (low, high) in enumerate(found.conf_int(level)):
        assert is_an_end(k, high, 1)
        assert low == pytest.approx(limit, rel=1e-6) if k == j else is_an_end(k, low, 0)


@pytest.mark.parametrize("level", [0.5, 0.8, 0.99])
def test_an_interval_within_bounds_is_the_free_one_cut_and_widened(observation, level):
    plain = haptid.estimate(observation, haptid.WLS())
    j = plain.base.names.index("FC2")
    limit = float(plain.beta[j] + plain.se[j])
    found = haptid.estimate(observation, Bounds({"FC2": (limit, None)}))
    low, high = plain.conf_int(level).T
    low = np.where(np.arange(len(low)) == j, np.maximum(low, limit), low)
    high = np.where(np.arange(len(low)) == j, np.maximum(high, limit), high)
    expected = np.column_stack([np.minimum(low, found.beta), np.maximum(high, found.beta)])
    np.testing.assert_allclose(found.conf_int(level), expected, rtol=1e-12)


def test_a_profile_of_what_is_not_constrained_is_rejected(observation):
    found = haptid.estimate(observation, haptid.WLS())
    with pytest.raises(errors.SettingError) as raised:
        Profile().limits(found.fit, found.constrained_fit, found.se)
    assert raised.value.where == "method"


@pytest.mark.parametrize("make", [lambda: FixedB(0.0), lambda: FixedB(1.5), lambda: Bootstrap(1), lambda: Sandwich(-1)])
def test_settings_of_intervals_out_of_range_are_rejected(make):
    with pytest.raises(errors.SettingError):
        make()
