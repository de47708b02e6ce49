"""Roots by Brent's method, against closed forms and SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize

from haptid._internal.roots import bracketed_root


@given(st.floats(-3.0, 3.0), st.floats(0.1, 20.0), st.sampled_from([1e-3, 1e-9]))
def test_the_steps_are_those_of_scipy(root: float, steepness: float, xtol: float) -> None:
    def function(x: float) -> float:
        return float(np.tanh(steepness * (x - root)) + 0.1 * (x - root) ** 3)

    found = bracketed_root(function, -4.0, 5.0, xtol)
    assert abs(found - root) <= xtol + 1e-14
    assert found == pytest.approx(optimize.brentq(function, -4.0, 5.0, xtol=xtol), abs=1e-15)


def test_roots_at_the_ends_and_of_jumps() -> None:
    assert bracketed_root(lambda x: x, 0.0, 1.0, 1e-9) == 0.0
    assert bracketed_root(lambda x: x - 1.0, 0.0, 1.0, 1e-9) == 1.0
    assert bracketed_root(lambda x: 1.0 if x > 0.3 else -1.0, 0.0, 1.0, 1e-9) == pytest.approx(0.3, abs=1e-9)
    with pytest.raises(ValueError, match="no change of sign between 1 and 2"):
        bracketed_root(lambda x: x, 1.0, 2.0, 1e-9)
