"""A log of another device is told from one whose motion the others do not show."""

import numpy as np
import pytest

from haptid.advice.odd_logs import odd_logs
from haptid.advice.rows import TrialRows
from haptid.advice.trial import Bench

RNG_SEEDS, ROWS = range(6), 400


def logs_of(seed, second, change, block=ROWS // 8):
    """Three logs of one motor and two parameters of value one, besides which an unmodelled torque acts on all alike.

    Args:
        second: size of the second column in the first two logs; it is 1 in the third.
        change: of the second parameter in the third log.
        block: rows of a block.
    """
    rng = np.random.default_rng(seed)
    log = np.repeat([0, 1, 2], ROWS)
    t = np.tile(np.linspace(0, 8 * np.pi, ROWS), 3)
    bend = np.sin(t)  # of the wave that the model lacks, so that a small second column takes it up
    W = np.stack([np.cos(2.3 * t), np.where(log < 2, second, 1.0) * (bend + 0.3 * np.cos(1.7 * t))], axis=-1)
    theta = np.stack([np.ones(len(t)), np.where(log == 2, 1.0 + change, 1.0)], axis=-1)
    y = (W * theta).sum(axis=-1) + 0.05 * bend + 0.02 * rng.standard_normal(len(t))
    block = np.arange(len(t)) // block
    used = np.ones((1, len(t)), dtype=bool)
    zeros = np.zeros((1, len(t)))
    rows = TrialRows(W[None], y[None], used, block, t, (), zeros, zeros, np.arange(len(t)), log)
    return rows, Bench({"used": rows.grams()}, 2, np.arange(2), np.ones(1), np.eye(1))


@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_a_log_whose_motion_the_others_do_not_show_is_not_another_device(seed):
    """The others' fit takes the unmodelled torque for the small column, and is far off where that is large."""
    rows, bench = logs_of(seed, 0.03, 0.0)
    others = rows.log < 2
    theta = np.linalg.lstsq(rows.W[0, others], rows.y[0, others], rcond=None)[0]
    e = rows.y[0] - rows.W[0] @ theta
    assert np.mean(e[~others] ** 2) > 100 * np.mean(e[others] ** 2)
    assert list(odd_logs(rows, bench)) == []


@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_a_log_of_another_device_is_named(seed):
    assert list(odd_logs(*logs_of(seed, 1.0, 0.5))) == [2]
    assert list(odd_logs(*logs_of(seed, 1.0, 0.0))) == []


@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_blocks_that_span_two_logs_do_not_hide_the_odd_one(seed):
    """Of many logs, neighbouring blocks are merged: one of them had rows of the odd log in the fit of the others."""
    rows, bench = logs_of(seed, 1.0, 0.5, ROWS * 3 // 2)
    assert np.unique(rows.log[rows.block == 1]).tolist() == [1, 2]
    assert list(odd_logs(rows, bench)) == [2]
