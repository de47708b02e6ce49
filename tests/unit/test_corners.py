"""Corners of a motion at its reversals are told from noise, and keep the position filter wide."""

from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.treatment_choice.corners import cuts_corners
from haptid.treatment_choice.motion_filters import MotionFilters
from motions import multisine

WIDE, NARROW = (haptid.Treatment(cutoff, parallel_cutoff_hz=6.0, decimation=4) for cutoff in (25.0, 7.0))
CHANNELS = haptid.Channels(haptid.Signal(("q1",), "rad"), haptid.Signal(("u1",), "N m", side="motor"), time="t")


def log(hold: float, noise: float, seed: int) -> haptid.Log:
    """A minute at 250 Hz of a motion below 2.4 Hz whose joint is held after each reversal for a stroke of `hold`."""
    q = multisine(1, 60.0, 0.004, seed)[0][0]
    held = np.empty_like(q)
    held[0] = q[0]
    for k in range(1, len(q)):
        held[k] = min(max(held[k - 1], q[k] - hold), q[k] + hold)
    held += noise * np.random.default_rng(seed).standard_normal(len(q))
    return haptid.Log(Path("made"), str(seed), 0.004 * np.arange(len(q)), held[:, None], 0 * q[:, None], CHANNELS)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [1e-5, 2e-4])
def test_a_joint_that_is_held_at_reversals_has_corners(seed, noise):
    assert cuts_corners([log(0.01, noise, seed)], WIDE, NARROW)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [2e-4, 2e-3])
def test_noise_has_none(seed, noise):
    assert not cuts_corners([log(0.0, noise, seed)], WIDE, NARROW)


def test_a_wider_filter_cuts_nothing():
    assert not cuts_corners([log(0.01, 1e-5, 0)], NARROW, WIDE)


PENDULUM = """
schema = 1
name = "pendulum"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"

[[joints]]
name = "1"

[[terms]]
kind = "coulomb"
joints = "all"
"""


@pytest.mark.parametrize(("hold", "corners"), [(0.01, True), (0.0, False)])
def test_the_balanced_filter_is_not_below_the_parallel_one_where_it_cuts_corners(hold, corners, tmp_path):
    (tmp_path / "pendulum.toml").write_text(PENDULUM)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "pendulum.toml"))
    made = MotionFilters.of(model, (log(hold, 2e-3, 0),), {}).at(6.0, {})
    assert (np.min(made.cutoff_hz) >= made.parallel_cutoff_hz) == corners
