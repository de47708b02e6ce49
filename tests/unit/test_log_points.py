"""Drafts of positions called x, y and z: those of a point in space, of a machine's slides, or of joints."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from haptid.cli import app
from haptid.log.survey import survey

T = np.arange(0.0, 4.0, 0.005)
Q = np.sin(3.0 * T) + 0.3 * np.cos(7.0 * T)
P = np.cos(4.0 * T) - 0.2 * np.sin(6.0 * T)
TAU = Q + np.cos(5.0 * T)


def test_x_y_and_z_of_a_point_are_no_joints(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack((T, Q, 2 * Q, Q**2, TAU)), delimiter=",", header="t,x,y,z,F", comments="")
    assert survey(path).table == ""


@pytest.mark.parametrize(
    "names",
    [
        "DevicePosX,DevicePosY,DevicePosZ,CursorPosX,CursorPosY",
        "pos_x,pos_y,pos_z,a,b",
        "x_pos,y_pos,z_pos,a,b",
        "X_pos [mm],Y_pos [mm],Z_pos [mm],a,b",
    ],
)
def test_the_position_of_a_handle_is_none_of_the_joints(tmp_path: Path, names: str) -> None:
    """It was drafted as joints in degrees, as its millimetres are more than two turns."""
    path = tmp_path / "log.csv"
    table = np.column_stack((T, 60 * Q, 40 * P, 50 * (Q + P), 60 * Q, 40 * P, TAU, TAU + P, TAU - P))
    header = f"t,{names},CommandedForceX,CommandedForceY,CommandedForceZ"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    assert survey(path).table == ""
    three = (("yaw",), ("shoulder",), ("elbow",))
    assert survey(path, joints=three, straight=[False] * 3).table == ""
    output = CliRunner().invoke(app, ["channels", str(path)]).output
    assert ", ".join(names.split(",")[:3]) in output
    assert "of a point in space, which does not tell how the joints stand" in output


def test_x_y_and_z_of_a_machine_are_its_joints(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    table = np.column_stack((T, Q, P, Q + P, TAU, TAU + P, TAU - P))
    np.savetxt(path, table, delimiter=",", header="t,pos_x,pos_y,pos_z,force_x,force_y,force_z", comments="")
    slides = (("first",), ("second",), ("third",))
    found = tomllib.loads(survey(path, joints=slides, straight=[True] * 3).table)["channels"]
    assert found["position"] == {"channels": ["pos_x", "pos_y", "pos_z"], "unit": "m"}
    np.savetxt(path, table, delimiter=",", header="t,angle_x,angle_y,angle_z,tau_x,tau_y,tau_z", comments="")
    assert tomllib.loads(survey(path).table)["channels"]["position"]["unit"] == "rad"


@pytest.mark.parametrize("names", ["x_pos,y_pos,z_pos", "pos_x,pos_y,pos_z"])
@pytest.mark.parametrize(
    ("motors", "unit"),
    [
        ("x_current,y_current,z_current", "A"),
        ("force_x,force_y,force_z,current_x,current_y,current_z", "A"),
        ("voltage_x,voltage_y,voltage_z", "V"),
        ("motor_torque_x,motor_torque_y,motor_torque_z", "N m"),
        ("force_x,force_y,force_z", ""),
        ("torque_x,torque_y,torque_z", ""),  # of a sensor at the hand
    ],
)
def test_positions_beside_the_motors_of_the_same_letters_are_joints(
    tmp_path: Path, names: str, motors: str, unit: str
) -> None:
    """Those of a gantry were taken for a point in space."""
    path = tmp_path / "log.csv"
    forces = [TAU, TAU + P, TAU - P, P, Q, TAU + Q][: len(motors.split(","))]
    table = np.column_stack((T, Q, P, Q + P, *forces))
    np.savetxt(path, table, delimiter=",", header=f"t,{names},{motors}", comments="")
    channels = tomllib.loads(survey(path).table).get("channels", {})
    assert channels.get("position", {}).get("channels", []) == (names.split(",") if unit else [])
    assert channels.get("torque", {}).get("unit", "") == unit


def test_joints_that_are_called_x_y_and_z_are_joints(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    table = np.column_stack((T, Q, P, Q + P, TAU, TAU + P, TAU - P))
    np.savetxt(path, table, delimiter=",", header="t,PosX,PosY,PosZ,TorqueX,TorqueY,TorqueZ", comments="")
    found = tomllib.loads(survey(path, joints=(("x",), ("y",), ("z",)), straight=[True, True, False]).table)["channels"]
    assert found["position"]["channels"] == ["PosX", "PosY", "PosZ"]


def test_units_in_a_header_do_not_make_joints_of_a_point(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    table = np.column_stack((T, Q, P, Q + P, TAU, TAU + P, TAU - P))
    header = "t,pos_x [m],pos_y [m],pos_z [m],force_x,force_y,force_z"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    assert survey(path).table == ""


def test_a_point_of_the_hand_is_no_set_of_joints(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    joints, hand = np.tile(Q[:, None], 5), np.tile(Q[:, None], 3)
    np.savez(path, time=T, ee_pos=hand, xyz_position=hand, q=joints, tau_measured=joints + TAU[:, None])
    channels = tomllib.loads(survey(path).table)["channels"]
    assert channels["position"] == {"field": "q", "joints": [1, 2, 3, 4, 5], "unit": "rad"}
    assert channels["torque"]["joints"] == [1, 2, 3, 4, 5]
