"""Descents with the penalties of limits in the model of a step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

import haptid
from haptid.experiment.excitation import FourierSeries, Limits, ScaledCondition
from haptid.experiment.excitation.descent import Costs, Penalties, descend
from haptid.experiment.excitation.gradients import Gradients
from haptid.experiment.excitation.limits import MotionBounds

MODEL = haptid.DynamicModel(haptid.read_device("arm3"))
FAMILY, DT, MARGIN = FourierSeries(count=4), 0.1, 0.01
LIMITS = Limits(((-1.0, 1.5),) * 3, (2.0,), (4.0, np.inf, 5.0), torque=(0.5,))
BOUNDS = MotionBounds.of(MODEL, LIMITS, np.full(len(MODEL.base), 0.1))
BASIS = FAMILY.basis(BOUNDS, DT)
SIZE = FAMILY.size(3)
JOINTS = Penalties.of(BOUNDS, BASIS, SIZE, MARGIN)
GRADIENTS = Gradients.of(
    BOUNDS, ScaledCondition(), tuple(range(len(MODEL.base))), np.full(3, 0.01), dt=DT, margin=MARGIN
)
NONE = np.zeros((0, SIZE))


def evaluation(x):
    return GRADIENTS.at(BASIS.states(x))


def random_point(seed):
    """Beyond some limits of every kind."""
    return 0.5 + 0.4 * np.random.default_rng(seed).uniform(-1, 1, SIZE)


def test_penalties_of_joints_and_of_other_limits_are_all_penalties():
    x = random_point(0)
    made = evaluation(x)
    found = made.beyond(joints=False)
    whole = JOINTS.about(BASIS.rows(found.sample, found.slopes, SIZE), 7.0)
    state = np.r_[JOINTS.along(x), found.over]
    beyond = whole.beyond(state)
    penalty, by_state = made.penalties(7.0)
    assert (beyond[-found.over.size :] != 0).any()
    assert (beyond[: -found.over.size] != 0).any()
    assert whole.cost(beyond) == pytest.approx(penalty, rel=1e-10)
    assert whole.gradient(beyond) == pytest.approx(BASIS.gradient(by_state, SIZE), rel=1e-8, abs=1e-9)


def test_curvature_of_joints_penalties_is_the_slope_of_their_gradient():
    x, step = random_point(1), 1e-6
    gradient = lambda x: JOINTS.gradient(JOINTS.beyond(JOINTS.along(x)))  # noqa: E731
    way = random_point(2) - 0.5
    slope = (gradient(x + step * way) - gradient(x - step * way)) / (2 * step)
    found = JOINTS.curvature(JOINTS.beyond(JOINTS.along(x))) @ way
    assert np.abs(found).max() > 0
    assert found == pytest.approx(slope, rel=1e-4, abs=1e-6 * np.abs(found).max())


def test_a_descent_finds_the_least_of_a_quadratic_cost_within_steep_limits():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(SIZE, SIZE))
    H, aim, weight = root @ root.T / SIZE + np.eye(SIZE), rng.uniform(-0.5, 1.5, SIZE), 1e4
    smooth = lambda x: (0.5 * float((x - aim) @ H @ (x - aim)), H @ (x - aim))  # noqa: E731

    def whole(x):
        beyond = JOINTS.beyond(JOINTS.along(x))
        value, slope = smooth(x)
        return value + weight * JOINTS.cost(beyond), slope + weight * JOINTS.gradient(beyond)

    start = np.full(SIZE, 0.5)
    least = optimize.minimize(
        whole,
        start,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": 100000, "maxfun": 100000, "ftol": 1e-14, "gtol": 1e-9},
    )
    found = descend(lambda x: Costs(*smooth(x), np.zeros(0), NONE), JOINTS, start, weight, most=200, enough=1e-9)
    assert whole(aim)[0] > 1.1 * least.fun
    assert found.cost == pytest.approx(whole(found.x)[0], rel=1e-9)
    assert found.cost == pytest.approx(least.fun, rel=1e-5)
    assert found.used < least.nfev / 5


def test_other_limits_are_met_by_their_linear_model():
    """A plane through the cube, nearer than the least of the cost."""
    normal, weight = np.ones(SIZE) / np.sqrt(SIZE), 1e6

    def costs(x):
        return Costs(float((x - 1) @ (x - 1)), 2 * (x - 1), np.array([normal @ (x - 0.5) - 0.1]), normal[None])

    free = Penalties(
        JOINTS.own, JOINTS.rows, np.full_like(JOINTS.low, -np.inf), np.full_like(JOINTS.high, np.inf), 1.0, NONE
    )
    found = descend(costs, free, np.full(SIZE, 0.5), weight, most=60, enough=1e-9)
    assert normal @ (found.x - 0.5) == pytest.approx(0.1, abs=1e-4)
