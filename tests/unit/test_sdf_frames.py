"""SDF: joints between frames and models in place of links, frames of sensors; comments with two dashes in any XML."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid.errors import RobotFileError
from haptid.robot_files import import_robot
from haptid.robot_files.imported import ImportedRobot
from haptid.robot_files.xml import parse

INERTIAL = (
    "<inertial><pose>0.1 0.02 0 0.3 0 0</pose><mass>{mass}</mass>"
    "<inertia><ixx>0.01</ixx><iyy>0.02</iyy><izz>0.025</izz></inertia></inertial>"
)
LINKS = (
    f'<link name="a"><pose>0 0 0.3 0 0.2 0</pose>{INERTIAL.format(mass=1)}</link>'
    f'<link name="b"><pose relative_to="a">0.5 0 0.1 0 0 0.3</pose>{INERTIAL.format(mass=0.4)}</link>'
)
AXIS = "<axis><xyz>0 1 0</xyz></axis>"


def imported(folder: Path, inside: str) -> ImportedRobot:
    (folder / "arm.sdf").write_text(f'<sdf version="1.9"><model name="arm">{inside}</model></sdf>')
    return import_robot(folder / "arm.sdf")


def joint(name: str, parent: str, child: str, pose: str = "") -> str:
    return f'<joint name="{name}" type="revolute">{pose}<parent>{parent}</parent><child>{child}</child>{AXIS}</joint>'


def assert_same(one: ImportedRobot, other: ImportedRobot) -> None:
    assert one.device.joint_names == other.device.joint_names == ("j1", "j2")
    assert max(one.check.torque, other.check.torque) < 1e-12
    for a, b in zip(one.device.joints, other.device.joints, strict=True):
        np.testing.assert_allclose(a.translation, b.translation, atol=1e-12)
        np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-12)
    np.testing.assert_allclose(one.device.chi_prior, other.device.chi_prior, atol=1e-12)


def test_a_joint_between_frames_is_one_between_their_links(tmp_path: Path) -> None:
    """Since SDF 1.7; a frame may be fixed to another one, and a joint's pose is relative to the child frame."""
    frames = (
        '<frame name="flange" attached_to="wrist"><pose>0.1 0 0 0 0 0</pose></frame>'
        '<frame name="wrist" attached_to="a"><pose>0.3 0 0 0 0 0.2</pose></frame>'
        '<frame name="hub" attached_to="b"><pose>-0.1 0 0.05 0.2 0 0</pose></frame>'
    )
    made = imported(tmp_path, LINKS + frames + joint("j1", "world", "a") + joint("j2", "flange", "hub"))
    at = '<pose relative_to="b">-0.1 0 0.05 0.2 0 0</pose>'
    assert_same(made, imported(tmp_path, LINKS + joint("j1", "world", "a") + joint("j2", "a", "b", at)))


@pytest.mark.parametrize("canonical", ["", ' canonical_link="root"'])
def test_a_joint_to_a_nested_model_is_one_to_its_canonical_link(tmp_path: Path, canonical: str) -> None:
    """The first link, or that which the model names. Its force sensor has a `<frame>`, which is none of the model."""
    sensor = "<sensor name='s' type='force_torque'><force_torque><frame>child</frame></force_torque></sensor>"
    root = f'<link name="root">{INERTIAL.format(mass=0.4)}{sensor}</link>'
    tip = f'<link name="tip"><pose>0.2 0 0 0 0 0</pose>{INERTIAL.format(mass=0.1)}</link>'
    weld = f'<joint name="weld" type="fixed"><parent>root</parent><child>tip</child>{sensor}</joint>'
    links = tip + root if canonical else root + tip
    hand = f'<model name="hand"{canonical}><pose relative_to="a">0.5 0 0.1 0 0 0.3</pose>{links}{weld}</model>'
    arm = LINKS.partition('<link name="b">')[0]
    first = joint("j1", "world", "a")
    made = imported(tmp_path, arm + hand + first + joint("j2", "a", "hand"))
    flat = (
        root.replace('name="root">', 'name="root"><pose relative_to="a">0.5 0 0.1 0 0 0.3</pose>')
        + tip.replace("<pose>0.2", '<pose relative_to="root">0.2')
        + weld
    )
    assert_same(made, imported(tmp_path, arm + flat + first + joint("j2", "a", "root")))


def test_frames_without_a_link_are_refused_in_a_sentence(tmp_path: Path) -> None:
    ring = '<frame name="f" attached_to="g"/><frame name="g" attached_to="f"/>'
    with pytest.raises(RobotFileError, match="parent 'f', which is attached to itself"):
        imported(tmp_path, LINKS + ring + joint("j1", "f", "a"))
    with pytest.raises(RobotFileError, match="child 'c', which is no link or frame"):
        imported(tmp_path, LINKS + joint("j1", "world", "c"))


def test_two_dashes_in_a_comment_are_no_error() -> None:
    """As of `gz sim --verbose`: urdfdom, Gazebo and MuJoCo read them, and places of elements stay as they are."""
    text = b'<robot a="--b"><!-- run --with this\n --><link name="x"/><![CDATA[<!-- -- -->]]></robot><!-- end -- -->'
    root = parse(text, "r.urdf")
    (link,) = root.children
    assert root.attributes == {"a": "--b"}
    assert "-- --" in root.text
    assert (link.line, text[link.start : link.end]) == (2, b'<link name="x"/>')
    assert parse(b"<robot><!------- links -------><a/><!------------></robot>", "r.urdf").children[0].tag == "a"
    with pytest.raises(RobotFileError, match="line 1: not XML"):
        parse(b"<robot><!-- not -- closed", "r.urdf")
