"""Fits with added columns that share the model's part, against the same fits made one by one."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid.estimation.block_moments import ALONE
from haptid.estimation.intervals.added_columns import Bordered, _inverse_root
from haptid.estimation.intervals.cluster_robust import clustered
from haptid.estimation.least_squares import Solution
from haptid.observation.observation import stacked
from motions import motion, truth

EPS = np.finfo(float).eps
WEIGHTS = np.array([1.0, 0.7, 2.0])


@pytest.fixture(scope="module")
def rows():
    """Rows of two seconds, whose blocks have much leverage."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return haptid.observe(model, motion(model, truth(model), seconds=2.5, dt=2e-3, noise=0.1, phi=0.9))


def widened(rows, added):
    """The rows with added columns, (blocks, rows of the R factor, columns) of every motor, as their R factors."""
    motors = []
    for motor, own in zip(rows.motors, added, strict=True):
        wide = np.concatenate([motor.r_factors[:, :, :-1], own, motor.r_factors[:, :, -1:]], axis=2)
        columns = np.append(motor.columns, len(rows.base) + np.arange(own.shape[2]))
        lower = np.zeros((len(wide), own.shape[2], wide.shape[2]))  # as many rows as columns
        motors.append(replace(motor, columns=columns, r_factors=np.concatenate([wide, lower], axis=1)))
    return tuple(motors)


def one_by_one(rows, motors, kept, columns):
    """The same by a fit of its own: parameters of all columns, CR2 and degrees of freedom of the last."""
    order = [*kept, *columns]
    picked = []
    for motor in motors:
        at = [k for k in order if k in motor.columns]
        places = [list(motor.columns).index(k) for k in at]
        factors = np.linalg.qr(motor.r_factors[:, :, [*places, -1]], mode="r")
        picked.append(replace(motor, columns=np.array([order.index(k) for k in at]), r_factors=factors))
    R = np.linalg.qr(stacked(picked, WEIGHTS, len(order)), mode="r")
    root = np.linalg.inv(R[:-1, :-1])
    beta = root @ R[:-1, -1]
    solution = Solution(beta, R[:-1, :-1], root, abs(R[-1, -1]), 1)
    spread = clustered(replace(rows, motors=tuple(picked)), WEIGHTS, solution, np.eye(len(order))[-len(columns) :])
    return beta, spread.covariance, spread.dof, np.linalg.cond(R[:-1, :-1] / np.linalg.norm(R[:-1, :-1], axis=0))


def candidates(rows, alone=False):
    """Three random columns on every motor; where `alone`, the last is zero but in one block."""
    rng = np.random.default_rng(4)
    added = [rng.normal(size=(*motor.r_factors.shape[:2], 3)) for motor in rows.motors]
    if alone:
        for own in added:
            own[1:, :, 2] = 0.0
    return added


@pytest.mark.parametrize("alone", [False, True], ids=["", "a block that alone determines a direction"])
@pytest.mark.parametrize("chosen", [(0,), (2,), (0, 2), (1, 2, 0)])
@pytest.mark.parametrize("fixed", [(), (1, 4)])
def test_each_is_the_fit_with_these_columns(rows, chosen, fixed, alone):
    """To rounding times the condition number, of which a standard error has the square in G."""
    motors = widened(rows, candidates(rows, alone))
    p = len(rows.base)
    kept = np.array([k for k in range(p) if k not in fixed])
    columns = [p + k for k in chosen]
    found = Bordered.of(motors, WEIGHTS, kept, p + np.arange(3)).fit(columns, 1e-4)
    beta, covariance, dof, condition = one_by_one(rows, motors, kept, columns)
    rounding = 1e3 * EPS * condition
    assert rounding < 1e-8
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.values, beta[-len(columns) :], rtol=0, atol=rounding * np.abs(found.values).max())
    np.testing.assert_allclose(found.beta[kept], beta[: -len(columns)], rtol=0, atol=rounding * np.abs(beta).max())
    np.testing.assert_allclose(found.beta[list(fixed)], 0.0)
    # The inverse square root has an error of 1e-12; a block on its own divides rounding by 1 - ALONE.
    limit = rounding + 1e-11 + alone * 1e3 * EPS / (1 - ALONE)
    np.testing.assert_allclose(found.covariance / np.outer(size, size), covariance / np.outer(size, size), atol=limit)
    np.testing.assert_allclose(found.dof, dof, rtol=limit)
    without = Bordered.of(motors, WEIGHTS, kept, p + np.arange(3))
    plain = without.inverse @ without.factor[: len(kept), -1]
    np.testing.assert_allclose(found.shift, found.beta[kept] - plain, rtol=0, atol=rounding * np.abs(beta).max())


def test_a_column_of_the_model_is_no_further_one(rows):
    added = candidates(rows)
    for own, motor in zip(added, rows.motors, strict=True):
        own[:, :, 1] = motor.r_factors[:, :, 0] if 0 in motor.columns else 0.0
    motors = widened(rows, added)
    bordered = Bordered.of(motors, WEIGHTS, np.arange(len(rows.base)), len(rows.base) + np.arange(3))
    assert bordered.fit([len(rows.base) + 1], 1e-4) is None
    assert bordered.fit([len(rows.base)], 1e-4) is not None


def test_dependent_columns_of_the_model_have_no_fits(rows):
    motors = widened(rows, candidates(rows))
    empty = tuple(
        replace(motor, r_factors=motor.r_factors * (np.arange(motor.r_factors.shape[2]) > 0)) for motor in motors
    )
    assert Bordered.of(empty, WEIGHTS, np.arange(len(rows.base)), len(rows.base) + np.arange(3)) is None


def test_the_inverse_square_root_is_that_of_every_share_of_a_block_in_a_fit():
    x = np.geomspace(1 - ALONE, 1.0, 1000)
    nodes, weights = _inverse_root()
    np.testing.assert_allclose((weights / (nodes + x[:, None])).sum(axis=1), x**-0.5, rtol=1e-11)
