"""The reduction without accelerations is the QR of slope * momenta + taps * the rest, whatever the sizes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid import _core
from mechanisms import draw, mechanisms
from windows import FILTERS, windows

TERMS = ("viscous", "external", "rotor", "coulomb")


@settings(max_examples=60, deadline=None)
@given(
    mechanisms(most=6),
    FILTERS,
    st.integers(1, 700),
    st.integers(1, 70),
    st.integers(0, 3),
    st.sampled_from(_core.backends()),
)
def test_triangles_are_those_of_the_filtered_rows(mechanism, shape, rows, block, extra, backend):
    size, decimation = shape
    rng = np.random.default_rng(rows)
    na = mechanism.coordinates
    core = mechanism.core(backend, tuple((kind, rng.normal(size=na), 0.0, 0.0, 0.0, 0.0) for kind in TERMS))
    taps, slope = rng.normal(size=(2, size)) / size
    first = size // 2 + extra
    samples = first + (rows - 1) * decimation + size // 2 + 1 + extra
    c, cd, torque = rng.normal(size=(3, na, samples))
    external = rng.normal(size=(1, samples))
    columns = [c for c in range(core.columns) if c % 3 != 1]
    weights = rng.random((na, rows)) * (rng.random((na, rows)) < 0.8)
    made = core.reduce(c, cd, None, external, torque, columns, taps, decimation, first, rows, block, weights, slope)
    momentum, rest = core.momentum_regressor(c, cd, external, columns)
    Y = windows(momentum, slope, first, decimation, rows) + windows(rest, taps, first, decimation, rows)
    y = windows(torque, taps, first, decimation, rows)
    for a, (reached, triangles) in enumerate(made):
        assert not Y[a, np.setdiff1d(np.arange(len(columns)), reached)].any()
        for b, R in enumerate(triangles):
            part = slice(b * block, (b + 1) * block)
            A = np.column_stack([Y[a][reached][:, part].T, y[a, part]]) * weights[a, part, None]
            np.testing.assert_allclose(R.T @ R, A.T @ A, rtol=0, atol=1e-12 * max((A**2).sum(), 1e-30))


@pytest.mark.parametrize(("acceleration", "slope"), [(None, None), (None, np.ones(7)), (np.zeros((2, 50)), np.ones(9))])
def test_a_slope_goes_with_motion_that_has_no_acceleration_and_only_with_that(acceleration, slope):
    core = draw(1, joints=2, closed=False).core()
    x = np.zeros((2, 50))
    with pytest.raises(ValueError, match="slope has length"):
        core.reduce(x, x, acceleration, np.zeros((0, 50)), x, [0], np.ones(9), 1, 4, 42, 10, np.ones((2, 42)), slope)
