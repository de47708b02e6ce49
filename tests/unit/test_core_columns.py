"""How the compiled regressor takes numbers of columns, and the memory it gives back."""

import numpy as np
import pytest

import haptid
from haptid import _core
from haptid.dynamics.model import mechanism_arguments


@pytest.fixture(scope="module")
def core() -> _core.Mechanism:
    return _core.Mechanism(*mechanism_arguments(haptid.DynamicModel(haptid.read_device("arm7"))))


def motion(core: _core.Mechanism, samples: int) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    return [*rng.normal(size=(3, core.coordinates, samples)), np.zeros((0, samples))]


def test_columns_are_the_same_as_a_list_a_tuple_and_an_array(core):
    some, columns = motion(core, 21), [5, 10, 61, 3]
    wanted = core.regressor(*some, columns)
    for other in (tuple(columns), np.array(columns), np.array(columns, dtype=np.int32), np.array([*columns, 7])[:-1]):
        np.testing.assert_array_equal(core.regressor(*some, other), wanted)


def test_other_columns_between_two_calls_change_nothing(core):
    some = motion(core, 16)
    wanted = core.regressor(*some, [5, 60])
    assert core.regressor(*some, [60, 5, 6]).shape == (core.coordinates, 3, 16)
    core.momentum_regressor(some[0], some[1], some[3], [5, 60])
    np.testing.assert_array_equal(core.regressor(*some, [5, 60]), wanted)
    np.testing.assert_array_equal(core.regressor(*some, [60, 5]), wanted[:, ::-1])


@pytest.mark.parametrize("columns", [[-1], np.array([-1])])
def test_a_column_below_zero_is_rejected(core, columns):
    with pytest.raises((OverflowError, ValueError)):
        core.regressor(*motion(core, 8), columns)


@pytest.mark.parametrize("samples", [0, 1, 8, 37, 128])
def test_a_new_regressor_begins_with_a_line_of_the_caches_and_is_that_written_to_old_memory(core, samples):
    some, columns = motion(core, samples), list(range(core.columns - 1))
    made = core.regressor(*some, columns)
    assert made.flags.c_contiguous
    assert samples == 0 or made.ctypes.data % 64 == 0
    out = np.full(made.shape, np.nan)
    assert core.regressor(*some, columns, None, out) is out
    np.testing.assert_array_equal(made, out)
