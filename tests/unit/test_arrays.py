"""Small functions on arrays, against NumPy's."""

import numpy as np
import pytest

from haptid._internal.arrays import cross_product


@pytest.mark.parametrize(
    ("a", "b"), [((3,), (3,)), ((7, 3), (7, 3)), ((7, 3), (3,)), ((2, 1, 3), (5, 3)), ((0, 3), (3,))]
)
def test_cross_products_are_those_of_numpy_to_the_last_bit(a, b):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=a), rng.normal(size=b)
    assert (cross_product(x, y) == np.cross(x, y)).all()
    assert cross_product(x, y).shape == np.cross(x, y).shape
