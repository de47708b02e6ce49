"""Random-effects regression: its closed forms, its intervals, and what it leaves undetermined."""

import numpy as np
import pytest

from haptid.uncertainty.quantities import half_width
from haptid.uncertainty.random_effects import random_effects


def test_equal_errors_give_the_mean_and_its_usual_standard_error():
    """With one standard error for all, below the scatter, the mean square of the residuals is all that counts."""
    y = np.random.default_rng(0).normal(size=9)
    found = random_effects(y, np.full(9, 1e-3), np.ones((9, 1)))
    assert found.values[0] == pytest.approx(y.mean(), rel=1e-9)
    assert found.se[0] == pytest.approx(y.std(ddof=1) / 3, rel=1e-6)
    assert found.dof == 8
    assert found.between == pytest.approx(np.sqrt(y.var(ddof=1) - 1e-6), rel=1e-6)


def test_without_scatter_it_is_the_inverse_variance_mean():
    se = np.array([0.1, 0.2, 0.4, 0.1])
    y = 5.0 + se * np.array([0.5, -0.5, 0.5, -0.4])
    found = random_effects(y, se, np.ones((4, 1)))
    assert found.between == 0
    assert found.values[0] == pytest.approx(np.average(y, weights=se**-2.0), rel=1e-12)
    assert found.se[0] == pytest.approx((se**-2.0).sum() ** -0.5, rel=1e-12)


def test_what_the_cases_do_not_determine_is_unknown():
    line = np.column_stack([np.ones(3), np.zeros(3)])  # all of one day
    for columns, se in (
        (line, np.ones(3)),
        (np.ones((3, 1)), np.full(3, np.inf)),
        (line[:, :1], [1.0, np.inf, np.inf]),
    ):
        found = random_effects(np.arange(3.0), np.asarray(se), columns)
        assert np.isnan(found.values).all()
        assert np.isinf(found.se).all()


@pytest.mark.parametrize("between", [0.0, 1.0])
def test_intervals_of_a_slope_hold_the_truth(between):
    """Six logs with unequal errors, with and without a change from day to day."""
    rng, inside = np.random.default_rng(3), []
    days = np.array([0.0, 1.0, 2.0, 5.0, 8.0, 9.0])
    X = np.column_stack([np.ones(6), days - days.mean()])
    for _ in range(800):
        se = rng.uniform(0.3, 1.0, 6)
        y = 2.0 + 0.3 * X[:, 1] + se * rng.normal(size=6) + between * rng.normal(size=6)
        found = random_effects(y, se, X)
        inside.append(abs(found.values[1] - 0.3) < half_width(found.se[1], found.dof))
    assert np.mean(inside) > 0.93  # three standard errors of the share below 95 %
    assert between == 0 or np.mean(inside) < 0.98
