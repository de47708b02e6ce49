"""Elimination: zero parameters are eliminated, needed ones stay, and the F-test has its level."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import haptid
from haptid import errors
from haptid.dynamics.regressor import rows
from haptid.estimation.methods.constrained import FixedAtZero
from haptid.inference.elimination import (
    BackwardElimination,
    GautierRatio,
    MaxRelativeStd,
    eliminate,
    eliminate_by_motor,
    rao_scott_test,
    refit_without,
)
from motions import motion, truth

ZERO = ("FV1", "FV2", "FC3")


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def with_zeros(model):
    beta = truth(model)
    beta[[model.base.names.index(name) for name in ZERO]] = 0.0
    return beta


def fitted(model, seed=1, method=None, **noise):
    made = motion(model, with_zeros(model), seconds=15.0, dt=4e-3, seed=seed, **noise)
    return haptid.estimate(haptid.observe(model, made), method or haptid.WLS())


def explicit(model, made):
    """W and y of a motion with exact rates, stored."""
    c, cd, cdd = made.kinematics(0, len(made))
    W = np.einsum(
        "apk,pb->kab", rows(model, c, cd, cdd), model.device.parameters.S[:, list(model.base.independent_columns)]
    )
    return W.reshape(-1, len(model.base)), made.tau.reshape(-1)


def test_reduced_estimate_is_least_squares_on_the_columns_kept(model):
    full = fitted(model, method=haptid.OLS(), noise=0.05)
    W, y = explicit(model, full.observation.motions[0])
    reduced = refit_without(full, ZERO)
    wanted, rest, *_ = np.linalg.lstsq(W[:, reduced.free_parameters], y, rcond=None)
    np.testing.assert_allclose(reduced.beta[list(reduced.free_parameters)], wanted, rtol=1e-9)
    assert (reduced.beta[list(reduced.zero)] == 0).all()
    assert (reduced.se[list(reduced.zero)] == 0).all()
    deviation = np.sqrt(
        np.diag(np.linalg.inv(W[:, reduced.free_parameters].T @ W[:, reduced.free_parameters]))
        * rest
        / (len(y) - len(reduced.free_parameters))
    )
    classical = np.sqrt(np.diag(reduced.classical_covariance))[list(reduced.free_parameters)]
    np.testing.assert_allclose(classical, deviation, rtol=1e-9)


def test_leaving_out_by_name_is_the_same_as_what_the_reduction_does(model):
    full = fitted(model, noise=0.05)
    named = haptid.estimate(full.observation, FixedAtZero(ZERO, haptid.WLS()))
    np.testing.assert_allclose(named.beta, refit_without(full, ZERO).beta, rtol=1e-12)
    np.testing.assert_allclose(named.covariance, refit_without(full, ZERO).covariance, rtol=1e-9, atol=1e-30)


def test_nothing_left_out_is_the_full_estimate(model):
    full = fitted(model, noise=0.05)
    same = haptid.estimate(full.observation, FixedAtZero((), haptid.WLS()))
    for name in ("beta", "covariance", "classical_covariance", "dof"):
        np.testing.assert_array_equal(getattr(same, name), getattr(full, name))


@pytest.mark.parametrize("method", [haptid.OLS(), haptid.WLS()])
def test_what_is_zero_is_left_out_and_what_is_needed_is_kept(model, method):
    for seed in range(3):
        full = fitted(model, seed, method, noise=0.02, phi=0.9)
        found = eliminate(full, BackwardElimination(MaxRelativeStd(30.0), level=0.01))
        carried = np.abs(full.beta) > 8 * full.se
        assert {full.base.names[k] for k in np.flatnonzero(carried)} <= set(found.essential)
        assert set(ZERO) <= {drop.name for drop in found.steps}
        assert np.nanmax(np.abs(found.shift)) < 4


def test_reduced_estimate_validates_and_predicts_unchanged(model):
    full = fitted(model, noise=0.02)
    unseen = motion(model, with_zeros(model), seconds=8.0, dt=4e-3, seed=9, noise=0.02)
    found = eliminate(full, unseen=unseen)
    assert found.unseen[1].relative == haptid.validate(found.reduced, unseen).relative
    assert found.unseen[1].relative < 1.02 * found.unseen[0].relative
    torque = haptid.predict(found.reduced, unseen)
    missed = np.linalg.norm(torque.measured - torque.predicted) / np.linalg.norm(torque.measured)
    assert 100 * missed == pytest.approx(found.unseen[1].relative, rel=1e-9)
    text = found.summary()
    assert "essential" in text
    assert all(name in text for name in found.essential)


def test_of_one_parameter_the_test_is_the_cluster_robust_t(model):
    full = fitted(model, noise=0.05, phi=0.8)
    k = full.base.names.index("FV1")
    test = rao_scott_test(full, (k,))
    assert pytest.approx((full.beta[k] / full.se[k]) ** 2, rel=1e-9) == test.F
    assert test.dof == pytest.approx((1.0, full.dof[k]), rel=1e-9)
    assert test.p == pytest.approx(2 * stats.t.sf(np.sqrt(test.F), full.dof[k]), rel=1e-6)


def test_with_white_residuals_it_is_the_classical_f(model):
    full = fitted(model, method=haptid.OLS(), noise=0.05)
    dof = full.observation.rows - len(full.beta)
    size = np.full(len(full.beta), dof / len(ZERO))
    white = replace(full, quantities=replace(full.quantities, covariance=full.classical_covariance, dof=size))
    reduced = refit_without(full, ZERO)
    squares = [sum(m.residual(e.beta) ** 2 for m in full.observation.motors) for e in (full, reduced)]
    test = rao_scott_test(white, reduced.zero)
    assert pytest.approx((squares[1] - squares[0]) / 3 / (squares[0] / dof), rel=1e-6) == test.F
    assert test.dof == pytest.approx((3, dof), rel=1e-9)


def as_classical(full):
    """The estimate with the covariance for white residuals."""
    return replace(full, quantities=replace(full.quantities, covariance=full.classical_covariance))


def test_correlated_residuals_do_not_make_it_object_to_zeros(model):
    """At a level of 0.05 the test objects 5 times in 100; taken as white, the same residuals object most times."""
    honest, classical, runs = 0, 0, 40
    for seed in range(runs):
        full = fitted(model, seed, noise=0.1, phi=0.95)
        zero = tuple(full.base.names.index(name) for name in ZERO)
        honest += rao_scott_test(full, zero).p < 0.05
        classical += rao_scott_test(as_classical(full), zero).p < 0.05
    assert honest <= 6
    assert classical > 20


def test_gautiers_rule_ends_at_ten_times_the_smallest(model):
    full = fitted(model, noise=1e-3)
    found = eliminate(full, BackwardElimination(GautierRatio(1e9)))
    assert not found.steps
    assert found.essential == full.base.names
    assert "within" in found.reason
    found = eliminate(full, BackwardElimination(GautierRatio(10.0), level=1e-300))
    relative = [found.reduced.parameters[k].relative_se for k in found.reduced.free_parameters]
    assert max(relative) <= 10 * min(relative)


def test_by_motor_each_has_its_own(model):
    full = fitted(model, noise=0.02)
    found = eliminate_by_motor(full)
    assert [len(r.full.observation.motors) for r in found] == [1, 1, 1]
    assert "FV1" not in found[0].essential
    assert "FC1" in found[0].essential
    assert not {"FC2", "FC3", "FV2", "FV3"} & set(found[0].essential)
    for one in found:
        assert one.seen[0].relative <= one.seen[1].relative


def test_a_constrained_estimate_is_rejected(model):
    with pytest.raises(errors.SettingError):
        eliminate(fitted(model, method=haptid.PhysicallyConsistent(), noise=0.02))


@pytest.mark.parametrize(
    "make", [lambda: GautierRatio(1.0), lambda: MaxRelativeStd(0.0), lambda: BackwardElimination(level=1.5)]
)
def test_settings_that_mean_nothing(make):
    with pytest.raises(errors.SettingError):
        make()


def test_names_that_are_none(model):
    full = fitted(model, noise=0.02)
    with pytest.raises(errors.UnknownNameError) as raised:
        refit_without(full, ("FV9",))
    assert raised.value.found == "FV9"
    with pytest.raises(errors.UnknownNameError) as raised:
        full.observation.only("9")
    assert raised.value.found == "9"
