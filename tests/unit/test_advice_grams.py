"""Gram matrices of advice, each motor's of the columns that act on it, against products of the rows."""

import numpy as np

from haptid.advice.grams import Grams
from haptid.advice.rows import TrialRows

MOTORS, ROWS, SIZE = 3, 60, 7
EDGES = np.array([0, 20, 45, 60])


def rows(seed=0):
    """W of columns that act on some motors each, one on none of them; torque; and rows that count."""
    rng = np.random.default_rng(seed)
    W, y = rng.normal(size=(MOTORS, ROWS, SIZE)), rng.normal(size=(MOTORS, ROWS))
    W[:, :, 2] = W[0, :, 3] = W[1:, :, 5] = 0.0
    return W, y, rng.random((MOTORS, ROWS)) > 0.2


def dense(W, y, used):
    """Products of [W y_1 .. y_m] of every block and motor, (blocks, motors, size, size)."""
    whole = np.concatenate([W, np.broadcast_to(y.T, (MOTORS, ROWS, MOTORS))], axis=2) * used[:, :, None]
    parts = np.split(whole, EDGES[1:-1], axis=1)
    return np.array([part.swapaxes(1, 2) @ part for part in parts])


def test_they_are_products_of_the_rows():
    W, y, used = rows()
    made, expected = Grams.of(W, y, used, EDGES), dense(W, y, used)
    some, every, channels = np.array([5, 2, 3]), np.arange(SIZE), np.array([2, 0, 1])
    motor = np.arange(MOTORS)
    np.testing.assert_allclose(made.part(some, every), expected[:, :, some][..., every], rtol=1e-12)
    np.testing.assert_array_equal(made.moved_by(np.array([3, 5])), [0, 1, 2])
    np.testing.assert_array_equal(made.moved_by(np.array([2, 3])), moved := np.array([1, 2]))
    np.testing.assert_allclose(made.part(some, every, moved), expected[:, moved][:, :, some][..., every], rtol=1e-12)
    right = expected[:, motor[:, None], some, SIZE + channels[:, None]]
    np.testing.assert_allclose(made.right(some, channels), right, rtol=1e-12)
    squares = expected[:, motor, SIZE + channels, SIZE + channels]
    np.testing.assert_allclose(made.squares(channels), squares, rtol=1e-12)
    lengths = np.diagonal(expected, axis1=2, axis2=3)[..., :SIZE]
    np.testing.assert_allclose(made.lengths, lengths, rtol=1e-12)


def test_sums_over_blocks_and_motors_are_those_of_the_products():
    W, y, used = rows()
    weights, blocks = np.array([1.0, 2.0, 0.5]), np.array([0, 2])
    made, expected = Grams.of(W, y, used, EDGES), dense(W, y, used)[blocks].sum(axis=0)
    pooled = np.tensordot(weights, expected[:, :SIZE, :SIZE], axes=1)
    np.testing.assert_allclose(made.over(blocks).pooled(weights), pooled, rtol=1e-12, atol=1e-13)
    few = made.first(4)
    assert (len(few), few.size) == (3, 4)
    np.testing.assert_allclose(few.over(blocks).pooled(weights), pooled[:4, :4], rtol=1e-12, atol=1e-13)


def test_a_reversed_channel_is_that_of_rows_with_the_other_sign():
    W, y, used = rows()
    made = Grams.of(W, y, used, EDGES)
    turned = Grams.of(W, y * [[1.0], [-1.0], [1.0]], used, EDGES)
    np.testing.assert_array_equal(made.reversed(1).values, turned.values)


def test_matrices_with_another_torque_are_those_of_rows_with_it():
    W, y, used = rows()
    other = y[::-1] + 1.0
    made, expected = Grams.of(W, y, used, EDGES).with_torque(W, other, used, EDGES), Grams.of(W, other, used, EDGES)
    np.testing.assert_allclose(made.values, expected.values, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(made.place, expected.place)


def test_halves_are_sums_over_every_other_block():
    W, y, used = rows()
    block = np.repeat([0, 1, 2], np.diff(EDGES))
    whole = TrialRows(W, y, used, block, np.arange(1.0 * ROWS), (), y, y, block, block)
    half, order = whole.halves(4)
    np.testing.assert_array_equal(half.y, y[:, order])
    columns, grams = np.arange(4), whole.grams()
    for k, blocks in enumerate(([0, 2], [1])):
        expected = grams.over(np.array(blocks)).part(columns, columns)
        np.testing.assert_allclose(half.grams()[k : k + 1].part(columns, columns)[0], expected, rtol=1e-12, atol=1e-13)
