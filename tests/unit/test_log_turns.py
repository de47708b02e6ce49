"""Several turns or some degrees: told by the torque, or by the swing, of a joint with weight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid.log.survey import survey
from haptid.log.turns import turning_unit

T = np.arange(0, 20, 0.004)


def angle(turns: bool, seed: int) -> np.ndarray:
    """Several turns to and fro, or some degrees, rad."""
    rng = np.random.default_rng(seed)
    size = 10.0 if turns else np.deg2rad(20.0)
    phases = rng.uniform(0, 2 * np.pi, 3)
    q = sum(size / k * np.sin(2 * np.pi * 0.13 * k * T + p) for k, p in zip((1, 2, 3), phases, strict=True))
    return np.asarray(q)


def torque(q: np.ndarray, weight: float, seed: int) -> np.ndarray:
    qd = np.gradient(q, T)
    noise = 0.02 * np.random.default_rng(seed).standard_normal(T.size)
    return 0.05 * np.gradient(qd, T) + weight * np.cos(q - 0.7) + 0.1 * qd + 0.2 * np.sign(qd) + noise


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("turns", [True, False])
def test_the_torque_tells(turns: bool, seed: int) -> None:
    q = angle(turns, seed)
    other = np.random.default_rng(9).standard_normal(T.size)
    position = q if turns else np.rad2deg(q)
    assert turning_unit(position, [other, torque(q, 2.0, seed)]) == ("rad" if turns else "deg")


@pytest.mark.parametrize("turns", [True, False])
def test_without_weight_nothing_is_told(turns: bool) -> None:
    q = angle(turns, 1)
    assert turning_unit(q if turns else np.rad2deg(q), [torque(q, 0.0, 1)]) == ""


def test_a_free_swing_tells_turns_without_a_torque() -> None:
    q, qd, swing = 0.0, 14.0, []
    for _ in T:
        swing.append(q)
        qd -= 0.004 * (20 * np.sin(q) + 0.15 * qd)
        q += 0.004 * qd
    assert np.ptp(swing) > 4 * np.pi
    assert turning_unit(np.array(swing), []) == "rad"


def test_the_draft_has_the_unit_that_is_told(tmp_path: Path) -> None:
    for turns in (True, False):
        q = angle(turns, 2)
        np.savez(tmp_path / "log.npz", t=T, q=q if turns else np.rad2deg(q), tau=torque(q, 2.0, 2))
        table = survey(tmp_path / "log.npz").table
        assert f'position = {{ channels = ["q"], unit = "{"rad" if turns else "deg"}" }}' in table


def test_the_channel_of_the_largest_values_tells_the_unit_of_all(tmp_path: Path) -> None:
    """Seven degrees could be radians, and the current of a small servo amperes; a recorder has one unit for each."""
    wave, other = np.sin(T), np.cos(1.3 * T)
    columns = np.c_[T, 7 * wave, 64 * other, 15.5 * wave, 240.5 * other]
    path = tmp_path / "log.csv"
    np.savetxt(path, columns, delimiter=",", header="t,pan.pos,lift.pos,pan.current,lift.current", comments="")
    position, torque = (line for line in survey(path).table.splitlines() if line.startswith(("position", "torque")))
    assert 'unit = "deg"' in position
    assert "lift.pos" in position.partition("#")[2]
    assert 'unit = "mA"' in torque


def test_whole_numbers_are_no_newton_metres(tmp_path: Path) -> None:
    q = np.rint(500 * np.sin(T))
    np.savez(tmp_path / "log.npz", t=T, q=q, load=np.rint(40 * np.cos(T)), pin_state=(q > 0).astype(int))
    found = {channel.name: channel for channel in survey(tmp_path / "log.npz").topics[0].channels}
    assert found["load"].unit == "counts"
    assert "not N m" in found["load"].reason
    assert "or counts" in found["q"].reason
    assert found["pin_state"].quantity == "other"
