"""Errors that repeat with a periodic motion: its period is found, and intervals hold what time blocks do not see."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.motion.periods import motion_period
from haptid.treatment_choice.repeated_errors import _Scores, repeated_errors
from motions import multisine
from sampling import of_share
from small_study import two_links
from true_parameters import true_parameters

DT, LENGTH, TURNS, DRAWS = 5e-3, 1.7371, 12, 20


@pytest.fixture(scope="module")
def model():
    return two_links()


def periodic(t: np.ndarray, seed: int):
    """Positions, velocities and accelerations of three harmonics, each (joints, n)."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi / LENGTH * np.arange(1, 4)
    a, angle = rng.normal(size=(2, 3)) / np.arange(1, 4), w[:, None] * t
    p = rng.uniform(0, 2 * np.pi, (2, 3, 1))
    made = [np.einsum("jk,jkn->jn", 0.4 * a * w**k, np.sin(angle + p + 0.5 * np.pi * k)) for k in range(3)]
    return made[0], made[1], made[2]


def motion(model, beta, seed: int, repeated: float) -> haptid.Motion:
    """White noise of a hundredth, and an error that is the same in every period."""
    t = DT * np.arange(round(TURNS * LENGTH / DT))
    q, qd, qdd = periodic(t, 0)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    rng, size = np.random.default_rng(seed), tau.std(axis=1, keepdims=True)
    waves = 2 * np.pi / LENGTH * np.arange(4, 40)[:, None] * t
    again = (rng.normal(size=(2, 36)) @ np.sin(waves) + rng.normal(size=(2, 36)) @ np.cos(waves)) / 6
    tau = tau + 0.01 * size * rng.normal(size=tau.shape) + repeated * size * again
    treatment = haptid.Treatment(cutoff_hz=None, block_s=1.0)
    return haptid.Motion(DT, q.T, tau.T, treatment, rates=(qd.T, qdd.T))


def held(model, repeated: float) -> tuple[float, float, int]:
    """Share of intervals that hold the truth without and with errors that repeat, and in how many draws these are."""
    beta = model.base.of(true_parameters(model))
    inside, wide, found = [], [], 0
    for seed in range(DRAWS):
        made = haptid.estimate(haptid.observe(model, motion(model, beta, seed, repeated)), haptid.WLS())
        shifts = repeated_errors(made, None)
        more = made if shifts is None else made.with_nuisance("errors that repeat with the motion", shifts)
        found += shifts is not None
        for one, into in ((made, inside), (more, wide)):
            ends = np.asarray(one.conf_int())
            into.append(np.mean((ends[:, 0] <= beta) & (beta <= ends[:, 1])))
    return float(np.mean(inside)), float(np.mean(wide)), found


def test_the_period_of_a_motion_is_found(model):
    beta = model.base.of(true_parameters(model))
    made = motion(model, beta, 1, 0.0)
    noisy = haptid.Motion(
        DT, made.q + 2e-3 * np.random.default_rng(0).normal(size=made.q.shape), made.tau, made.treatment
    )
    for one in (made, noisy):
        assert motion_period(one) == pytest.approx(LENGTH, rel=1e-4)


def test_a_motion_that_does_not_come_back_has_no_period():
    q, qd, qdd = multisine(2, 20.0, DT, 3)
    treatment = haptid.Treatment(cutoff_hz=None)
    assert motion_period(haptid.Motion(DT, q.T, 0 * q.T, treatment, rates=(qd.T, qdd.T))) is None
    assert motion_period(haptid.Motion(DT, 0 * q.T, 0 * q.T, treatment)) is None
    short = round(2 * LENGTH / DT)
    q, qd, qdd = periodic(DT * np.arange(short), 0)
    assert motion_period(haptid.Motion(DT, q.T, 0 * q.T, treatment, rates=(qd.T, qdd.T))) is None


def test_intervals_hold_errors_that_repeat(model):
    without, together, found = held(model, 0.01)
    assert found > 0.9 * DRAWS
    # All parameters of a draw share its errors: as if a quarter of the parameters were independent.
    many = DRAWS * len(model.base) / 4
    assert without < 0.8
    assert together > 0.95 - of_share(0.95, many)


def test_noise_that_does_not_repeat_changes_little(model):
    without, together, found = held(model, 0.0)
    assert found < 0.2 * DRAWS
    assert together - without < 0.03


def test_each_part_of_a_log_between_gaps_has_rows_of_its_own(model):
    """Two parts of one name, the earlier one last: errors that repeat move the parameters as those of two logs do."""
    beta = model.base.of(true_parameters(model))
    channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("u1", "u2"), "N m"), time="t")
    parts = []
    for seed, t0 in ((1, 4000.0), (2, 0.0)):
        made = motion(model, beta, seed, 0.01)
        t = t0 + DT * np.arange(len(made))
        log = haptid.Log(Path("log"), "one file", t, made.q, made.tau, channels)
        parts.append(replace(made, t0=t0, log=log))
    both = haptid.estimate(haptid.observe(model, *parts), haptid.WLS())
    alone = [haptid.estimate(haptid.observe(model, part), haptid.WLS()) for part in parts]
    sizes = [np.sqrt(np.sum(np.square(repeated_errors(one, None)), axis=0)) for one in (both, *alone)]
    # Two independent errors, each in half of the rows.
    assert np.all(sizes[0] < np.maximum(sizes[1], sizes[2]))
    assert np.median(sizes[0] / np.hypot(sizes[1], sizes[2])) == pytest.approx(0.5, abs=0.15)


def test_rows_that_show_more_than_all_rows_have_are_no_defect():
    """Long logs are judged by some of their rows; these may correlate parameters and delays as no rows can together."""
    u = np.array([2.0, 0.0, 2000.0])
    scores = _Scores(np.random.default_rng(0).normal(size=(6, 4, 3)), np.tile(np.outer(u, u) / 6, (6, 1, 1)), 1.0)
    shifts = scores.shifts(np.eye(2), np.eye(1))
    assert shifts.shape == (6, 3)
    assert np.isfinite(shifts).all()
