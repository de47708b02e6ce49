"""Tables with joints' names in columns of texts, with very many columns, and with names that deny what is guessed."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptid.log.formats import dialect
from haptid.log.survey import survey
from haptid.log.survey.channels import LOOKED_AT

T = np.arange(0.0, 6.0, 0.004)
Q = np.array([0.5 * np.sin(2 * np.pi * f * T + f) for f in (0.3, 0.5, 0.7)])
QD = np.gradient(Q, T, axis=1)
TAU = np.array([[3.0], [2.0], [1.0]]) * np.cos(2 * Q) + 0.3 * QD
NAMES = ("elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint")  # in the order of the alphabet, as ROS has them
DEVICE = [("shoulder_pan_joint",), ("shoulder_lift_joint",), ("elbow_joint",)]


def drafted(path: Path, joints: list[tuple[str, ...]] = DEVICE) -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads(survey(path, joints).table)["channels"]
    return found


def write_echo(path: Path, header: str, names: list[tuple[str, ...]], stamps: list[str]) -> None:
    rows = [
        ",".join([stamp, *own, *(f"{x:.9f}" for x in (*Q[:, k], *QD[:, k], *TAU[:, k]))])
        for k, (stamp, own) in enumerate(zip(stamps, names, strict=True))
    ]
    path.write_text("\n".join([header] * bool(header) + rows) + "\n")


def header(*fields: str) -> str:
    return ",".join(["%time", "field.header.stamp", *(f"field.{field}{k}" for field in fields for k in range(3))])


def stamps_of(rng: np.random.Generator) -> list[str]:
    sent = 1_700_000_000_000_000_000 + 4_000_000 * np.arange(T.size)
    received = sent + rng.integers(100_000, 3_000_000, T.size)
    return [f"{a},{b}" for a, b in zip(received, sent, strict=True)]


def test_rostopic_echo_names_the_joints_beside_their_numbers(tmp_path: Path) -> None:
    """A JointState has the order of the alphabet, in which joints were exchanged; of two stamps the sender's counts."""
    write_echo(
        tmp_path / "log.csv",
        header("name", "position", "velocity", "effort"),
        [NAMES] * T.size,
        stamps_of(np.random.default_rng(0)),
    )
    found = drafted(tmp_path / "log.csv")
    assert found["position"]["channels"] == [f"field.position{k}" for k in (2, 1, 0)]
    assert found["torque"]["channels"] == [f"field.effort{k}" for k in (2, 1, 0)]
    assert found["velocity"]["channels"] == [f"field.velocity{k}" for k in (2, 1, 0)]
    assert found["time"] == "field.header.stamp"
    assert survey(tmp_path / "log.csv").topics[0].joints == NAMES


def test_names_that_change_from_row_to_row_are_said(tmp_path: Path) -> None:
    names = [NAMES if k % 2 else NAMES[::-1] for k in range(T.size)]
    write_echo(
        tmp_path / "log.csv",
        header("name", "position", "velocity", "effort"),
        names,
        stamps_of(np.random.default_rng(0)),
    )
    found = survey(tmp_path / "log.csv")
    assert any("not one name in all rows" in note and "field.name0" in note for note in found.notes)
    assert not any(channel.joint for channel in found.topics[0].channels)


def test_ros2_topic_echo_has_no_header(tmp_path: Path) -> None:
    """Seconds, nanoseconds, frame, names, then numbers: nanoseconds, which start again, were taken for a position."""
    stamps = [f"{1_700_000_000 + k // 250},{4_000_000 * (k % 250)},base" for k in range(T.size)]
    write_echo(tmp_path / "log.csv", "", [NAMES] * T.size, stamps)
    found = drafted(tmp_path / "log.csv")
    assert found["time"] == "column[1] [s] + column[2] [ns]"
    assert found["position"]["joints"] == [9, 8, 7]
    assert found["torque"]["joints"] == [15, 14, 13]


def test_texts_of_another_kind_name_no_joints(tmp_path: Path) -> None:
    rows = [
        f"{t:.3f},auto,arm,{a:.6f},{b:.6f},{c:.6f},{d:.6f}" for t, a, b, c, d in zip(T, *Q[:2], *TAU[:2], strict=True)
    ]
    (tmp_path / "log.csv").write_text("\n".join(["t,mode,robot,q1,q2,tau1,tau2", *rows]) + "\n")
    found = survey(tmp_path / "log.csv", [("arm",), ("auto",)])
    assert not any(channel.joint for channel in found.topics[0].channels)


@pytest.mark.parametrize("names", ["velocity,accel,torque,temp", "speed,ddq,i,v_bat"])
def test_what_is_called_a_velocity_is_no_position(tmp_path: Path, names: str) -> None:
    """Its acceleration beside it made it one, by how they move."""
    noise = np.random.default_rng(1).standard_normal(T.size)
    columns = (T, QD[0], np.gradient(QD[0], T), TAU[0], noise)
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), delimiter=",", header=f"t,{names}", comments="")
    found = survey(tmp_path / "log.csv")
    assert not found.table
    assert "position" not in found.quantities


def test_the_dialect_of_a_wide_table_is_found_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was found anew for each sixteen columns, and for each position: a minute for 1600 columns."""
    joints = 40
    columns = [T, *(np.sin(T + k) for k in range(joints)), *(np.cos(T + k) for k in range(joints))]
    names = ["t", *(f"q{k}" for k in range(joints)), *(f"tau{k}" for k in range(joints))]
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), delimiter=",", header=",".join(names), comments="")
    asked: list[int] = []
    whole = dialect._separator
    monkeypatch.setattr(dialect, "_separator", lambda texts: asked.append(len(texts)) or whole(texts))
    assert len(tomllib.loads(survey(tmp_path / "log.csv").table)["channels"]["position"]["channels"]) == joints
    assert len(asked) == 1
    (tmp_path / "log.csv").write_text("t;q1;tau1\n" + "".join(f"{t:.3f};{np.sin(t):.6f};{np.cos(t):.6f}\n" for t in T))
    assert tomllib.loads(survey(tmp_path / "log.csv").table)["channels"]["position"]["channels"] == ["q1"]


def test_of_very_many_columns_those_with_telling_names_are_looked_at(tmp_path: Path) -> None:
    """Joints behind the first 400 columns were not there, without a word."""
    rows, rng = T[:300], np.random.default_rng(2)
    others = [f"camera/pixel_{k}" for k in range(LOOKED_AT + 20)]
    table = np.column_stack((rng.standard_normal((rows.size, len(others))), rows, Q[0, :300], TAU[0, :300]))
    np.savetxt(
        tmp_path / "log.csv", table, fmt="%.5f", delimiter=",", header=",".join([*others, "t", "q", "tau"]), comments=""
    )
    found = survey(tmp_path / "log.csv")
    assert tomllib.loads(found.table)["channels"]["position"]["channels"] == ["q"]
    assert any(f"{LOOKED_AT} of {len(others) + 3} channels are looked at" in note for note in found.notes)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (["hip [deg]", "knee"], "deg"),
        (["hip", "knee [deg]"], "deg"),  # the first one's guess counted, against what the file states
        (["hip [deg]", "knee [rad]", "ankle"], ["deg", "rad", "rad"]),
    ],
)
def test_a_unit_that_is_stated_of_some_channels_is_that_of_the_others(
    tmp_path: Path, names: list[str], unit: str | list[str]
) -> None:
    header = ",".join(["t", *(f"pos {name}" for name in names), *(f"tau_{k}" for k in range(len(names)))])
    columns = (T, *Q[: len(names)], *TAU[: len(names)])
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), delimiter=",", header=header, comments="")
    found = survey(tmp_path / "log.csv", [(name.split()[0],) for name in names])
    assert tomllib.loads(found.table)["channels"]["position"]["unit"] == unit
    if isinstance(unit, str):
        bare = next(name for name in names if "[" not in name)
        assert f"the file states {unit}" in found.table
        assert f"of pos {bare} no unit is stated: it is taken as that of the others" in found.table


def test_a_channel_that_no_name_tells_is_said(tmp_path: Path) -> None:
    """A gripper stood silently in for a device's last joint, whose own channel the log lacks."""
    header = ",".join(["t", *(f"{name}.{key}" for key in ("pos", "torque") for name in ("pan", "lift", "gripper"))])
    np.savetxt(tmp_path / "log.csv", np.column_stack((T, *Q, *TAU)), delimiter=",", header=header, comments="")
    line = next(
        line
        for line in survey(tmp_path / "log.csv", [("lift",), ("pan",), ("wrist",)]).table.splitlines()
        if line.startswith("position")
    )
    assert "no name tells gripper.pos: taken for the joint that is left, wrist" in line
    assert "no name tells" not in survey(tmp_path / "log.csv", [("lift",), ("pan",), ("gripper",)]).table
