"""Drafted channels of tables as recorders write them: abbreviations, capitals, units in names, joints' names."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from haptid.cli import app
from haptid.log.formats.sniff import channel_list
from haptid.log.survey import survey
from haptid.log.survey.draft import unrecognised
from haptid.log.survey.names import element_of, quantity_of, time_unit, unit_apart

T = np.arange(0.0, 4.0, 0.005)
Q = np.sin(3.0 * T) + 0.3 * np.cos(7.0 * T)
P = np.cos(4.0 * T) - 0.2 * np.sin(6.0 * T)
TAU = Q + np.cos(5.0 * T)


def test_velocities_alone_are_said_not_to_be_integrated(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "log.csv", np.column_stack((T, Q, TAU)), delimiter=",", header="t_meas,speed,u", comments="")
    table = unrecognised(survey(tmp_path / "log.csv").topics)
    assert "# speed: velocities, which are not integrated" in table
    assert tomllib.loads(table)["channels"] == {"time": "t_meas", "time_unit": "s"}


CART = """
name = "cart and pole"
gravity = [0, -9.81, 0]
convention = "placement"
joints = [{ name = "cart", type = "prismatic", axis = [1, 0, 0] }, { name = "pole" }]
motors = [{ name = "cart", command_unit = "N" }]
"""


@pytest.mark.parametrize("header", ["t;x;x_dot;theta;theta_dot;F", "t;x;dx;phi;dphi;u"])
def test_a_cart_and_its_pole_are_drafted_by_letters(tmp_path: Path, header: str) -> None:
    """The cart's `x` and `F` were left out without a word beside the pole's angle."""
    columns = (T, P, np.gradient(P, T), Q, np.gradient(Q, T), TAU)
    (tmp_path / "device.toml").write_text(CART)
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), delimiter=";", header=header, comments="")
    out = tmp_path / "study.toml"
    made = CliRunner().invoke(
        app, ["channels", str(tmp_path / "log.csv"), "--device", str(tmp_path / "device.toml"), "--out", str(out)]
    )
    assert made.exit_code == 0, made.output
    drafted, names = tomllib.loads(out.read_text())["channels"], header.split(";")
    assert drafted["position"] == {"channels": [names[1], names[3]], "unit": ["m", "rad"]}
    assert (drafted["torque"]["channels"], drafted["torque"]["unit"]) == ([names[5]], "N")


@pytest.mark.parametrize(
    ("header", "columns", "time", "position", "torque"),
    [
        ("Zeit [ms];Winkel [°];Drehzahl [1/min];Drehmoment [Nm];Strom [A]",
         (1e3 * T, 50 * Q, 30 * Q, TAU, TAU), ("Zeit [ms]", "ms"), (["Winkel [°]"], "deg"),
         (["Drehmoment [Nm]"], "N m")),
        ("Time [ms];Angle [rad];Torque [Nm]", (T, Q, TAU),  # in s, by which they come at a likely rate
         ("Time [ms]", "s"), (["Angle [rad]"], "rad"), (["Torque [Nm]"], "N m")),
        ("Time(ms);Axis1.ActPos;Axis1.SetPos;Axis1.ActTorque", (1e3 * T, 50 * Q, 50 * Q, TAU),
         ("Time(ms)", "ms"), (["Axis1.ActPos"], "deg"), (["Axis1.ActTorque"], "N m")),
        ("IPOC;AIPos.A1;AIPos.A2;MACur.A1;MACur.A2", (1e3 * T, 50 * Q, 60 * Q, TAU, TAU),
         ("IPOC", "ms"), (["AIPos.A1", "AIPos.A2"], "deg"), (["MACur.A1", "MACur.A2"], "A")),
        ("tick;m[0].q;m[0].tauEst;m[1].q;m[1].tauEst", (1e3 * T, Q, TAU, Q, TAU),
         ("tick", "ms"), (["m[0].q", "m[1].q"], "rad"), (["m[0].tauEst", "m[1].tauEst"], "N m")),
        ("time;mp1;mp2;ip1;ip2;mt1;mt2;et1;et2", (T, Q, Q, Q, Q, TAU, TAU, 0 * T, 0 * T),
         ("time", "s"), (["mp1", "mp2"], "rad"), (["mt1", "mt2"], "N m")),
        ("time;hip_angle;knee_angle;hip_vel;knee_vel;hip_current;knee_current", (T, Q, Q, Q, Q, TAU, TAU),
         ("time", "s"), (["hip_angle", "knee_angle"], "rad"), (["hip_current", "knee_current"], "A")),
        ("time in s;Torque Nm;Angle/deg", (T, TAU, 50 * Q),
         ("time in s", "s"), (["Angle/deg"], "deg"), (["Torque Nm"], "N m")),
        ("micros;enc_count;pwm", (1e6 * T, np.rint(4000 * Q), np.rint(99 * TAU)),
         ("micros", "us"), (["enc_count"], "counts"), (["pwm"], "counts")),
        ("time;pos_estimate;vel_estimate;Iq_setpoint;Iq_measured", (T, Q, Q, TAU, TAU),
         ("time", "s"), (["pos_estimate"], "turn"), (["Iq_measured"], "A")),
        ("t;theta;i_d;i_q;V_motor;V_bus", (T, Q, TAU, TAU, TAU, TAU), ("t", "s"), (["theta"], "rad"), (["i_q"], "A")),
        ("Time[ms];Position[pulse];Speed[min-1];Torque reference[%]", (1e3 * T, np.rint(4000 * Q), Q, TAU),
         ("Time[ms]", "ms"), (["Position[pulse]"], "counts"), (["Torque reference[%]"], "counts")),
        ("t;alpha;theta;theta_v;V_m", (T, Q, Q, Q, TAU), ("t", "s"), (["theta"], "rad"), (["V_m"], "V")),
        ("t;qi1;qi2;dqi1;dqi2;u1;u2", (T, Q, Q, Q, Q, TAU, TAU),
         ("t", "s"), (["qi1", "qi2"], "rad"), (["u1", "u2"], "N m")),
        ("t;X1_meas;X2_meas;F1;F2;tq1;tq2", (T, Q, Q, Q, Q, TAU, TAU),
         ("t", "s"), (["X1_meas", "X2_meas"], "rad"), (["tq1", "tq2"], "N m")),
        ("时间;关节1位置;关节2位置;关节1速度;关节2速度;目标位置;关节1力矩;关节2力矩", (T, Q, Q, Q, Q, Q, TAU, TAU),
         ("时间", "s"), (["关节1位置", "关节2位置"], "rad"), (["关节1力矩", "关节2力矩"], "N m")),
        ("время;угол;скорость;момент", (T, Q, Q, TAU), ("время", "s"), (["угол"], "rad"), (["момент"], "N m")),
        ("millis;ticks1;ticks2;pwm1;pwm2", (1e3 * T, *np.rint([500 * Q, 500 * Q, 99 * TAU, 99 * TAU])),
         ("millis", "ms"), (["ticks1", "ticks2"], "counts"), (["pwm1", "pwm2"], "counts")),
        ("time;cart_position;pendulum_angle;cart_force;pendulum_torque", (T, Q, Q, TAU, TAU), ("time", "s"),
         (["cart_position", "pendulum_angle"], ["m", "rad"]), (["cart_force", "pendulum_torque"], ["N", "N m"])),
        ("t;x;F", (T, Q, TAU), ("t", "s"), (["x"], "m"), (["F"], "N")),
        ("t;joint_displacement1;joint_displacement2;torque1;torque2", (T, Q, P, TAU, TAU), ("t", "s"),
         (["joint_displacement1", "joint_displacement2"], "rad"), (["torque1", "torque2"], "N m")),
        ("t;x1;x2;x3;x4;u1;u2", (T, Q, P, np.gradient(Q, T), np.gradient(P, T), TAU, Q + np.cos(4 * T)),
         ("t", "s"), (["x1", "x2"], "rad"), (["u1", "u2"], "N m")),
        ("t;x;xdot;u", (T, Q, np.gradient(Q, T), TAU), ("t", "s"), (["x"], "m"), (["u"], "N")),
        ("t;x;x_dot;theta;theta_dot;F", (T, P, np.gradient(P, T), Q, np.gradient(Q, T), TAU), ("t", "s"), (["x"], "m"),
         (["F"], "N")),  # a pole's angle beside it, which the draft asks about
        ("t;target_x;x;q;current", (T, P, P, Q, TAU), ("t", "s"), (["x"], "m"), (["current"], "A")),
        ("t;x;q;tau", (T, P, Q, TAU), ("t", "s"), (["q"], "rad"), (["tau"], "N m")),  # of a hand, or of anything
        ("time;angle;angleD;torque", (T, Q, np.gradient(Q, T), TAU), ("time", "s"), (["angle"], "rad"),
         (["torque"], "N m")),
        ("time;angle;angleD;angleDD;torque", (T, Q, np.gradient(Q, T), P, TAU), ("time", "s"), (["angle"], "rad"),
         (["torque"], "N m")),
        ("t;ctrl1 [rad];q1 [rad];tau1", (T, Q + 0.01, Q, TAU), ("t", "s"), (["q1 [rad]"], "rad"), (["tau1"], "N m")),
        ("t;hip [deg];knee [rad];tau_hip [Nm];tau_knee [mNm]", (T, np.rad2deg(Q), P, TAU, 1e3 * TAU), ("t", "s"),
         (["hip [deg]", "knee [rad]"], ["deg", "rad"]), (["tau_hip [Nm]", "tau_knee [mNm]"], ["N m", "mN m"])),
        ("t [s];a1 q-axis [A];a1 position [rad];a1 torque [Nm];torque constant [Nm/A]", (T, TAU, Q, TAU, 9 * TAU),
         ("t [s]", "s"), (["a1 position [rad]"], "rad"), (["a1 torque [Nm]"], "N m")),  # of a dynamometer
        ("t [s];a1 pos [rad];a2 pos [rad];a1 torque [Nm];a2 torque [Nm];c1 pos [rev];c2 pos [rev];c1 U [V];c2 U [V];"
         "ina1 voltage [V];ina2 voltage [V]", (T, Q, P, TAU, Q + TAU, 0.2 * Q, 0.2 * P, TAU, P, 9 + P, 9 + Q),
         ("t [s]", "s"), (["a1 pos [rad]", "a2 pos [rad]"], "rad"), (["a1 torque [Nm]", "a2 torque [Nm]"], "N m")),
        ("t;rotor q [A];angle [rad]", (T, TAU, Q), ("t", "s"), (["angle [rad]"], "rad"), (["rotor q [A]"], "A")),
        ("time;qb;wb;I", (T, Q, np.gradient(Q, T), TAU), ("time", "s"), (["qb"], "rad"), (["I"], "A")),
        ("t;cart_pos_m;FORCE_MN", (T, Q, 50 * TAU), ("t", "s"), (["cart_pos_m"], "m"), (["FORCE_MN"], "mN")),
        ("t;piston_pos;piston_force", (T, 50 * Q, TAU), ("t", "s"), (["piston_pos"], "mm"), (["piston_force"], "N")),
        ("t;angle_x;angle_y;tau_x;tau_y", (T, Q, Q, TAU, TAU), ("t", "s"), (["angle_x", "angle_y"], "rad"),
         (["tau_x", "tau_y"], "N m")),
        ("t;PL.FB;VL.FB;IL.CMD;IL.FB", (T, Q, np.gradient(Q, T), TAU + 0.02 * np.sin(40 * T), TAU),
         ("t", "s"), (["PL.FB"], "rad"), (["IL.FB"], "N m")),
        ("time;elbow_pos;elbow_angle;elbow_torque", (T, Q, Q, TAU),  # two signals of one joint
         ("time", "s"), (["elbow_pos"], "rad"), (["elbow_torque"], "N m")),
        ("s;rad1;rad2;nm1;nm2", (T, Q, Q, TAU, TAU), ("s", "s"), (["rad1", "rad2"], "rad"), (["nm1", "nm2"], "N m")),
        ("time;rad_1;rad_2;rad_s_1;rad_s_2;Nm_1;Nm_2", (T, Q, Q, TAU, TAU, Q, Q),  # rates that do not fit
         ("time", "s"), (["rad_1", "rad_2"], "rad"), (["Nm_1", "Nm_2"], "N m")),
        ("ts;qs;us", (T, Q, TAU), ("ts", "s"), (["qs"], "rad"), (["us"], "N m")),
        # a long name of no known quantity, whose search for a unit must not take time exponential in its length
        ("t;q;tau;shunt dynamics as predicted by the outer loop of the environment", (T, Q, TAU, 10 * Q),
         ("t", "s"), (["q"], "rad"), (["tau"], "N m")),
        ("__time;/joint_states/position.hip;/joint_states/position.knee;/joint_states/effort.hip;/joint_states/effort.knee",
         (T, Q, Q, TAU, TAU), ("__time", "s"),
         (["/joint_states/position.hip", "/joint_states/position.knee"], "rad"),
         (["/joint_states/effort.hip", "/joint_states/effort.knee"], "N m")),
        ("Zeit;Istposition A1;Istposition A2;Iststrom A1;Iststrom A2", (T, 50 * Q, 50 * Q, TAU, TAU),
         ("Zeit", "s"), (["Istposition A1", "Istposition A2"], "deg"), (["Iststrom A1", "Iststrom A2"], "A")),
        ("t;motorAngle1;motorAngle2;motorTorque1;motorTorque2;jointAngle1;jointAngle2",
         (T, 50 * Q, 50 * Q, TAU, TAU, Q, Q),
         ("t", "s"), (["jointAngle1", "jointAngle2"], "rad"), (["motorTorque1", "motorTorque2"], "N m")),
        ("t;angvel;ang;trq", (T, 3 * Q, Q, TAU), ("t", "s"), (["ang"], "rad"), (["trq"], "N m")),
        ("t;q_raw;q;tau", (T, Q, Q, TAU), ("t", "s"), (["q"], "rad"), (["tau"], "N m")),
        ("t;q_raw;q1;q2;tau1;tau2", (T, Q, Q, Q, TAU, TAU),
         ("t", "s"), (["q1", "q2"], "rad"), (["tau1", "tau2"], "N m")),
        ("t;q_raw;tau_raw;u_raw", (T, Q, TAU, TAU), ("t", "s"), (["q_raw"], "rad"), (["tau_raw"], "N m")),
        ("t;q_d;q;dq_d;dq;tau_d;tau", (T, Q, Q, Q, Q, TAU, TAU), ("t", "s"), (["q"], "rad"), (["tau"], "N m")),
        ("t;q_d_1;q_d_2;q_1;q_2;tau_J_d_1;tau_J_d_2;tau_J_1;tau_J_2", (T, Q, Q, Q, Q, TAU, TAU, TAU, TAU),
         ("t", "s"), (["q_1", "q_2"], "rad"), (["tau_J_1", "tau_J_2"], "N m")),
        ("t;ID1_Present_Position;ID2_Present_Position;ID1_Present_Current;ID2_Present_Current",
         (T, *np.rint([3e3 * Q, 3e3 * Q]), TAU, TAU), ("t", "s"),
         (["ID1_Present_Position", "ID2_Present_Position"], "counts"),
         (["ID1_Present_Current", "ID2_Present_Current"], "A")),
        ("t;position_id1;position_id2;id1;iq1;id2;iq2", (T, Q, Q, TAU, TAU, TAU, TAU),
         ("t", "s"), (["position_id1", "position_id2"], "rad"), (["iq1", "iq2"], "A")),
        ("t;Gelenkwinkel 1;Gelenkwinkel 2;Motorstrom 1;Motorstrom 2", (T, Q, Q, TAU, TAU),
         ("t", "s"), (["Gelenkwinkel 1", "Gelenkwinkel 2"], "rad"), (["Motorstrom 1", "Motorstrom 2"], "A")),
        ("t;qpos_waist;qpos_wrist_angle;qpos_wrist_rotate;effort_waist;effort_wrist_angle;effort_wrist_rotate",
         (T, Q, Q, Q, TAU, TAU, TAU), ("t", "s"), (["qpos_waist", "qpos_wrist_angle", "qpos_wrist_rotate"], "rad"),
         (["effort_waist", "effort_wrist_angle", "effort_wrist_rotate"], "N m")),
        ("t;position.waist;position.elbow;position.wrist_angle;effort.waist;effort.elbow;effort.wrist_angle",
         (T, Q, Q, Q, TAU, TAU, TAU), ("t", "s"), (["position.waist", "position.elbow", "position.wrist_angle"], "rad"),
         (["effort.waist", "effort.elbow", "effort.wrist_angle"], "N m")),
        ("t;hip_pos;knee_pos;hip_pos_angle;hip_tau;knee_tau", (T, Q, Q, Q, TAU, TAU),
         ("t", "s"), (["hip_pos", "knee_pos"], "rad"), (["hip_tau", "knee_tau"], "N m")),
        ("t;q_counts;tau", (T, 50 * Q, TAU), ("t", "s"), (["q_counts"], "counts"), (["tau"], "N m")),  # of a mean
        ("t;E_pos;tau", (T, Q, np.gradient(Q, T)), ("t", "s"), (["E_pos"], "rad"), (["tau"], "N m")),
        ("t;E_q;q;tau", (T, Q, Q, TAU), ("t", "s"), (["q"], "rad"), (["tau"], "N m")),
        ("t;e_q;e_v;q;tau", (T, Q, Q, Q, TAU), ("t", "s"), (["q"], "rad"), (["tau"], "N m")),
        ("t;force_feedback;force_desired;position_degrees;position_radians;position_last;force_last_desired",
         (T, TAU, TAU, np.rad2deg(Q), Q, Q, TAU),
         ("t", "s"), (["position_radians"], "rad"), (["force_feedback"], "N m")),
        ("t;q1_rad;q2_rad;q1_deg;q2_deg;tau1;tau2", (T, Q, 2 * Q, np.rad2deg(Q), np.rad2deg(2 * Q), TAU, TAU),
         ("t", "s"), (["q1_rad", "q2_rad"], "rad"), (["tau1", "tau2"], "N m")),
        ("t;q1 [deg];q1 [rad];tau1", (T, np.rad2deg(Q), Q, TAU), ("t", "s"), (["q1 [rad]"], "rad"), (["tau1"], "N m")),
        ("t;boom_angle_deg;force_boom_MN", (T, 50 * Q, TAU),
         ("t", "s"), (["boom_angle_deg"], "deg"), (["force_boom_MN"], "MN")),
        ("t;stroke_mm;Kraft [kN]", (T, 50 * Q, TAU), ("t", "s"), (["stroke_mm"], "mm"), (["Kraft [kN]"], "kN")),
        ("t;ActPos;PosDiff;ActTorque [%]", (T, Q, Q, TAU),
         ("t", "s"), (["ActPos"], "rad"), (["ActTorque [%]"], "counts")),
        ("time;current_pos_x;current_pos_y;current_pos_z;joint_1;joint_2;joint_1_torque;joint_2_torque;force_x;force_y;force_z",
         (T, Q, Q, Q, Q, Q, TAU, TAU, TAU, TAU, TAU),
         ("time", "s"), (["joint_1", "joint_2"], "rad"), (["joint_1_torque", "joint_2_torque"], "N m")),
    ],
)  # fmt: skip
def test_headers_of_recorders(
    tmp_path: Path,
    header: str,
    columns: tuple[np.ndarray, ...],
    time: tuple[str, str],
    position: tuple[list[str], str | list[str]],
    torque: tuple[list[str], str | list[str]],
) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack(columns), fmt="%.5f", delimiter=";", header=header, comments="", encoding="utf-8")
    channels = tomllib.loads(survey(path).table)["channels"]
    assert (channels["time"], channels["time_unit"]) == time
    assert (channels["position"]["channels"], channels["position"]["unit"]) == position
    assert (channels["torque"]["channels"], channels["torque"]["unit"]) == torque


@pytest.mark.parametrize("joints", [(), (("shoulder",), ("elbow",), ("wrist",))])
def test_torques_are_in_the_order_of_the_positions_by_their_numbers(
    tmp_path: Path, joints: tuple[tuple[str, ...], ...]
) -> None:
    path = tmp_path / "log.csv"
    for names, torques, asked in (
        ("q1,q2,q3", "tau3,tau1,tau2", ["tau1", "tau2", "tau3"]),
        ("q_3,q_2,q_1", "u_1,u_2,u_3", ["u_3", "u_2", "u_1"]),
        ("q0,q1,q2", "u1,u2,u3", ["u1", "u2", "u3"]),
    ):
        columns = np.column_stack((T, Q, P, Q + P, TAU, TAU + P, TAU - P))
        np.savetxt(path, columns, delimiter=",", header=f"t,{names},{torques}", comments="")
        table = survey(path, joints=joints).table
        assert tomllib.loads(table)["channels"]["torque"]["channels"] == asked
        assert "check the order" not in table
    path.write_text(path.read_text().replace("u3", "u4"))
    assert "4 where those of the positions are 0, 1, 2: check the order" in survey(path, joints=joints).table


def test_displacements_of_revolute_joints_may_be_degrees(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack((T, 60 * Q, TAU)), header="t,displacement,torque", delimiter=",", comments="")
    channels = tomllib.loads(survey(path, joints=[("elbow",)], straight=[False]).table)["channels"]
    assert channels["position"]["unit"] == "deg"


@pytest.mark.parametrize(("straight", "unit"), [(True, "m"), (False, "rad")])
def test_the_device_decides_what_moves_straight(tmp_path: Path, straight: bool, unit: str) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack((T, Q, TAU)), delimiter=",", header="t,slider_pos,tau", comments="")
    channels = tomllib.loads(survey(path, joints=[("slider",)], straight=[straight]).table)["channels"]
    assert channels["position"]["unit"] == unit
    assert channels["torque"]["unit"] == ("N" if straight else "N m")


def test_torques_without_a_name_are_at_the_joint(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rate = np.gradient(Q, T)
    np.savetxt(path, np.column_stack((T, Q, rate, TAU)), delimiter=",", header="t,r482,r63,r80", comments="")
    torque = tomllib.loads(survey(path).table)["channels"]["torque"]
    assert torque == {"channels": ["r80"], "unit": "N m"}


def test_torques_that_look_like_velocities_are_torques(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack((T, Q, np.gradient(Q, T))), delimiter=",", header="t,a,tau", comments="")
    assert [c.quantity for c in survey(path).topics[0].channels] == ["time", "other", "torque"]


@pytest.mark.parametrize("name", ["tau [MNM]", "tau_MNM", "MNM_1"])
def test_units_in_capitals_that_may_be_milli_or_mega_are_said(tmp_path: Path, name: str) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack((T, Q, TAU)), delimiter=",", header=f"t,q,{name}", comments="")
    channel = survey(path).topics[0].channels[2]
    assert channel.unit == "mN m"
    assert channel.reason.endswith("which may also be MN m")


def test_the_joints_of_a_device_are_found_in_words_joined_by_an_underscore(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    header = "time,elbow_joint_pos,shoulder_pan_joint_pos,elbow_joint_effort,shoulder_pan_joint_effort"
    np.savetxt(path, np.column_stack((T, Q, Q, TAU, TAU)), delimiter=",", header=header, comments="")
    channels = tomllib.loads(survey(path, (("shoulder_pan_joint",), ("elbow_joint",))).table)["channels"]
    assert channels["position"]["channels"] == ["shoulder_pan_joint_pos", "elbow_joint_pos"]
    assert channels["torque"]["channels"] == ["shoulder_pan_joint_effort", "elbow_joint_effort"]


def test_short_arrays_beside_a_recording_are_not_drafted(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, angle=np.array([3.0, 4.0]), t=T, q=Q, tau=TAU, torque_limits=np.array([1.0, 2.0]))
    channels = tomllib.loads(survey(path).table)["channels"]
    assert (channels["position"]["channels"], channels["torque"]["channels"]) == (["q"], ["tau"])


def test_the_times_and_the_rate_are_those_of_the_whole_recording(tmp_path: Path) -> None:
    velocity = np.gradient(Q, 0.005)
    tenth = slice(None, None, 10)
    path = tmp_path / "log.npz"
    np.savez(path, T12=np.array([42.0, 84.0]), t_ds=T[tenth], q_ds=Q[tenth], t_all=T, q_all=Q, tau_all=TAU)
    channels = tomllib.loads(survey(path).table)["channels"]
    assert (channels["time"], channels["position"]["channels"]) == ("t_all", ["q_all"])
    np.savez(path, q_ds=Q[tenth], qd_ds=velocity[tenth], q_raw=Q, qd_raw=velocity, tau_raw=TAU)
    channels = tomllib.loads(survey(path).table)["channels"]
    assert channels["rate_hz"] == pytest.approx(200.0)
    assert channels["position"] == {"channels": ["q_raw"], "unit": "rad"}


def test_a_position_that_is_wrapped_is_drafted_to_be_unwrapped(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    wrapped = np.mod(30.0 * T + Q + 12.5, 25.0) - 12.5
    np.savetxt(path, np.column_stack((T, wrapped, TAU)), delimiter=",", header="time,position,torque", comments="")
    position = tomllib.loads(survey(path).table)["channels"]["position"]
    assert (position["unwrap"], position["period"]) == (True, 25)


def test_names_that_only_look_like_a_quantity() -> None:
    for name in (
        "water_level",
        "bus_voltage",
        "battery_current",
        "tcp_force",
        "position_error",
        "torque_limit",
        "pose",
        "i_d",
        "V_alpha",
        "PosDiff",
        "traj_pos_acc",
        "vbus_voltage",
        "Droop pulses",
    ):
        assert quantity_of(name) == "other", name
    assert [quantity_of(name) for name in ("dTheta", "theta_dot", "q_d", "load_angle")] == [
        "velocity", "velocity", "position", "position"
    ]  # fmt: skip
    assert {quantity_of(name) for name in ("dataDotQ", "dataDotQ_NF", "dotq", "dot_q1", "DotQ[1]")} == {"velocity"}
    assert {quantity_of(name) for name in ("ddTheta", "dataDDotQ", "ddotq", "DDotQ[2]")} == {"other"}
    assert [quantity_of(name) for name in ("v_joint1", "i_q", "Iq1", "V_motor", "v_q", "voltage_v")] == [
        "velocity", "torque", "torque", "torque", "torque", "torque"
    ]  # fmt: skip


def test_units_and_elements_in_brackets() -> None:
    assert unit_apart("speed(deg/s)") == ("speed", "deg/s")
    assert unit_apart("Motor A") == ("Motor A", "")
    assert unit_apart("/arm/m") == ("/arm/m", "")
    assert element_of("angle[deg]") is None
    assert element_of("position[arm/upper]") is not None
    assert element_of("position[2]") is not None
    assert [time_unit(name) for name in ("time_ms", "t", "record_time_nsec", "millis")] == ["ms", "", "ns", "ms"]


def test_torques_without_a_known_name_are_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    header = "t,q[1],q[2],m[1],m[2],x_set[1],x_set[2],acc[1],acc[2]"
    np.savetxt(path, np.column_stack((T, Q, Q, TAU, TAU, Q, Q, Q, Q)), delimiter=",", header=header, comments="")
    table = survey(path).table
    assert "torque" not in tomllib.loads(table)["channels"]
    assert table.rstrip().splitlines()[-2].endswith("; is it m[1..2]?")
    ready = "\n".join(line.removeprefix("# ") for line in table.splitlines() if line.startswith("# torque = {"))
    assert tomllib.loads(ready)["torque"] == {"field": "m", "joints": [1, 2], "unit": "N m"}


def test_accelerations_are_not_asked_for_as_torques(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", "t,q1,q2,ddq1,ddq2", T, Q, Q + 0.1 * TAU, TAU, TAU + Q)
    assert "ddq" not in survey(path).table
    assert "no channel of torques" in survey(path).table


def test_lists_of_elements_name_each_of_them() -> None:
    """`q[0]` and on, and joints that are not in a row, were all written as `q[1..n]`."""
    assert channel_list([f"q[{k}]" for k in (0, 1, 2)]) == "q[0..2]"
    assert channel_list([f"q[{k}]" for k in (1, 3, 7)]) == "q[1, 3, 7]"


def written(path: Path, header: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), fmt="%.5f", delimiter=",", header=header, comments="")
    return path


def test_the_rate_of_several_sources_is_that_of_the_positions(tmp_path: Path) -> None:
    own = np.arange(T.size) % 2 == 0
    times = T + np.where(own, 0.0, -0.004)  # the torque's row 1 ms after the position's
    path = written(tmp_path / "log.csv", "t,q,tau", times, np.where(own, Q, np.nan), np.where(own, np.nan, TAU))
    found = survey(path)
    assert found.topics[0].rate_hz == pytest.approx(100.0)
    assert any(f"100 Hz is the rate of the {own.sum()} rows with q" in note for note in found.notes)


def test_no_rate_is_stated_of_uneven_times(tmp_path: Path) -> None:
    uneven = np.cumsum(np.tile((0.001, 0.009), T.size // 2))
    (topic,) = survey(written(tmp_path / "uneven.csv", "t,q,tau", uneven, Q, TAU)).topics
    assert topic.rate_hz == 0
    assert "from 0.001 to 0.009: no one rate" in topic.channels[0].reason
    (topic,) = survey(written(tmp_path / "whole.csv", "t,q,tau", np.floor(50 * T), Q, TAU)).topics
    assert topic.rate_hz == 0
    assert topic.channels[0].quantity == "time"
    assert "75 % of the rows have the time of the row before" in topic.channels[0].reason
    paused = T + np.where(T > 2.0, 5.0, 0.0)
    (topic,) = survey(written(tmp_path / "paused.csv", "t,q,tau", paused, Q, TAU)).topics
    assert topic.rate_hz == pytest.approx(200.0)


def test_a_study_of_several_logs_needs_a_device(tmp_path: Path) -> None:
    files = [str(written(tmp_path / name, "t,q,tau", T, Q, TAU)) for name in ("a.csv", "b.csv")]
    result = CliRunner().invoke(app, ["channels", *files])
    assert result.exit_code == 2
    assert "2 logs" in result.output
    assert "--device DEVICE" in result.output


def test_a_log_without_a_known_position_asks_by_its_channels(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    table = np.column_stack((T, Q, 2 * Q, Q**2, TAU, Q + TAU))
    np.savetxt(path, table, delimiter=",", header="t,px,py,pz,a,b", comments="")
    result = CliRunner().invoke(app, ["channels", str(path)])
    asked = result.output.partition("[channels]  #")[2]
    assert "px, py, pz: of a point in space" in asked
    assert '"px", "py", "pz", "a", "b"' in asked
    assert tomllib.loads(f"[channels]  #{asked}")["channels"] == {"time": "t", "time_unit": "s"}


def test_torques_are_in_the_order_of_the_positions(tmp_path: Path) -> None:
    """By the joints' names, or as they come where these differ, which the draft says."""
    path = tmp_path / "log.csv"
    table = np.column_stack((T, *(k * Q for k in (1, 2, 3, 4)), *(k * TAU for k in (1, 2, 3, 4))))
    header = "t,q_SP,q_WP,q_WR,q_BASE,tau_BASE,tau_WR,tau_SP,tau_WP"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    made = survey(path).table
    assert tomllib.loads(made)["channels"]["torque"]["channels"] == ["tau_SP", "tau_WP", "tau_WR", "tau_BASE"]
    assert "check the order" not in made
    twice = header.replace("tau_BASE,tau_WR,tau_SP,tau_WP", "tau_SP,tau_WR,tau_WR,tau_BASE")
    np.savetxt(path, table, delimiter=",", header=twice, comments="")
    made = survey(path).table
    assert tomllib.loads(made)["channels"]["torque"]["channels"] == ["tau_SP", "tau_WR (1)", "tau_WR (2)", "tau_BASE"]
    assert "called WR (1), WR (2) where those of the positions are WP, WR: check the order" in made


def test_other_positions_are_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    trials = np.stack([np.column_stack((Q, 2 * Q, 3 * Q)), np.column_stack((3 * Q, Q, 2 * Q))], axis=2)
    np.savez(path, t=T, q=trials, tau=trials + TAU[:, None, None], q_des=Q)
    table = survey(path).table
    assert "# also positions: q[2][1..3]; of other joints, other trials" in table
    assert "q_des" not in table
    joints = [("a",), ("b",), ("c",)]
    assert "also positions" not in survey(path, joints=joints).table


@pytest.mark.parametrize(("name", "asked"), [("Torque", True), ("Measured_Torque", False)])
def test_currents_beside_torques_are_asked_about(tmp_path: Path, name: str, asked: bool) -> None:
    path = tmp_path / "log.csv"
    table = np.column_stack((T, Q, 2 * Q, TAU, 2 * TAU, TAU + Q, TAU - Q))
    header = f"t,Position1,Position2,{name}1,{name}2,Current1,Current2"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    line = next(line for line in survey(path).table.splitlines() if "also there: Current1, Current2" in line)
    assert ("computed by a controller's model" in line) is asked


def test_a_letter_in_brackets_is_a_unit_behind_a_space_and_a_joint_without() -> None:
    assert unit_apart("time [h]") == ("time", "h")
    assert unit_apart("current1 [a]") == ("current1", "a")
    assert element_of("time [h]") is None
    assert unit_apart("position[a]") == ("position[a]", "")


@pytest.mark.parametrize(
    "name", ["jointacttorque_filtered", "Elbow_tao", "tao2", "jointmeasuredtorque", "motoracttorque"]
)
def test_torques_in_words_written_together_or_by_ear(name: str) -> None:
    assert quantity_of(name) == "torque"


@pytest.mark.parametrize(("name", "unit"), [("milliseconds", "ms"), ("microseconds", "us"), ("nanoseconds", "ns")])
def test_times_that_are_called_by_their_unit(tmp_path: Path, name: str, unit: str) -> None:
    factor = {"ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    columns = np.column_stack((T * factor, Q, TAU))
    np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header=f"{name},q,tau", comments="")
    drafted = tomllib.loads(survey(tmp_path / "log.csv").table)["channels"]
    assert (drafted["time"], drafted["time_unit"]) == (name, unit)
