"""Laws of numbers with uncertainty: Student t intervals, linear combinations, what is not finite."""

import numpy as np
import pytest
from scipy import stats

from haptid.uncertainty.quantities import Field, Quantities, half_width


@pytest.fixture
def quantities():
    root = np.random.default_rng(0).normal(size=(3, 3))
    return Quantities(
        ("a", "b", "c"), ("m", "kg", "s"), np.array([1.0, -2.0, 3.0]), root @ root.T, np.array([4, 9, np.inf])
    )


@pytest.mark.parametrize("level", [0.5, 0.95, 0.99])
def test_the_interval_holds_the_level_of_a_student_t(level):
    half = half_width(2.0, 7.0, level)
    assert stats.t.cdf(half / 2.0, 7.0) - stats.t.cdf(-half / 2.0, 7.0) == pytest.approx(level, rel=1e-12)


def test_infinite_degrees_of_freedom_are_the_normal_distribution():
    assert half_width(1.0, np.inf) == pytest.approx(stats.norm.ppf(0.975), rel=1e-12)


def test_combinations_have_the_covariance_of_a_linear_map(quantities):
    C = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, -1.0]])
    made = quantities.linear(("d", "e"), ("m", "m"), C, (4, 4))
    np.testing.assert_allclose(made.values, C @ quantities.values)
    np.testing.assert_allclose(made.se**2, [C[k] @ quantities.covariance @ C[k] for k in range(2)])
    assert (np.diff(made.conf_int(), axis=1)[:, 0] > 2 * 1.9 * made.se).all()


def test_picked_quantities_keep_their_intervals(quantities):
    picked = quantities.pick([2, 0])
    np.testing.assert_array_equal(picked.conf_int(0.9), quantities.conf_int(0.9)[[2, 0]])
    np.testing.assert_array_equal(picked.correlation, quantities.correlation[np.ix_([2, 0], [2, 0])])


def test_what_cannot_be_estimated_is_infinite_and_null_in_json():
    made = Quantities(("a", "b"), ("m", "m"), np.ones(2), np.eye(2), np.array([3.0, 3.0]), unbounded=(1,))
    assert np.isinf(made.conf_int()[1]).all()
    first, second = made.to_json()
    assert first["conf_int"] == pytest.approx(list(made.conf_int()[0]))
    assert second["se"] is None
    assert second["conf_int"] == [None, None]
    assert len(made.table().splitlines()) == 3


def test_a_field_without_covariance_has_no_interval():
    assert Field(np.ones(3), None, np.inf, "kg").conf_int() is None
    assert Field(np.ones((2, 3)), np.ones((2, 3)), 5.0, "kg").conf_int().shape == (2, 3, 2)
