"""The fused reduction is the filtered, decimated, weighted regressor's QR, whatever the sizes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid import _core
from mechanisms import draw, mechanisms
from windows import FILTERS, windows


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
    terms = [
        ("viscous", np.eye(na)[0], 0.0, 0.0, 0.0, 0.0),
        ("external", rng.normal(size=na), 0.0, 0.0, 0.0, 0.0),
    ]
    core = mechanism.core(backend, tuple(terms))
    taps = rng.normal(size=size) / size
    taps = taps + taps[::-1]
    first = size // 2 + extra
    samples = first + (rows - 1) * decimation + size // 2 + 1 + extra
    motion = rng.normal(size=(3, na, samples))
    external, torque = rng.normal(size=(1, samples)), rng.normal(size=(na, samples))
    columns = [c for c in range(core.columns) if c % 3 != 1]
    weights = rng.random((na, rows)) * (rng.random((na, rows)) < 0.8)
    made = core.reduce(*motion, external, torque, columns, taps, decimation, first, rows, block, weights)
    Y = windows(core.regressor(*motion, external, columns), taps, first, decimation, rows)
    y = windows(torque, taps, first, decimation, rows)
    assert len(made) == na
    for a, (reached, triangles) in enumerate(made):
        lost = np.setdiff1d(np.arange(len(columns)), reached)
        assert not Y[a, lost].any()
        assert len(triangles) == -(-rows // block)
        for b, R in enumerate(triangles):
            part = slice(b * block, (b + 1) * block)
            A = np.column_stack([Y[a][reached][:, part].T, y[a, part]]) * weights[a, part, None]
            assert np.array_equal(R, np.triu(R))
            np.testing.assert_allclose(R.T @ R, A.T @ A, rtol=0, atol=1e-12 * max((A**2).sum(), 1e-30))


@pytest.mark.parametrize("backend", _core.backends())
@pytest.mark.parametrize("rows", [5, 301, 1799])
def test_missing_numbers_of_one_log_do_not_reach_the_next(backend, rows):
    """Threads keep their buffers: those of a call are used again by the next."""
    core = draw(5, joints=4, closed=False).core(backend)
    motion, columns = np.random.default_rng(0).normal(size=(3, 4, rows)), list(range(core.columns))

    def reduced(motion, rows):
        none, ones = np.zeros((0, rows)), np.ones((4, rows))
        return core.reduce(*motion, none, motion[0], columns, np.ones(1), 1, 0, rows, rows, ones)

    before = reduced(motion, rows)
    missing = np.full((3, 4, 1900), np.nan)
    assert np.isnan(reduced(missing, 1900)[0][1]).any()
    for (_, first), (_, again) in zip(before, reduced(motion, rows), strict=True):
        np.testing.assert_array_equal(first, again)


def test_the_result_does_not_depend_on_where_the_parts_were_cut():
    """Blocks reduced in one call are those reduced in two, bit for bit."""
    mechanism = draw(5, joints=4, closed=False)
    core, n = mechanism.core(), 20000
    motion = np.random.default_rng(0).normal(size=(3, 4, n))
    none, torque = np.zeros((0, n)), motion[0]
    columns, taps = list(range(core.columns)), np.hanning(43)[1:-1]
    whole = core.reduce(*motion, none, torque, columns, taps, 5, 20, 3990, 100, np.ones((4, 3990)))
    cut = 20 * 100
    tail = [np.ascontiguousarray(x[:, cut * 5 :]) for x in motion]
    later = core.reduce(
        *tail,
        none[:, cut * 5 :],
        np.ascontiguousarray(torque[:, cut * 5 :]),
        columns,
        taps,
        5,
        20,
        1990,
        100,
        np.ones((4, 1990)),
    )
    for (_, a), (_, b) in zip(whole, later, strict=True):
        np.testing.assert_array_equal(a[20:], b)


def test_no_rows_and_no_samples_are_no_error():
    core = draw(1, joints=2, closed=False).core()
    none = np.zeros((2, 0))
    made = core.reduce(none, none, none, np.zeros((0, 0)), none, [0, 1], np.ones(1), 1, 0, 0, 10, np.zeros((2, 0)))
    assert [len(triangles) for _, triangles in made] == [0, 0]
    assert core.regressor(none, none, none, np.zeros((0, 0)), [0, 1]).shape == (2, 2, 0)
    assert core.torque(none, none, none, np.zeros((0, 0)), np.ones(20)).shape == (2, 0)


def test_a_matrix_in_fortran_order_is_rejected_rather_than_read_transposed():
    core = draw(1, joints=2, closed=False).core()
    q = np.asfortranarray(np.random.default_rng(0).normal(size=(2, 9)))
    with pytest.raises(ValueError, match="not row-major"):
        core.regressor(q, q, q, np.zeros((0, 9)), [0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"first": 3}, "do not fit into 50 samples"),
        ({"rows": 43, "weights": np.ones((2, 43))}, "43 rows .* do not fit"),
        ({"taps": np.ones(4)}, "odd"),
        ({"columns": [99]}, "column is 99"),
        ({"columns": [3, 3]}, "column 3 is given twice"),
        ({"rows": 2**61, "decimation": 8, "weights": np.ones((0, 0))}, "do not fit|weights"),
        ({"first": 2**63 - 1}, "do not fit"),
        ({"decimation": 0}, "decimation is 0"),
        ({"block": 0}, "block is 0"),
        ({"weights": np.ones((2, 3))}, "weights has length 6"),
        ({"torque": np.ones((1, 50))}, "torque has length 50"),
    ],
)
def test_what_does_not_fit_together_is_rejected(change, message):
    core = draw(1, joints=2, closed=False).core()
    x = np.zeros((2, 50))
    given_ = {
        "torque": x,
        "columns": [0],
        "taps": np.ones(9),
        "decimation": 1,
        "first": 4,
        "rows": 42,
        "block": 10,
        "weights": np.ones((2, 42)),
    } | change
    with pytest.raises(ValueError, match=message):
        core.reduce(x, x, x, np.zeros((0, 50)), **given_)


def test_a_row_that_does_not_count_may_hold_anything():
    core = draw(1, joints=2, closed=False).core()
    x = np.random.default_rng(0).normal(size=(2, 50))
    torque, weights = x.copy(), np.ones((2, 50))
    torque[:, 7], weights[:, 7] = np.nan, 0.0
    made = core.reduce(x, x, x, np.zeros((0, 50)), torque, [0, 5], np.ones(1), 1, 0, 50, 50, weights)
    assert all(np.isfinite(triangles).all() for _, triangles in made)


def test_one_row_far_decimated_needs_no_memory_for_what_lies_between():
    core = draw(1, joints=2, closed=False).core()
    x = np.zeros((2, 50))
    core.reduce(x, x, x, np.zeros((0, 50)), x, [0], np.ones(1), 2**40, 0, 1, 1, np.ones((2, 1)))


@pytest.mark.parametrize(
    "terms", [[("viscous", np.ones(1), 0.0, 0.0, 0.0, 0.0)], [("viscous", np.ones(3), 0.0, 0.0, 0.0, 0.0)]]
)
def test_a_term_has_one_weight_for_each_coordinate(terms):
    with pytest.raises(ValueError, match="weights, wanted 2"):
        draw(1, joints=2, closed=False).core(terms=tuple(terms))


def test_shapes_are_compared_and_not_only_lengths():
    core = draw(1, joints=2, closed=False).core()
    x = np.zeros((2, 50))
    with pytest.raises(ValueError, match="same shape"):
        core.regressor(x, x.reshape(50, 2), x, np.zeros((0, 50)), [0])


SCRIPT = """
import sys, numpy as np
sys.path.insert(0, sys.argv[1])
from mechanisms import draw
core, n = draw(5, joints=4, closed=False).core(), 9000
x = np.random.default_rng(0).normal(size=(3, 4, n))
made = core.reduce(*x, np.zeros((0, n)), x[0], list(range(core.columns)), np.hanning(43)[1:-1], 5, 20, 1790, 100,
                   np.ones((4, 1790)))
sys.stdout.write("".join(t.tobytes().hex() for _, t in made)[:200000])
"""


def test_the_result_does_not_depend_on_the_number_of_threads():
    folder = str(Path(__file__).parents[1])
    outs = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT, folder],
            env={**os.environ, "RAYON_NUM_THREADS": threads},
            capture_output=True,
            check=True,
        ).stdout
        for threads in ("1", "3")
    ]
    assert outs[0] == outs[1]
    assert len(outs[0]) > 1000
