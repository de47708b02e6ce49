"""Layouts of robots' loggers: tuples in cells beside names, axes of KUKA's variables, seconds behind nanoseconds."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from haptid.cli import app
from haptid.errors import LogFileError
from haptid.log.file_format import format_of
from haptid.log.survey import survey

T = np.arange(0.0, 6.0, 0.02)
Q = np.array([0.5 * np.sin(2 * np.pi * f * T + f) for f in (0.3, 0.5, 0.7)])
TAU = np.array([[3.0], [2.0], [1.0]]) * np.cos(2 * Q)
NAMES = ("elbow", "lift", "pan")


def drafted(path: Path, joints: list[tuple[str, ...]]) -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads(survey(path, joints).table)["channels"]
    return found


@pytest.mark.parametrize("brackets", ["()", "[]"])
def test_lists_beside_a_list_of_names_are_those_of_its_joints(tmp_path: Path, brackets: str) -> None:
    """As a bag is saved by pandas; each row has its own order, and may have fewer joints. Tuples were no lists."""
    a, b = brackets
    lines = ["time,name,position,effort"]
    for k, t in enumerate(T):
        order = [0, 1, 2] if k % 3 else [2, 0] if k % 2 else [2, 1, 0]
        cells = [f'"{a}{", ".join(f"{x[j, k]:.9f}" for j in order)}{b}"' for x in (Q, TAU)]
        lines.append(f'{t:.3f},"{[NAMES[j] for j in order]}",{",".join(cells)}')
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    found = drafted(tmp_path / "log.csv", [("pan",), ("lift",), ("elbow",)])
    assert found["position"]["joints"] == found["torque"]["joints"] == ["pan", "lift", "elbow"]
    read = format_of(tmp_path / "log.csv").columns(tmp_path / "log.csv", [f"position[{name}]" for name in NAMES])
    for name, own in zip(NAMES, Q, strict=True):
        column = read[f"position[{name}]"]
        there = np.isfinite(column)
        assert there.mean() > 0.8
        np.testing.assert_allclose(column[there], own[there], atol=1e-8)


@pytest.mark.parametrize("every", [2, 3, 5])
def test_rows_of_a_gripper_alone_are_between_those_of_an_arm(tmp_path: Path, every: int) -> None:
    """Two publishers of joint states in one topic; the names were taken for those of rows of one joint each."""
    lines = ["time,name,position,effort"]
    for k, t in enumerate(T):
        own = [2] if k % every == 0 else [0, 1]
        cells = [f'"({", ".join(f"{x[j, k]:.9f}" for j in own)})"' for x in (Q, TAU)]
        lines.append(f'{t:.3f},"{[NAMES[j] for j in own]}",{",".join(cells)}')
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    read = format_of(tmp_path / "log.csv").columns(tmp_path / "log.csv", [f"position[{name}]" for name in NAMES])
    for j, name in enumerate(NAMES):
        there = np.isfinite(read[f"position[{name}]"])
        np.testing.assert_allclose(read[f"position[{name}]"][there], Q[j][there], atol=1e-8)
        np.testing.assert_array_equal(there, (np.arange(len(T)) % every == 0) == (j == 2))


def test_axes_of_a_kuka_controller_are_positions(tmp_path: Path) -> None:
    names = [f"$AXIS_ACT.A{k}" for k in (1, 2, 3)] + [f"$TORQUE_AXIS_ACT[{k}]" for k in (1, 2, 3)]
    rows = [";".join(f"{x:.6f}".replace(".", ",") for x in row) for row in zip(T, *np.degrees(Q), *TAU, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([";".join(["Zeit", *names]), *rows]) + "\n")
    found = drafted(tmp_path / "log.csv", [])
    assert found["position"]["channels"] == names[:3]
    assert found["torque"]["field"] == "$TORQUE_AXIS_ACT"


def stamped(path: Path, **times: np.ndarray[Any, Any]) -> Path:
    with h5py.File(path, "w") as file:
        file["joint_positions"], file["joint_torques"] = Q.T, TAU.T
        for name, values in times.items():
            file[name] = values
    return path


def test_nanoseconds_may_stand_before_their_seconds(tmp_path: Path) -> None:
    """HDF5 has the order of the alphabet. The seconds alone were the time, the same in 50 rows of each second."""
    now = 1_700_000_000_000_000_000 + np.rint(T * 1e9).astype(np.int64)
    path = stamped(tmp_path / "log.h5", robot_timestamp_seconds=now // 10**9, robot_timestamp_nanos=now % 10**9)
    found = survey(path)
    assert tomllib.loads(found.table)["channels"]["time"] == "robot_timestamp_seconds [s] + robot_timestamp_nanos [ns]"
    assert found.topics[0].rate_hz == pytest.approx(50)


def test_times_that_tell_no_rate_are_not_taken_before_others(tmp_path: Path) -> None:
    path = stamped(tmp_path / "log.h5", a_timestamp=np.floor(T), step_timestamp=T)
    assert tomllib.loads(survey(path).table)["channels"]["time"] == "step_timestamp"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("log.lcm", "lcm.EventLog"),
        ("set.tfrecord-00000-of-00064", "tensorflow_datasets"),
        ("flight.ulg", "ulog2csv"),
        ("run.mf4", "asammdf"),
    ],
)
def test_logs_of_other_programs_say_how_they_are_converted(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_bytes(b"\x00\x01\x02" * 50)
    with pytest.raises(LogFileError, match=words):
        survey(tmp_path / name)


def test_a_bare_draft_without_positions_says_what_to_name(tmp_path: Path) -> None:
    """It was empty."""
    np.savetxt(tmp_path / "log.csv", np.column_stack((T, *Q)), delimiter=",", header="t,a,b,c", comments="")
    made = CliRunner().invoke(app, ["channels", str(tmp_path / "log.csv"), "--toml"])
    assert made.exit_code == 0
    assert 'of no known quantity: "a", "b", "c"' in made.output
    assert tomllib.loads(made.output)["channels"]["time"] == "t"
