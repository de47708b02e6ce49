"""Loops that come with a URDF: joints in `<gazebo>`, and frames that an exporter writes at both ends of a loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid import DynamicModel
from haptid.dynamics.inverse import inverse_dynamics
from haptid.robot_files import import_robot
from haptid.robot_files.imported import ImportedRobot

# A five-bar with its bases 0.2 m apart and bars of 0.2 and 0.25 m; its tip is at (0.1, 0.35) with all joints at zero.
_BASE, _NEAR, _FAR = 0.2, 0.2, 0.25
_TIP = np.array([0.1, 0.35])
_PIN = (
    '<gazebo><joint name="pin" type="revolute"><parent>l2</parent><child>r2</child>'
    "<pose>0.25 0 0 0 0 0</pose>{}</joint></gazebo>"
)
_AXIS = "<axis><xyz>0 0 1</xyz></axis>"


def _link(name: str, mass: float, com: float) -> str:
    inertia = 'ixx="0.001" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"'
    return (
        f'<link name="{name}"><inertial><origin xyz="{com} 0.01 0"/><mass value="{mass}"/><inertia {inertia}/>'
        "</inertial></link>"
    )


def _hinge(name: str, parent: str, child: str, x: float, turn: float) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0" rpy="0 0 {turn!r}"/><axis xyz="0 0 1"/></joint>'
    )


def _frame(name: str, parent: str, x: float = _FAR) -> str:
    return (
        f'<link name="{name}"/><joint name="{name}_frame" type="fixed"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="{x} 0 0"/></joint>'
    )


def _turns(base: float, side: float) -> tuple[float, float]:
    """Angles of the two bars of a side, rad, by the law of cosines."""
    away = _TIP - [base, 0.0]
    r = float(np.hypot(*away))
    near = np.arctan2(away[1], away[0]) + side * np.arccos((_NEAR**2 + r**2 - _FAR**2) / (2 * _NEAR * r))
    rest = away - _NEAR * np.array([np.cos(near), np.sin(near)])
    return float(near), float(np.arctan2(rest[1], rest[0]) - near)


def five_bar(more: str) -> str:
    """A URDF of the open five-bar, with what is added to it."""
    (a1, a2), (b1, b2) = _turns(0.0, 1.0), _turns(_BASE, -1.0)
    links = _link("base", 1, 0) + _link("l1", 1, 0.1) + _link("l2", 0.5, 0.12) + _link("r1", 0.9, 0.1)
    joints = _hinge("qa1", "base", "l1", 0.0, a1) + _hinge("qa2", "l1", "l2", _NEAR, a2)
    joints += _hinge("qb1", "base", "r1", _BASE, b1) + _hinge("qb2", "r1", "r2", _NEAR, b2)
    return f'<robot name="five-bar">{links}{_link("r2", 0.4, 0.1)}{joints}{more}</robot>'


def imported(folder: Path, more: str) -> ImportedRobot:
    (folder / "five.urdf").write_text(five_bar(more))
    return import_robot(folder / "five.urdf")


def _driven(*joints: str) -> str:
    kind = "<type>transmission_interface/SimpleTransmission</type>"
    return "".join(
        f'<transmission name="of {name}">{kind}<joint name="{name}"/><actuator name="motor of {name}"/></transmission>'
        for name in joints
    )


@pytest.mark.parametrize("motors", ["", _driven("qa1", "qb1")])
def test_a_joint_in_gazebo_closes_a_loop(tmp_path: Path, motors: str) -> None:
    robot = imported(tmp_path, _PIN.format(_AXIS) + motors)
    assert [robot.device.joints[k].name for k in robot.device.active] == ["qa1", "qb1"]
    assert len(DynamicModel(robot.device).base.names) == 7 + 4  # of a five-bar in a vertical plane, and friction
    assert any("no transmission says what drives" in note.text for note in robot.notes) is (not motors)
    assert not any(note.grade == "left out" for note in robot.notes)


def test_motors_that_are_stated_are_the_active_joints(tmp_path: Path) -> None:
    robot = imported(tmp_path, _PIN.format(_AXIS) + _driven("qa1", "qa2"))
    assert [robot.device.joints[k].name for k in robot.device.active] == ["qa1", "qa2"]


@pytest.mark.parametrize(
    "other",
    [
        _frame("closing_tip_1", "l2") + _frame("closing_tip_2", "r2"),
        _PIN.format("<axis><xyz>0 0 -1</xyz><use_parent_model_frame>1</use_parent_model_frame></axis>"),
        _PIN.format("").replace("revolute", "ball"),
        _PIN.format('<axis><xyz expressed_in="__model__">0 0 1</xyz></axis>').replace("0 0</pose>", "0.7 0</pose>"),
    ],
)
def test_loops_said_in_another_way_are_the_same(tmp_path: Path, other: str) -> None:
    one, same = (imported(tmp_path, more) for more in (_PIN.format(_AXIS), other))
    models = [DynamicModel(robot.device) for robot in (one, same)]
    rng = np.random.default_rng(5)
    states = [0.1 * rng.standard_normal((2, 20)) for _ in range(3)]
    torques = [inverse_dynamics(model, model.base.of(model.device.chi_prior), *states) for model in models]
    np.testing.assert_allclose(torques[0], torques[1], atol=1e-9 * np.abs(torques[0]).max())


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            _frame("closing_tip_1", "l2") + _frame("closing_tip_2", "r2", 0.9),
            "0.65 m apart with all joints at zero, and meet at no",
        ),
        (_frame("closedloop_A", "l2") + _frame("closedloop_B", "r2"), "loops at closedloop_A, closedloop_B"),
        (_PIN.format(_AXIS).replace("revolute", "screw"), "joint pin in <gazebo>"),
        (_PIN.format(_AXIS).replace("<child>r2", "<child>r3"), "its links are none of this file"),
    ],
)
def test_a_loop_that_is_left_open_is_said(tmp_path: Path, more: str, said: str) -> None:
    robot = imported(tmp_path, more)
    assert len(robot.device.active) == 4
    (note,) = (note for note in robot.notes if note.grade == "left out")
    assert said in note.text
    assert "its torques are not those of the closed robot" in note.text


@pytest.mark.parametrize("reach", [0.1, 0.2, 0.23])
def test_ends_that_do_not_meet_at_zero_are_brought_together(tmp_path: Path, reach: float) -> None:
    """The device file was open there; the pose is that of the file's own kinematics, whose tips coincide."""
    robot = imported(tmp_path, _frame("closing_tip_1", "l2") + _frame("closing_tip_2", "r2", reach))
    assert len(robot.device.active) == 2
    assert not any(note.grade == "left out" for note in robot.notes)
    (said,) = (note.text for note in robot.notes if "m apart with all joints at zero" in note.text)
    assert f"{abs(_FAR - reach):.3g} m apart" in said
    assert "check that this is the robot's" in said
    near_a, near_b = robot.device.closure.at
    q = robot.device.closure.positions(np.array([[near_a], [near_b]]))[:, 0]
    (a1, a2), (b1, b2) = _turns(0.0, 1.0), _turns(_BASE, -1.0)
    tips = []
    for base, bars, angles in (
        (0.0, (_NEAR, _FAR), (a1 + q[0], a2 + q[1])),
        (_BASE, (_NEAR, reach), (b1 + q[2], b2 + q[3])),
    ):
        first, second = np.cumsum(angles)
        x = base + bars[0] * np.cos(first) + bars[1] * np.cos(second)
        tips.append((x, bars[0] * np.sin(first) + bars[1] * np.sin(second)))
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-9)
    for name, value in zip(("qa1", "qa2", "qb1", "qb2"), q, strict=True):
        assert f"{name} = {value:.4g}" in said


def test_the_pose_of_a_loop_is_within_the_limits(tmp_path: Path) -> None:
    """At the nearest pose, joint qa1 is at -0.08 rad."""
    more = _frame("closing_tip_1", "l2") + _frame("closing_tip_2", "r2", 0.2)
    limits = '<limit lower="{}" upper="{}" effort="1" velocity="1"/><axis xyz="0 0 1"/></joint><joint name="qa2"'
    text = five_bar(more).replace('<axis xyz="0 0 1"/></joint><joint name="qa2"', limits.format(0.05, 2.0))
    (tmp_path / "five.urdf").write_text(text)
    robot = import_robot(tmp_path / "five.urdf")
    assert len(robot.device.active) == 2
    assert robot.device.closure.at[0] >= 0.05
    text = five_bar(more).replace('<axis xyz="0 0 1"/></joint><joint name="qa2"', limits.format(2.0, 2.1))
    (tmp_path / "five.urdf").write_text(text)
    assert 2.0 <= import_robot(tmp_path / "five.urdf").device.closure.at[0] <= 2.1


def test_a_loop_that_mimic_joints_close_is_closed_once(tmp_path: Path) -> None:
    end = '</joint><joint name="qb1"'
    text = five_bar(_PIN.format(_AXIS)).replace(end, f'<mimic joint="qa1"/>{end}')
    (tmp_path / "five.urdf").write_text(text)
    robot = import_robot(tmp_path / "five.urdf")
    assert len(robot.device.active) == 3
    assert any("closes a loop that <mimic> closes" in note.text for note in robot.notes)


def test_joints_that_a_plugin_names_close_no_loop(tmp_path: Path) -> None:
    robot = imported(tmp_path, '<gazebo><plugin name="p"><joint>qa1</joint></plugin></gazebo>')
    assert not any("loop" in note.text for note in robot.notes)
