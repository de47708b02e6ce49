"""Measured velocities beside positions: used where they are less noisy than differences, and only there."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from haptid.log import Channels, Signal, read_log
from haptid.log.survey import survey
from haptid.log.velocities import with_velocities

DT, N = 0.005, 6000
T = DT * np.arange(N)
Q = 0.5 * np.sin(2.1 * T) + 0.2 * np.cos(5.3 * T)
RATE = 1.05 * np.cos(2.1 * T) - 1.06 * np.sin(5.3 * T)
WHOLE = ((0, N),)


def noisy(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A coarse position and a fine velocity, each (n,)."""
    rng = np.random.default_rng(seed)
    return np.round((Q + 5e-4 * rng.standard_normal(N)) / 1e-3) * 1e-3, RATE + 5e-3 * rng.standard_normal(N)


def roughness(position: np.ndarray) -> float:
    """RMS error of its differences, without the ends."""
    return float(np.std((np.gradient(position, DT) - RATE)[200:-200]))


def test_a_fine_velocity_replaces_the_differences_of_a_coarse_position():
    position, velocity = noisy()
    made, sentence = with_velocities(position[:, None], velocity[:, None], WHOLE, DT, ("v",))
    assert "less noisy than differences" in sentence
    assert roughness(made[:, 0]) < 0.2 * roughness(position)
    assert np.std((made[:, 0] - Q)[200:-200]) < 1e-3  # nothing drifts away


def test_a_late_velocity_is_made_up_for():
    position, velocity = noisy()
    late = np.interp(T - 0.013, T, velocity)
    made, sentence = with_velocities(position[:, None], late[:, None], WHOLE, DT, ("v",))
    assert "13 ms late" in sentence
    assert roughness(made[:, 0]) < 0.2 * roughness(position)


def test_parts_without_a_gap_are_joined_each_for_itself():
    position, velocity = noisy()
    halves = ((0, 3000), (3000, N))
    position[3000:] += 0.7
    made, _ = with_velocities(position[:, None], velocity[:, None], halves, DT, ("v",))
    assert roughness(np.concatenate([made[:3000, 0], made[3000:, 0] - 0.7])) < 0.3 * roughness(noisy()[0])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda _, v: np.rad2deg(v), "check its unit"),
        (lambda _, v: -v, "check its unit"),
        (lambda _, v: np.roll(v, 60), "late"),
        (lambda q, _: np.convolve(np.gradient(q, DT), np.ones(8) / 8, "same"), "computed from the positions"),
        (lambda _, v: v + 0.5 * np.random.default_rng(3).standard_normal(N), "no less noisy"),
        (lambda _, v: 0 * v, "at rest"),
    ],
)
def test_others_are_named_and_not_used(make, said):
    position, velocity = noisy()
    made, sentence = with_velocities(position[:, None], make(position, velocity)[:, None], WHOLE, DT, ("v",))
    assert said in sentence
    np.testing.assert_array_equal(made[:, 0], position)


@pytest.mark.parametrize(
    ("part", "fast", "said"),
    [(600, False, "600 samples without a gap, 1024 are needed"), (N, True, "leaves no room for noise")],
)
def test_velocities_that_cannot_be_compared_are_named_once_with_the_reason(part: int, fast: bool, said: str):
    position, velocity = noisy()
    if fast:
        position, velocity = np.sin(2 * np.pi * 60.0 * T), np.cos(2 * np.pi * 60.0 * T)
    q, v = (np.column_stack([x[:part], 2 * x[:part]]) for x in (position, velocity))
    made, sentence = with_velocities(q, v, ((0, part),), DT, ("v1", "v2"))
    assert "v1, v2 (" in sentence
    assert sentence.count(said) == 1
    np.testing.assert_array_equal(made, q)


@pytest.mark.parametrize(("shift", "said"), [(18, "89.8 ms late on"), (-18, "89.7 ms ahead of"), (2, "")])
def test_positions_that_may_be_planned_are_questioned(shift: int, said: str):
    position, velocity = noisy()
    q, v = (np.column_stack([x, 2 * x]) for x in (position, np.roll(velocity, shift)))
    sentence = with_velocities(q, v, WHOLE, DT, ("v1", "v2"))[1]
    assert (said in sentence) if said else ("late on" not in sentence)
    assert ("were they filtered, which does no harm" in sentence) == (shift == 18)
    v[:, 1] = np.roll(v[:, 1], -shift)  # one joint alone is another fault
    assert "the velocities are" not in with_velocities(q, v, WHOLE, DT, ("v1", "v2"))[1]


def test_velocities_of_a_table_are_drafted_and_read(tmp_path: Path):
    position, velocity = noisy()
    table = np.column_stack((T, np.rad2deg(position), np.rad2deg(velocity) / 6, np.sin(T)))
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,angle,speed [rpm],torque", comments="")
    channels = tomllib.loads(survey(tmp_path / "log.csv").table)["channels"]
    assert channels["velocity"] == {"channels": ["speed [rpm]"], "unit": "rpm"}
    signals = Signal("angle", "deg"), Signal("torque", "N m")
    plain = read_log(tmp_path / "log.csv", Channels(*signals, time="t"))
    log = read_log(tmp_path / "log.csv", Channels(*signals, time="t", velocity=Signal("speed [rpm]", "rpm")))
    assert roughness(log.position[:, 0]) < 0.2 * roughness(plain.position[:, 0])
    assert any("less noisy" in note for note in log.notes)
    assert not any("velocit" in note for note in plain.notes)
