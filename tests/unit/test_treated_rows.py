"""Rows that are made again are the rows of the r_factors, and what is done to them reaches the r_factors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from haptid.motion.filters import Causal
from haptid.observation.filtering import decimate
from haptid.observation.rows import Rows
from motions import motion, truth
from windows import FILTERS, windows

TREATMENTS = [
    haptid.Treatment(cutoff_hz=None),
    haptid.Treatment(cutoff_hz=None, decimation=7, reversal_speed=0.1, reversal_guard_s=0.01),
    haptid.Treatment(cutoff_hz=None, decimation=10, formulation="momentum"),
    haptid.Treatment(cutoff_hz=None, decimation=5, parallel_shape=Causal()),
]


def made(name="phantom_premium_15", treatment=TREATMENTS[0], seconds=6.0):
    model = haptid.DynamicModel(haptid.read_device(name))
    return haptid.observe(model, motion(model, truth(model), seconds=seconds, noise=0.1, treatment=treatment))


def same(a, b):
    """The same squares in every block of every motor."""
    for one, other in zip(a.motors, b.motors, strict=True):
        assert (one.rows == other.rows).all()
        squares, others = (m.r_factors.mT @ m.r_factors for m in (one, other))
        np.testing.assert_allclose(others, squares, atol=1e-11 * np.abs(squares).max())


@pytest.mark.parametrize("treatment", TREATMENTS)
@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch"])
def test_rows_fold_into_the_triangles_they_came_from(name, treatment):
    observation = made(name, treatment)
    for part in (observation, *observation.alternate(), observation.only(observation.motors[-1].name)):
        same(Rows(part).folded(lambda rows: rows), part)


def test_two_motions_are_walked_one_after_the_other():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    parts = [haptid.observe(model, motion(model, truth(model), seconds=4.0, seed=seed)) for seed in (1, 2)]
    whole = parts[0] + parts[1]
    assert sum(rows.used.sum() for rows in Rows(whole)) == whole.rows
    same(Rows(whole).folded(lambda rows: rows), whole)


def test_changes_are_made_one_after_the_other():
    observation = made()
    twice = Rows(observation).folded(lambda rows: rows.scaled(np.full(rows.y.shape, 2.0)))
    four = Rows(twice).folded(lambda rows: rows.scaled(np.full(rows.y.shape, 2.0)))
    same(Rows(observation).folded(lambda rows: rows.scaled(np.full(rows.y.shape, 4.0))), four)


def test_residuals_are_those_of_the_triangles():
    observation = made(treatment=TREATMENTS[1])
    beta = haptid.estimate(observation, haptid.WLS()).beta
    for motor, e in zip(observation.motors, Rows(observation).residuals(beta), strict=True):
        assert len(e) == motor.rows.sum()
        assert np.linalg.norm(e) == pytest.approx(motor.residual(beta))


@settings(max_examples=20)
@given(FILTERS, st.integers(0, 99))
def test_decimation_is_that_of_a_loop_over_windows(which, seed):
    length, decimation = which
    rng = np.random.default_rng(seed)
    signals, taps = rng.normal(size=(2, 3, 400)), rng.normal(size=length)
    rows = (400 - length) // decimation + 1
    np.testing.assert_allclose(
        decimate(signals, taps, decimation), windows(signals, taps, length // 2, decimation, rows), atol=1e-12
    )
