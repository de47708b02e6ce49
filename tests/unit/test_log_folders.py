"""Folders of tables, a file for each signal or joint; rates by velocities; and what is no log."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from haptid import errors
from haptid.log.file_format import format_of
from haptid.log.request import Request
from haptid.log.survey import survey

RATE = 250.0
T = np.arange(0.0, 8.0, 1.0 / RATE)
W = np.array([1.1, 2.3, 3.7])
Q = np.sin(W * T[:, None]) + 0.3 * np.cos(0.7 * W * T[:, None] + W)
QD = np.gradient(Q, 1.0 / RATE, axis=0)
TAU = 4.0 * np.cos(Q) + np.sign(QD) + 0.1 * np.random.default_rng(3).standard_normal(Q.shape)


def test_samples_of_several_joints_in_turn_are_channels(tmp_path: Path) -> None:
    for name, array in (("time", T), ("positions", Q), ("torques", TAU)):
        np.savetxt(tmp_path / f"{name}.txt", array.ravel())
    found = format_of(tmp_path).columns(tmp_path, ["positions[2]", "torques[3]", "time"])
    np.testing.assert_allclose(found["positions[2]"], Q[:, 1])
    np.testing.assert_allclose(found["torques[3]"], TAU[:, 2])
    channels = tomllib.loads(survey(tmp_path).table)["channels"]
    assert channels["position"] == {"field": "positions", "joints": [1, 2, 3], "unit": "rad"}


def test_a_signal_of_a_higher_rate_is_one_channel(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "force.txt", np.sin(3.0 * T))
    np.savetxt(tmp_path / "position.txt", np.sin(np.arange(0.0, 8.0, 0.5 / RATE)))
    assert format_of(tmp_path).names(tmp_path) == ["force", "position"]


def test_a_file_for_each_joint_without_headers(tmp_path: Path) -> None:
    names = ["elbow_joint_states", "hip_joint_states", "wrist_joint_states"]
    for k, name in enumerate(names):
        np.savetxt(tmp_path / f"{name}.csv", np.column_stack((Q[:, k], QD[:, k], TAU[:, k])), delimiter=",")
    channels = tomllib.loads(survey(tmp_path).table)["channels"]
    assert channels["position"]["channels"] == [f"{name}[1]" for name in names]
    assert channels["velocity"]["channels"] == [f"{name}[2]" for name in names]
    assert channels["torque"]["channels"] == [f"{name}[3]" for name in names]
    assert channels["rate_hz"] == RATE


def test_positions_of_a_state_are_preferred_to_those_of_a_control(tmp_path: Path) -> None:
    """The name of the state's file has `motor` in it, and the planned positions were drafted."""
    for name, q, tau in (("control", Q + 0.01, None), ("state_motor", Q, TAU)):
        columns = {f"positions[{k}]": q[:, k] for k in range(3)}
        if tau is not None:
            columns |= {f"torques[{k}]": tau[:, k] for k in range(3)}
        table = np.column_stack((1e6 * T, *columns.values()))
        header = ",".join(("timestamp", *columns))
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header=header, comments="")
    channels = tomllib.loads(survey(tmp_path).table)["channels"]
    assert channels["position"]["field"] == "state_motor.positions"
    assert channels["torque"]["field"] == "state_motor.torques"


def test_files_that_begin_with_times_are_joined_by_them(tmp_path: Path) -> None:
    """Of one file a row is lost, another goes on with its last row: rows are those whose times all have."""
    t = 0.01 * np.arange(300)
    q, tau = np.sin(2 * t), np.column_stack((np.cos(t), np.cos(3 * t)))
    kept = np.arange(300) != 120
    padded = np.r_[np.arange(300), np.full(40, 299)]
    np.savetxt(tmp_path / "pos.txt", np.column_stack((t, q))[kept])
    np.savetxt(tmp_path / "tau.txt", np.column_stack((t, tau))[padded])
    kind, request = format_of(tmp_path), Request()
    assert kind.names(tmp_path) == ["time", "pos", "tau[1]", "tau[2]"]
    found = kind.columns(tmp_path, ["time", "pos", "tau[2]"], request)
    np.testing.assert_allclose(found["time"], t[kept])
    np.testing.assert_allclose(found["pos"], q[kept])
    np.testing.assert_allclose(found["tau[2]"], tau[kept, 1])
    assert "rows are 299 of 300 that all have; up to 40 rows at the end repeat the last time" in request.notes[0]
    np.savetxt(tmp_path / "pos.txt", np.column_stack((t, q))[::2])
    found = kind.columns(tmp_path, ["pos", "tau[1]"], Request())
    assert np.isnan(found["pos"]).sum() == 150
    assert not np.isnan(found["tau[1]"]).any()
    np.savetxt(tmp_path / "pos.txt", np.column_stack((np.sin(t), q)))
    assert kind.names(tmp_path) == ["pos[1]", "pos[2]", "tau[1]", "tau[2]", "tau[3]"]


def test_files_of_another_clock_or_without_times_are_left_out(tmp_path: Path) -> None:
    """An accelerometer that counts ms from its own start, and the time of the start as a number: they took the times of
    all others for a joint."""
    for name, array in (("log_q", Q), ("log_qd", QD), ("log_current", TAU)):
        np.savetxt(tmp_path / f"{name}.csv", np.column_stack((T, array)), delimiter=", ")
    np.savetxt(tmp_path / "acc.csv", np.column_stack((6 + 3.7 * np.arange(2500), np.ones(2500))), delimiter=", ")
    (tmp_path / "start_time.csv").write_text("1386174622.44\n")
    found = survey(tmp_path)
    channels = tomllib.loads(found.table)["channels"]
    assert channels["time"] == "time"
    assert channels["position"] == {"field": "log_q", "joints": [1, 2, 3], "unit": "rad"}
    assert channels["torque"]["field"] == "log_current"
    assert any("left out: acc.csv, start_time.csv" in note for note in found.notes)


def test_the_rate_is_that_of_velocities_known_by_name(tmp_path: Path) -> None:
    """A torque that is all viscous friction is a rate of the positions too, in another unit."""
    path = tmp_path / "log.csv"
    columns = np.column_stack((0.01 * QD[:, :2], TAU[:, 2], Q, QD))
    header = "m1,m2,m3,q1,q2,q3,qd1,qd2,qd3"
    np.savetxt(path, columns, delimiter=",", header=header, comments="")
    assert survey(path).topics[0].by_rates_hz == RATE


def test_no_rate_is_guessed_where_columns_disagree(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack((Q, QD * (1.0, 3.0, 9.0), TAU)), delimiter=",")
    assert survey(path).topics[0].by_rates_hz == 0.0


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.npz", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "git lfs pull"),
        ("run.xlsx", b"PK\x03\x04", "--convert-to csv"),
        ("run.pkl", b"\x80\x04", "numpy.savez"),
        ("run.csv.gz", b"\x1f\x8b", "Unpack"),
    ],
)
def test_what_is_no_log_says_how_to_make_one(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(errors.LogFileError, match=words):
        format_of(path)


def test_dumps_of_ports_in_folders_of_their_own(tmp_path: Path) -> None:
    """As of YARP's dumper: a count, the time of the port and the samples in each line, none with a header."""
    t = 1.3e9 + 0.01 * np.arange(300)
    q, tau = np.sin(3 * (t - t[0])), np.cos(2 * (t - t[0]))
    for port, late, samples in (("state:o", 0.0, (30 * q, 40 * q)), ("torques:o", 1e-3, (tau, 2 * tau))):
        (tmp_path / port).mkdir()
        columns = np.column_stack((500 + np.arange(300), t + late, *samples))
        np.savetxt(tmp_path / port / "data.log", columns, fmt=["%d", "%.6f", "%.6f", "%.6f"])
        (tmp_path / port / "info.log").write_text("Type: Bottle;\n")
    found = survey(tmp_path)
    channels = tomllib.loads(found.table)["channels"]
    assert channels["time"] == "time"
    assert channels["position"] == {"field": "state", "joints": [1, 2], "unit": "deg"}
    assert channels["torque"] == {"field": "torques", "joints": [1, 2], "unit": "N m"}
    assert channels["merge"] == {"method": "linear"}
    assert found.topics[0].rate_hz == pytest.approx(100, rel=1e-3)
