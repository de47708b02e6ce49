"""A small version of `benchmarks/payloads.py`: payload and drive gains from logs of the virtual bench."""

import pytest
from scipy import stats

import payloads

pytest.importorskip("mujoco")
PAIRS = 4


@pytest.fixture(scope="module")
def figures():
    return payloads.on_the_bench(1, PAIRS)


def test_the_mass_is_within_one_per_cent(figures):
    assert figures["bench: pairs"] == PAIRS
    assert figures["bench: mass, largest error, per cent"] < 1.0


def test_wrong_gains_of_the_device_file_are_found(figures):
    assert figures["bench: gains, largest error, per cent"] < 2.0


@pytest.mark.parametrize("what", ["mass", "com x", "gain of motor 2", "gain of motor 3"])
def test_intervals_are_those_of_a_binomial_at_95_per_cent(figures, what):
    hits = round(PAIRS * figures[f"bench: {what} in its interval, per cent"] / 100)
    assert hits >= stats.binom.ppf(1e-4, PAIRS, 0.95)
