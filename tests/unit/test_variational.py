"""Inverses of small matrices of many states at once."""

from __future__ import annotations

import numpy as np
import pytest

from haptid.simulation.variational import inverses


def test_inverses_of_mass_matrices_are_numpys() -> None:
    A = np.random.default_rng(0).normal(size=(200, 3, 3))
    mass = A @ A.transpose(0, 2, 1) + np.eye(3)
    np.testing.assert_allclose(inverses(mass) @ mass, np.tile(np.eye(3), (200, 1, 1)), atol=1e-9)


def test_a_zero_pivot_is_passed_and_a_matrix_without_an_inverse_is_an_error() -> None:
    """A poor step of a fit has mass matrices that are not positive."""
    turned = np.array([[[0.0, 1.0], [1.0, 0.0]], [[2.0, 0.0], [0.0, 4.0]]])
    np.testing.assert_allclose(inverses(turned) @ turned, np.tile(np.eye(2), (2, 1, 1)))
    one = np.zeros((1, 2, 2))
    with pytest.raises(np.linalg.LinAlgError):
        inverses(one)
    assert not one.any()  # the argument of one state is not written to
