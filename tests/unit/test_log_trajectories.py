"""Bags of `trajectory_msgs/JointTrajectory`: joints by name, and the times of points that one message holds."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import haptid
import recorders
import small_study
from haptid.log.survey import survey
from haptid.study.draft import draft_study
from haptid.study.read import read_study

T = 0.004 * np.arange(1500)
Q = np.column_stack((np.sin(1.3 * T), np.cos(2.1 * T)))
TAU = np.column_stack((np.cos(1.7 * T), np.sin(3.0 * T)))
TYPE = "trajectory_msgs/msg/JointTrajectory"


def message(rows: slice, starts: bool = True) -> object:
    """One message with points of some rows, whose header has no stamp."""
    types = recorders.STORE.types
    made = []
    for k in range(*rows.indices(T.size)):
        since = types["builtin_interfaces/msg/Duration"](*divmod(round(1e9 * T[k]), 10**9) if starts else (0, 0))
        point = types["trajectory_msgs/msg/JointTrajectoryPoint"]
        made.append(point(Q[k], np.zeros(0), np.zeros(0), np.ascontiguousarray(TAU[k]), since))
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
    return types[TYPE](header, ["b", "a"], made)


def test_points_of_one_message_have_their_own_times(tmp_path: Path) -> None:
    """All have the stamp at which the message was received: the draft named it, and no log could be read by it."""
    path = recorders.ros2(tmp_path / "bag", [("/planned", recorders.START, TYPE, message(slice(None)))])
    found = survey(path)
    assert found.topics[0].rate_hz == pytest.approx(250.0)
    assert found.topics[0].joints == ("b", "a")
    assert any("one message of /planned holds 1500 samples, all with its stamp" in note for note in found.notes)
    (tmp_path / "device.toml").write_text(small_study.DEVICE.replace('name = "1"', 'name = "a"').replace('"2"', '"b"'))
    device = haptid.read_device(tmp_path / "device.toml")
    text = draft_study([path], device, str(tmp_path / "device.toml"), tmp_path)[0]
    channels = tomllib.loads(text)["channels"]
    assert channels["time"] == "/planned.points.time_from_start"
    assert channels["position"] == {
        "topic": "/planned", "field": "points.positions", "joints": ["a", "b"], "unit": "rad"
    }  # fmt: skip
    (tmp_path / "study.toml").write_text(text)
    study = read_study(tmp_path / "study.toml")
    log = haptid.read_log(path, study.logs[0].channels or study.channels)
    assert log.rate_hz == pytest.approx(250.0)
    np.testing.assert_allclose(log.position, Q[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(log.torque, TAU[:, ::-1], atol=1e-12)
    assert not any("evenly spaced" in note for note in log.notes)


def test_points_of_one_message_without_times_need_a_rate(tmp_path: Path) -> None:
    path = recorders.ros2(tmp_path / "bag", [("/planned", recorders.START, TYPE, message(slice(None), starts=False))])
    assert "# rate_hz = ...  # all samples have one stamp" in survey(path).table


def test_one_point_in_each_message_is_read_by_receive_stamps_and_joints(tmp_path: Path) -> None:
    said = [
        ("/set", recorders.START + round(1e9 * t), TYPE, message(slice(k, k + 1), starts=False))
        for k, t in enumerate(T)
    ]
    path = recorders.ros2(tmp_path / "bag", said)
    channels = tomllib.loads(survey(path, [("a",), ("b",)]).table)["channels"]
    assert channels["time"] == {"topic": "/set", "stamp": "receive"}
    assert channels["position"]["joints"] == ["a", "b"]
    assert channels["position"]["field"] == "points[1].positions"
