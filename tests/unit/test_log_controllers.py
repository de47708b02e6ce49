"""Drafts of tables as controllers and their clients write them: names that mislead, and states side by side."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import io

from haptid.errors import LogFileError
from haptid.log import Channels, Signal, read_log
from haptid.log.by_content import Content
from haptid.log.survey import survey
from haptid.log.survey.names import quantity_of

DT = 0.004
T = np.arange(0.0, 8.0, DT)
OMEGA, PHASE = np.array([1.3, 2.1, 3.4]), np.array([0.2, 1.9, 4.0])
Q = np.sin(OMEGA * T[:, None] + PHASE) + 0.3 * np.cos(2.3 * OMEGA * T[:, None])
QD, QDD = np.gradient(Q, DT, axis=0), np.gradient(np.gradient(Q, DT, axis=0), DT, axis=0)
TAU = QDD * [0.4, 0.3, 0.2] + 5 * np.sin(Q) + 2 * np.tanh(20 * QD) + QD[:, [1, 2, 0]]


def drafted(path: Path, **columns: np.ndarray) -> dict[str, Any]:
    """The drafted channels of a table whose columns are numbered."""
    numbered = {
        f"{name}_{k}" if values.ndim > 1 else name: column
        for name, values in columns.items()
        for k, column in enumerate(np.atleast_2d(values.T))
    }
    np.savetxt(path, np.column_stack(list(numbered.values())), delimiter=",", header=",".join(numbered), comments="")
    return dict(tomllib.loads(survey(path).table).get("channels", {}))


def test_what_a_universal_robot_sends(tmp_path: Path) -> None:
    """The controller's output was drafted as positions, and the joints' temperatures and modes with it."""
    path = tmp_path / "log.csv"
    motion = {
        "timestamp": T,
        "target_q": Q + 1e-3,
        "actual_q": Q,
        "actual_qd": QD,
        "joint_temperatures": 30 + Q,
        "joint_mode": np.full_like(Q, 253.0),
        "actual_TCP_pose": np.hstack([Q, 0.1 * Q]),
        "actual_TCP_force": np.hstack([TAU, TAU]),
        "actual_joint_voltage": 47 + 0.2 * np.abs(Q),
    }
    names = [f"actual_current_{k}" for k in range(3)]
    found = drafted(path, **motion, target_moment=TAU, joint_control_output=TAU / 9, actual_current=TAU / 10)
    assert found["position"]["channels"] == [f"actual_q_{k}" for k in range(3)]
    assert found["velocity"]["channels"] == [f"actual_qd_{k}" for k in range(3)]
    assert (found["torque"]["channels"], found["torque"]["unit"]) == (names, "A")
    found = drafted(path, **motion, joint_control_output=TAU / 9)
    assert found["torque"]["channels"] == [f"joint_control_output_{k}" for k in range(3)]
    assert (found["torque"]["unit"], found["torque"]["side"]) == ("A", "motor")
    found = drafted(path, **motion, target_moment=TAU)
    assert found["torque"]["channels"] == [f"target_moment_{k}" for k in range(3)]
    assert "torque" not in drafted(path, **motion)


def test_the_output_of_another_controller_is_no_current(tmp_path: Path) -> None:
    """Of whatever unit it is, it was drafted in A."""
    assert "torque" not in drafted(tmp_path / "log.csv", t=T, q=Q, control_output=TAU / 99)


def test_the_word_joint_alone_names_no_position_beside_what_is_none() -> None:
    names = ("joint_temperatures_1", "joint_mode_1", "joint_power_1", "joint_status_1", "joint_ratio_1")
    assert {quantity_of(name) for name in names} == {"other"}
    assert quantity_of("joint_1") == "position"


@pytest.mark.parametrize("head", ["pose", "joint_pose"])
def test_numbered_poses_beside_rates_are_positions(tmp_path: Path, head: str) -> None:
    """Also where their rates are of the other sign, by which they are not known."""
    path = tmp_path / "log.csv"
    found = drafted(path, **{"t": T, head: Q, "vel": -QD, "current": TAU})
    assert found["position"] == {"channels": [f"{head}_{k}" for k in range(3)], "unit": "rad"}
    assert found["torque"]["unit"] == "A"
    assert "position" not in drafted(path, t=T, tcp_pose=Q, vel=-QD, current=TAU)
    assert "position" not in drafted(path, t=T, pose=Q, vel=-QD[:, :2], current=TAU[:, :2])


def test_what_is_called_a_current_stays_one_beside_positions_that_are_told_by_their_rates(tmp_path: Path) -> None:
    """It was drafted in N m."""
    found = drafted(tmp_path / "log.csv", t=T, a=Q, vel=QD, extra=TAU[:, ::-1] ** 2, current=TAU)
    assert found["position"]["channels"] == ["a_0", "a_1", "a_2"]
    assert found["torque"]["channels"] == ["current_0", "current_1", "current_2"]
    assert found["torque"]["unit"] == "A"


def test_a_position_that_turns_on_evenly_is_no_time() -> None:
    """It was taken for the time, and the torque for nothing; the rate was told two thirds of what it is."""
    turning, rate = 3 * T + 0.2 * Q[:, 0], 3 + 0.2 * QD[:, 0]
    slow, its_rate = T + 1e-3 * Q[:, 0], 1 + 1e-3 * QD[:, 0]
    for own, dot in ((turning, rate), (slow, its_rate)):
        found = Content.of({"a": own, "b": dot, "c": TAU[:, 0]})
        assert (found.time, found.positions, found.torques) == ("", ("a",), ("c",))
        assert found.dt == pytest.approx(DT, rel=0.02)
        found = Content.of({"t": T, "a": own, "b": dot, "c": TAU[:, 0]})
        assert (found.time, found.positions, found.torques) == ("t", ("a",), ("c",))
    jittered = T + 2e-4 * np.random.default_rng(3).standard_normal(T.size).clip(-1, 1)
    assert Content.of({"t": jittered, "a": Q[:, 0], "b": QD[:, 0], "c": TAU[:, 0]}).time == "t"


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6], ids=["s", "ms", "us"])
@pytest.mark.parametrize("after", [False, True])
def test_the_steps_of_a_clock_are_no_velocity_and_no_torque(unit: float, after: bool) -> None:
    """A time whose steps are recorded beside it was drafted as a torque, or as a joint with these as its velocity."""
    rng = np.random.default_rng(6)
    clock = np.cumsum(DT * (1 + 0.05 * rng.standard_normal(T.size)))
    steps = unit * np.diff(clock, **({"append": clock[-1] + DT} if after else {"prepend": 0.0}))
    arm = {f"{name}{k}": values[:, k] for name, values in (("q", Q), ("qd", QD), ("tau", TAU)) for k in range(3)}
    for columns in ({"t": clock, "dt": steps, **arm}, {"t": clock, **arm, "dt": steps}):
        found = Content.of(columns)
        assert (found.time, found.positions) == ("t", ("q0", "q1", "q2"))
        assert found.torques == ("tau0", "tau1", "tau2")


def test_a_velocity_at_one_kilohertz_is_not_the_steps_of_a_clock() -> None:
    """The position grows by a thousandth of it, as seconds do by milliseconds."""
    t = 1e-3 * np.arange(6000)
    turning, rate = 3 * t + 0.2 * np.sin(5 * t), 3 + np.cos(5 * t)
    found = Content.of({"a": turning, "b": rate, "c": np.sign(rate - 3) + 0.1 * np.cos(9 * t)})
    assert (found.time, found.positions, found.torques) == ("", ("a",), ("c",))


@pytest.mark.parametrize("rows", ["columns", "transposed", "by joint", "pairs", "no time"])
def test_states_in_one_array_are_told_by_their_rates(tmp_path: Path, rows: str) -> None:
    """`Q = [q qd qdd]` was drafted as the positions of nine joints."""
    values = {
        "by joint": np.stack([Q, QD, QDD], axis=2).reshape(T.size, -1),
        "pairs": np.hstack([Q, QD]),
    }.get(rows, np.hstack([Q, QD, QDD]))
    saved = {"Q": values, "tau": TAU} | ({} if rows == "no time" else {"t": T})
    io.savemat(tmp_path / "log.mat", {name: x.T if rows == "transposed" else x for name, x in saved.items()})
    table = survey(tmp_path / "log.mat").table
    found = tomllib.loads(table)["channels"]
    places = ([1, 4, 7], [2, 5, 8]) if rows == "by joint" else ([1, 2, 3], [4, 5, 6])
    assert (found["position"]["joints"], found["velocity"]["joints"]) == places
    assert found["torque"] == {"field": "tau", "joints": [1, 2, 3], "unit": "N m"}
    assert found.get("rate_hz") == (250 if rows == "no time" else None)


def test_two_joints_that_move_as_a_circle_are_the_state_of_one_where_there_is_one_torque(tmp_path: Path) -> None:
    circle = np.column_stack([np.sin(T), np.cos(T)])
    for count in (2, 1):
        np.savez(tmp_path / "log.npz", t=T, q=circle, tau=TAU[:, :count])
        found = tomllib.loads(survey(tmp_path / "log.npz").table)["channels"]
        assert ("velocity" in found) is (count == 1)


def test_rows_that_were_damaged_tell_no_unit(tmp_path: Path) -> None:
    """Positions were drafted in degrees, and half of the velocities in rad/s, by seven rows at the start of a file."""
    table = np.column_stack([T, Q, QD, TAU])
    table[1, 1:4], table[3, [2, 5, 9]] = 253.0, 1e282
    np.savetxt(tmp_path / "log.csv", table, delimiter=",")
    found = survey(tmp_path / "log.csv")
    channels = tomllib.loads(found.table)["channels"]
    assert channels["position"] == {"field": "column", "joints": [2, 3, 4], "unit": "rad"}
    assert channels["velocity"]["unit"] == "rad/s"
    (note,) = (note for note in found.notes if note.startswith("column[3]"))
    assert "values up to 1e+282 in rows 2, 4, far beyond all others" in note
    assert survey(written(tmp_path, np.column_stack([T, 90 * Q, QD, TAU]))).notes == found.notes[:1]


def written(folder: Path, table: np.ndarray) -> Path:
    np.savetxt(folder / "other.csv", table, delimiter=",")
    return folder / "other.csv"


def test_velocities_are_in_the_unit_of_their_positions(tmp_path: Path) -> None:
    """A joint that moves little fits radians too, and so its velocity was drafted beside others in degrees."""
    small = np.array([1.0, 90.0, 60.0])
    found = drafted(tmp_path / "log.csv", t=T, q=Q * small, qd=QD * small, tau=TAU)
    assert (found["position"]["unit"], found["velocity"]["unit"]) == ("deg", "deg/s")


def test_a_torque_like_another_signal_stays_in_its_block(tmp_path: Path) -> None:
    """The third torque was passed over for a column of the next block."""
    ripple = 0.18 * Q[:, 2].std() * np.sign(np.sin(90 * T))
    table = np.column_stack([T, Q, QD, TAU[:, :2], 1.05 * Q[:, 2] + ripple, TAU * 0.9 + 0.2])
    found = tomllib.loads(survey(written(tmp_path, table)).table)["channels"]
    assert found["torque"]["joints"] == [8, 9, 10]


def test_a_plan_in_another_unit_adds_no_joint(tmp_path: Path) -> None:
    """A planned velocity in rad/s beside degrees, whose rate is there too, was drafted as one joint more."""
    plan = [np.deg2rad(x) for x in (90 * Q, 90 * QD, 90 * QDD)]
    noise = 1e-3 * np.random.default_rng(4).standard_normal(Q.shape)
    table = np.column_stack([T, 90 * (Q + noise), 90 * QD, TAU, *plan])
    found = tomllib.loads(survey(written(tmp_path, table)).table)["channels"]
    assert (found["position"]["joints"], found["position"]["unit"]) == ([2, 3, 4], "deg")
    assert found["torque"]["joints"] == [8, 9, 10]


def test_a_position_that_is_called_one_is_no_time(tmp_path: Path) -> None:
    """That of a wheel, or of a body that walks on, was drafted as the time where there is none."""
    found = drafted(tmp_path / "log.csv", q_wheel=3 * T + 0.1 * Q[:, 0], q_arm=Q[:, 1], tau_wheel=TAU[:, 0])
    assert "time" not in found
    assert found["position"]["channels"] == ["q_wheel", "q_arm"]


def test_a_rate_that_no_log_has_is_not_drafted(tmp_path: Path) -> None:
    """A position that is wrapped, and its rate in another unit, told a hundredth of a hertz."""
    found = drafted(tmp_path / "log.csv", theta=Q[:, 0], theta_dot=1e-4 * QD[:, 0], current=TAU[:, 0])
    assert "rate_hz" not in found


def test_a_matrix_as_a_laboratory_s_controller_writes_it(tmp_path: Path) -> None:
    """Brackets and semicolons around the rows, names of two words: the effort was no channel, the first row lost."""
    rows = np.column_stack([np.arange(T.size), T, np.rint(50 * Q[:, 0]), np.rint(4000 * Q[:, :2]), TAU[:, 0] / 9])
    form = "%5d %8.3f %15d %15d %15d %15.4f"
    lines = [form % tuple(row) for row in rows]
    head = " Sample   Time     Commanded Pos   Encoder 1 Pos   Encoder 2 Pos   Control Effort\r\n\r\n"
    (tmp_path / "log.txt").write_text(head + "[" + ";\r\n ".join(lines) + "];\r\n", newline="")
    found = survey(tmp_path / "log.txt")
    assert found.topics[0].count == T.size
    channels = tomllib.loads(found.table)["channels"]
    assert channels["time"] == "Time"
    assert channels["position"]["channels"] == ["Encoder 1 Pos", "Encoder 2 Pos"]
    assert channels["torque"]["channels"] == ["Control Effort"]
    position = Signal("Encoder 1 Pos", "counts", gain=1e-3)
    log = read_log(tmp_path / "log.txt", Channels(position, Signal("Control Effort", "N m"), "Time"))
    np.testing.assert_allclose(log.torque[:, 0], np.round(rows[:, 5], 4), atol=1e-12)


@pytest.mark.parametrize("ends", ["];\n", "\n];\n", "\n]"])
@pytest.mark.parametrize("begins", ["A = [ ", "log.A=[", "[", "% of a test\nA = [", "A = [\n"])
def test_the_name_of_a_matrix_before_its_first_row(tmp_path: Path, begins: str, ends: str) -> None:
    """It was read as the only column."""
    path, rows = tmp_path / "log.txt", np.column_stack([T, Q, QD, TAU])
    text = ";\n".join(" ".join(f"{x:.9f}" for x in row) for row in rows)
    path.write_text(begins + text + ends)
    channels = tomllib.loads(survey(path).table)["channels"]
    assert (channels["time"], channels["torque"]["joints"]) == ("column[1]", [8, 9, 10])
    log = read_log(path, Channels(Signal("column[2]", "rad"), Signal("column[8]", "N m"), "column[1]"))
    np.testing.assert_allclose(log.position[:, 0], Q[:, 0], atol=1e-9)
    path.write_text(begins + text + "];\nB = [" + text + ends)  # another one is no continuation
    with pytest.raises(LogFileError, match="12 cells where the header has 10") as refused:
        read_log(path, Channels(Signal("column[2]", "rad"), Signal("column[8]", "N m"), "column[1]"))
    assert refused.value.where == T.size + 1 + begins.count("\n")


def test_what_stands_still_and_what_falls_is_no_joint_and_no_time() -> None:
    """Servo registers of which two move: ten were drafted as positions, and one that rises evenly as the time."""
    still = np.tile([40.0, 334, 2000, 1, 8801, 0, 18800], (T.size, 1))
    moving, rates, rising = np.rint(2000 * Q[:, :2]), np.rint(2000 * QD[:, :2]), np.rint(-16899 + 900 * T)
    table = np.column_stack([moving[:, 0], rates, still, moving[:, 1], rising])
    found = Content.of({f"c{k}": column for k, column in enumerate(table.T)})
    assert found.time == ""
    assert found.positions == ("c0", "c10")


def test_a_pair_apart_from_a_block_of_joints_is_none_more(tmp_path: Path) -> None:
    """Errors of a controller whose sums look alike were drafted as joints; a joint more has its rate beside it."""
    slow, rate = 0.4 * np.sin(0.8 * T + 1), 0.32 * np.cos(0.8 * T + 1)
    for parts, joints in (([slow, TAU[:, ::-1], rate], [2, 3, 4]), ([slow, rate, TAU[:, ::-1]], [2, 3, 4, 11])):
        table = np.column_stack([T, Q, QD, TAU, *parts])
        assert tomllib.loads(survey(written(tmp_path, table)).table)["channels"]["position"]["joints"] == joints


def test_a_position_of_many_turns_is_in_no_unit_until_one_is_told(tmp_path: Path) -> None:
    """A motor of 600 turns was drafted in degrees, as ten."""
    np.savez(tmp_path / "log.npz", t=T, theta=188.4 * T + Q[:, 0], current=TAU[:, 0])
    (line,) = (line for line in survey(tmp_path / "log.npz").table.splitlines() if line.startswith("position"))
    assert 'unit = "counts"' in line
    assert "4.18 turns where it is in degrees, 240 where in rad, which neither its torque nor its swing tells" in line
    np.savez(tmp_path / "log.npz", t=T, motor_pos_1=1500 * Q[:, 0], motor_pos_2=Q[:, 1], current=TAU[:, :2])
    (line,) = (line for line in survey(tmp_path / "log.npz").table.splitlines() if line.startswith("position"))
    assert 'unit = "counts", side = "motor" }' in line
    turns = 300.0 * Q[:, 0]
    weight = 2.0 * np.cos(turns) + 0.1 * np.gradient(turns, T)
    np.savez(tmp_path / "log.npz", t=T, theta=turns, tau=weight)
    (line,) = (line for line in survey(tmp_path / "log.npz").table.splitlines() if line.startswith("position"))
    assert 'unit = "rad"' in line


def test_one_pair_by_chance_among_many_columns_is_no_joint(tmp_path: Path) -> None:
    """Thirty columns of an arm that is pushed: a current was a position, and a position its rate."""
    others = np.sin((1 + 0.37 * np.arange(12)) * T[:, None] + np.arange(12) ** 2)
    pushed = others.copy()
    pushed[:, 3], pushed[:, 10] = QD[:, 0], Q[:, 0]
    assert not survey(written(tmp_path, np.column_stack([T, pushed]))).table
    few = np.column_stack([T, Q[:, 0], TAU[:, 0], QD[:, 0]])
    assert tomllib.loads(survey(written(tmp_path, few)).table)["channels"]["position"]["channels"] == ["column[2]"]


def test_one_joint_of_an_arm_that_moves_is_in_its_block(tmp_path: Path) -> None:
    rest = 1e-4 * np.random.default_rng(8).standard_normal((3, T.size, 3))
    for moves in range(3):
        blocks = [part + own * (np.arange(3) == moves) for part, own in zip(rest, (Q, QD, TAU), strict=True)]
        found = tomllib.loads(survey(written(tmp_path, np.column_stack([T, *blocks]))).table)["channels"]
        assert (found["position"]["joints"], found["torque"]["joints"]) == ([2, 3, 4], [8, 9, 10])


def test_voltages_of_motors_about_an_operating_point_are_those_of_no_supply(tmp_path: Path) -> None:
    """They were left out, and the draft asked for them in N m."""
    path, about = tmp_path / "log.csv", 12 + 0.5 * TAU / np.abs(TAU).max(axis=0)
    found = drafted(path, time=T, motor_pos=Q[:, 0], motor_voltage=about[:, 0])
    assert found["torque"] == {"channels": ["motor_voltage"], "unit": "V", "side": "motor"}
    found = drafted(path, t=T, q=Q, voltage=about + [0, 4, 0] * TAU / np.abs(TAU).max(axis=0))
    assert found["torque"] == {"channels": [f"voltage_{k}" for k in range(3)], "unit": "V", "side": "motor"}
    assert "torque" not in drafted(path, t=T, q=Q, voltage=about)
    assert '# torque = { channels = ["voltage_0", "voltage_1", "voltage_2"], unit = "V"' in survey(path).table
