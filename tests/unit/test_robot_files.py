"""Robot descriptions as device files: what is read, what is said, what is refused."""

from __future__ import annotations

import math
import re
import time
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.device.geometry import angles, placed
from haptid.errors import HaptidError, RobotFileError
from haptid.robot_files import ImportedRobot, import_robot
from haptid.robot_files.device_file import clean_names
from json_outputs import valid

ARM = """<?xml version="1.0"?>
<!-- kept -->
<robot name="two-links">
  <link name="base_link"/>
  <link name="upper.arm">
    <inertial><origin xyz="0.1 0 0.02" rpy="0.3 0 0"/><mass value="1.2"/>
      <inertia ixx="0.01" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.015"/></inertial>
  </link>
  <link name="tool"><inertial><origin xyz="0 0 0.05"/><mass value="0.3"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <link name="fore"/>
  <link name="slider"><inertial><mass value="0.5"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="shoulder-pan" type="revolute">
    <parent link="base_link"/><child link="upper.arm"/><origin xyz="0 0 0.3" rpy="3.14159 0 0"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="1.5" velocity="2" effort="30"/><dynamics damping="0.2" friction="0.1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper.arm"/><child link="fore"/><origin xyz="0.4 0 0" rpy="0 0.4 0"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="mount" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0.2 0 0" rpy="0 0 1"/></joint>
  <joint name="rail" type="prismatic">
    <parent link="fore"/><child link="slider"/><origin rpy="0 0 0.5"/>
    <limit lower="-1" upper="1" effort="9" velocity="1"/><mimic joint="elbow" multiplier="-0.1" offset="0.2"/>
  </joint>
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="elbow"/>
    <actuator name="m"><mechanicalReduction>50</mechanicalReduction><motorInertia>1e-5</motorInertia></actuator>
  </transmission>
</robot>
"""


def imported(folder: Path, text: str, name: str = "robot.urdf", **options: object) -> ImportedRobot:
    path = folder / name
    path.write_text(text)
    return import_robot(path, **options)  # type: ignore[arg-type]


def test_a_urdf_becomes_a_device_with_its_torques(tmp_path: Path) -> None:
    """Fixed links merged, rotated inertials, a mimic joint, a gear with its motor's inertia: all in the torque."""
    robot = imported(tmp_path, ARM)
    device = robot.device
    assert robot.check.torque < 1e-12
    assert [device.joints[k].name for k in device.active] == ["shoulder_pan", "elbow"]
    assert [joint.alias for joint in device.joints] == ["shoulder-pan", "", ""]
    assert {drive.name: drive.gear_ratio for drive in device.drives} == {"shoulder_pan": 1.0, "elbow": 50.0}
    assert device.prior["IAelbow"].value == pytest.approx(1e-5 * 2500)
    assert device.joints[0].position_limits == (-1.0, 1.5)
    assert device.closure.relations == ("qrail = 0.2 - 0.1*qelbow",)


def test_rotor_inertia_that_a_description_lacks_is_said_and_ready(tmp_path: Path) -> None:
    """It was said nowhere, and a geared robot was identified without it."""
    robot = imported(tmp_path, ARM)
    assert robot.without_rotor == ("shoulder_pan",)
    told = CliRunner().invoke(app, ["import", str(tmp_path / "robot.urdf"), "--out", str(tmp_path / "arm.toml")])
    assert "Rotor inertia of shoulder_pan is not included" in told.output
    assert "uncomment its term in arm.toml" in " ".join(told.output.split())
    text = (tmp_path / "arm.toml").read_text()
    for line in ("[[terms]]", 'kind = "rotor-inertia"', 'joints = ["shoulder_pan"]'):
        text = text.replace(f"# {line}", line)
    (tmp_path / "with.toml").write_text(text)
    device = haptid.read_device(tmp_path / "with.toml")
    assert {term.on for term in device.terms if term.kind == "rotor"} == {"joint elbow", "joint shoulder_pan"}


def test_a_weld_to_an_undeclared_world_is_the_base(tmp_path: Path) -> None:
    weld = '<joint name="weld" type="fixed"><parent link="world"/><child link="base_link"/></joint>\n</robot>'
    welded, plain = imported(tmp_path, ARM.replace("</robot>", weld), "welded.urdf"), imported(tmp_path, ARM)
    for one, other in zip(welded.device.joints, plain.device.joints, strict=True):
        assert (one.name, one.parent) == (other.name, other.parent)
        np.testing.assert_array_equal(one.translation, other.translation)
    assert welded.check.torque < 1e-12


def test_a_urdf_that_xacro_has_written_is_read_without_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("haptid.robot_files.read.expand_xacro", None)
    text = ARM.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    tables = [imported(tmp_path, one).text.partition("\n\n")[2] for one in (text, ARM)]
    assert tables[0] == tables[1]


def test_the_file_is_read_back_as_the_same_device(tmp_path: Path) -> None:
    robot = imported(tmp_path, ARM)
    robot.save(tmp_path / "made.toml")
    again = haptid.read_device(tmp_path / "made.toml")
    assert again.joint_names == robot.device.joint_names
    assert again.prior == robot.device.prior
    assert "# - gravity: URDF has none" in robot.text


def test_a_moving_link_without_inertial_is_an_unknown_body(tmp_path: Path) -> None:
    """Not a massless one: its parameters are there to be identified, and have no prior."""
    text = re.sub(r"<inertial>.*?</inertial>", "", ARM, flags=re.DOTALL)
    robot = imported(tmp_path, text)
    assert all(joint.body for joint in robot.device.joints)
    assert not any(name.startswith(("M", "X")) for name in robot.device.prior)
    assert len(haptid.DynamicModel(robot.device).base) > 10
    assert sum("unknown" in note.text for note in robot.notes) == 3


def test_snapping_removes_parameters_that_rounding_invents(tmp_path: Path) -> None:
    """3.14159 is not pi: the shoulder of this arm has a slanted axis, which lets gravity act on it."""
    rounded, snapped = (imported(tmp_path, ARM, snap=snap) for snap in (0.0, 1e-4))
    counts = [len(haptid.DynamicModel(x.device).base) for x in (rounded, snapped)]
    models = [haptid.DynamicModel(x.device) for x in (rounded, snapped)]
    assert counts[1] < counts[0]
    assert len(models[0].only_by_rounding) == counts[0] - counts[1]
    assert set(models[1].base.names).isdisjoint(models[0].only_by_rounding)
    assert models[1].only_by_rounding == ()
    assert rounded.snapped is None
    assert snapped.snapped is not None
    assert 0 < snapped.snapped < 1e-4


def test_root_tip_and_held_joints(tmp_path: Path) -> None:
    assert imported(tmp_path, ARM, root="upper.arm").device.joint_names == ("elbow", "rail")
    chain = imported(tmp_path, ARM, tip="upper.arm")
    assert chain.device.joint_names == ("shoulder_pan",)
    held = imported(tmp_path, ARM, hold={"elbow": 0.3})
    assert held.source.held["rail"] == pytest.approx(0.2 - 0.03)
    assert held.device.joint_names == ("shoulder_pan",)
    assert held.device.prior["Mshoulder_pan"].value == pytest.approx(1.2 + 0.3 + 0.5)
    with pytest.raises(RobotFileError, match="elbow"):
        imported(tmp_path, ARM, hold={"ellbow": 0.3})
    only = imported(tmp_path, ARM, only=["elbow"], hold={"shoulder-pan": 0.1})
    assert (only.device.joint_names, only.source.held["shoulder-pan"]) == (("elbow", "rail"), 0.1)
    assert imported(tmp_path, ARM, only=["shoulder-pan"]).source.held["rail"] == pytest.approx(0.2)
    by_device = imported(tmp_path, ARM, hold={"shoulder_pan": 0.1})  # as the device file spells it
    assert by_device.source.held["shoulder-pan"] == 0.1
    with pytest.raises(RobotFileError, match="elbow"):
        imported(tmp_path, ARM, only=["ellbow"])
    made = ["import", str(tmp_path / "robot.urdf"), "--only", "elbow,shoulder-pan", "--out", str(tmp_path / "arm.toml")]
    assert "3 joints" in CliRunner().invoke(app, made).output


def wrong(old: str, new: str, count: int = 1) -> str:
    assert old in ARM
    return ARM.replace(old, new, count)


DEEP = "<robot name='x'>" + "<a>" * 20_000 + "</a>" * 20_000 + "</robot>"
LINKS = "".join(f'<link name="l{k}"/>' for k in range(20_001))
JOINTS = "".join(
    f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/></joint>' for k in range(20_000)
)
HOSTILE = {
    "doctype": ARM.replace("<robot", '<!DOCTYPE r [<!ENTITY a "b">]><robot', 1),
    "external entity": ARM.replace("<robot", '<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot', 1),
    "no XML": ARM[:300],
    "empty": "",
    "undefined entity": wrong('value="1.2"', 'value="&mass;"'),
    "NaN": wrong('value="1.2"', 'value="nan"'),
    "overflow": wrong('value="1.2"', 'value="1e999"'),
    "words": wrong('xyz="0.1 0 0.02"', 'xyz="0.1 0"'),
    "underscores": wrong('value="1.2"', 'value="1_2"'),
    "negative mass": wrong('value="1.2"', 'value="-1.2"'),
    "no mass": wrong('<mass value="1.2"/>', ""),
    "zero axis": wrong('xyz="0 0 2"', 'xyz="0 0 0"'),
    "unknown type": wrong('type="continuous"', 'type="screw"'),
    "unknown parent": wrong('parent link="fore"', 'parent link="nowhere"'),
    "two parents": wrong('child link="tool"', 'child link="slider"'),
    "ring": wrong('<parent link="base_link"/>', '<parent link="tool"/>'),
    "duplicate joint": wrong('name="elbow"', 'name="mount"'),
    "duplicate link": wrong('link name="fore"', 'link name="tool"'),
    "self-mimic": wrong('mimic joint="elbow"', 'mimic joint="rail"'),
    "mimic of nothing": wrong('mimic joint="elbow"', 'mimic joint="knee"'),
    "zero reduction": wrong("<mechanicalReduction>50", "<mechanicalReduction>0"),
    "two roots": wrong(
        '<joint name="elbow"',
        '<joint name="other" type="fixed"><parent link="fore"/><child link="x"/></joint><link name="x"/><!--',
    ).replace('</joint>\n  <joint name="mount"', '--><joint name="mount"'),
    "nested elements": DEEP,
    "20 000 links": f"<robot name='x'>{LINKS}{JOINTS}</robot>",
    "other root": "<html></html>",
    "nothing moves": "<robot name='x'><link name='a'/></robot>",
    "no text": "\x00\x01\x02",
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_urdf_is_one_clear_error(tmp_path: Path, text: str) -> None:
    with pytest.raises(RobotFileError) as caught:
        imported(tmp_path, text)
    said = str(caught.value)
    assert "robot.urdf" in said
    assert said.endswith(".")
    assert len(said) < 600
    assert caught.value.advice


def test_mutated_files_are_read_or_refused(tmp_path: Path) -> None:
    """Bytes deleted, doubled, swapped or replaced: an import, or one of haptid's own errors."""
    rng = np.random.default_rng(3)
    words = [b"nan", b"-1", b"1e308", b"0", b"", b'"', b"<", b"base", b"elbow", b"&amp;", b"1e-320", b"\xff"]
    refusals = 0
    for _ in range(60):
        content = bytearray(ARM.encode())
        for _ in range(rng.integers(1, 4)):
            at, size = int(rng.integers(len(content))), int(rng.integers(1, 12))
            content[at : at + size] = words[rng.integers(len(words))]
        path = tmp_path / "mutated.urdf"
        path.write_bytes(bytes(content))
        try:
            robot = import_robot(path)
        except HaptidError:
            refusals += 1
        else:
            assert robot.check.torque < 1e-9
    assert 0 < refusals < 60


def test_a_closed_chain_of_symoro_has_its_published_base_parameters(tmp_path: Path) -> None:
    """The SR400 as SYMORO writes it: 42 base parameters, with the names of the shipped device."""
    par = tmp_path / "sr400.par"
    par.write_text(SR400)
    lengths = {"d2": 0.3, "d3": 0.45, "d4": 0.15, "rl4": 0.5, "d8": 0.2, "d9": 0.45}
    robot = import_robot(par, lengths=lengths)
    shipped = haptid.DynamicModel(haptid.read_device("sr400")).base.names
    assert len(shipped) == 42
    assert haptid.DynamicModel(robot.device).base.names == shipped
    assert robot.check.gap < 1e-12
    with pytest.raises(RobotFileError, match="--length d2="):
        import_robot(par)


def test_long_words_of_a_symoro_file_are_refused_at_once(tmp_path: Path) -> None:
    """Entries without end, and thousands of names, neither take time by their square nor fill the message."""
    par = tmp_path / "long.par"
    for word in ("9" * 800_000, "a" * 800_000, "9." * 400_000, "b = {" * 160_000, "(*" * 400_000):
        par.write_text(SR400.replace("t2", word, 1))
        begin = time.process_time()
        with pytest.raises(RobotFileError) as caught:
            import_robot(par)
        assert time.process_time() - begin < 60.0  # by the square of the length: ten minutes
        assert len(str(caught.value)) < 600
    par.write_text(SR400.replace("d = {0,", "d = {" + "".join(f"0 + L{k} + " for k in range(20)) + "0,", 1))
    with pytest.raises(RobotFileError, match=r"and 1[0-9] more"):
        import_robot(par)


SR400 = """(* Robotname = 'SR400' *)
NL = 8
NJ = 9
NF = 10
Type = 2 (* closed *)
Ant = {0,1,2,3,4,5,1,7,8,3}
Sigma = {0,0,0,0,0,0,0,0,0,2}
b = {0,0,0,0,0,0,0,0,0,0}
d = {0,d2,d3,d4,0,0,d2,d8,d9,-d8}
r = {0,0,0,rl4,0,0,0,0,0,0}
gamma = {0,0,0,0,0,0,0,0,0,1.5708}
alpha = {0,-1.5707963,0,-1.5708,1.5708,-1.5708,-1.5708,0,0,0}
mu = {1,1,0,1,1,1,1,0,0}
theta = {t1,t2,t3,t4,t5,t6,t7,t8,t9,0}
IA = {IA1,IA2,0,IA4,IA5,IA6,IA7,0}
FV = {0,0,0,0,0,0,0,0}
G = {0,0,-9.81}
"""

SDF = """<sdf version="1.9"><model name="m">
<link name="a"><pose>0 0 0.3 0 0.2 0</pose><inertial><pose>0.1 0 0 0.1 0 0</pose><mass>1</mass>
<inertia><ixx>0.01</ixx><iyy>0.02</iyy><izz>0.02</izz></inertia></inertial></link>
<link name="b"><pose relative_to="a">0.5 0 0 0 0 0.3</pose><inertial><mass>0.4</mass>
<inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia></inertial></link>
<joint name="j1" type="revolute"><pose>-0.1 0 0 0 0 0</pose><parent>world</parent><child>a</child>
<axis><xyz expressed_in="__model__">0 1 0</xyz><dynamics><damping>0.3</damping></dynamics></axis></joint>
<joint name="j2" type="prismatic"><parent>a</parent><child>b</child><axis><xyz>1 0 0</xyz></axis></joint>
</model></sdf>"""


def test_an_sdf_with_joints_beside_their_links(tmp_path: Path) -> None:
    """The first joint's axis is 0.1 m from the origin of its link, along the model's y axis."""
    robot = imported(tmp_path, SDF, "m.sdf")
    assert robot.device.joint_names == ("j1", "j2")
    assert robot.check.torque < 1e-12
    model = haptid.DynamicModel(robot.device)
    beta = model.base.of(np.nan_to_num(robot.device.chi_prior))
    still = np.zeros((2, 1))
    torque = haptid.inverse_dynamics(model, beta, still, still, still)
    tilt = 0.2  # link a points down by it; centres of mass are 0.2 and 0.6 m from the axis along it
    assert torque[0, 0] == pytest.approx(-9.8 * math.cos(tilt) * (1.0 * 0.2 + 0.4 * 0.6))
    assert torque[1, 0] == pytest.approx(-9.8 * math.sin(tilt) * math.cos(0.3) * 0.4)


@pytest.mark.parametrize("nested", ["include", "model", "merge"])
def test_models_within_a_model_are_the_same_as_one_model(tmp_path: Path, nested: str) -> None:
    """The arm on a turned cart: its poses and axes are relative to where the cart has it, not to the cart's model."""
    cart = """<sdf version="1.9"><!-- of a cart --><model name="cart">
    <link name="plate"><inertial><mass>3</mass></inertial></link>
    <joint name="rail" type="prismatic"><parent>world</parent><child>plate</child><axis><xyz>1 0 0</xyz></axis></joint>
    {arm}<joint name="bolt" type="fixed"><parent>plate</parent><child>{name}a</child></joint></model></sdf>"""
    arm = SDF.partition("</joint>")[0].partition("<joint")[0] + SDF.partition("</joint>")[2]  # without its own base
    arm = arm.replace("<parent>a</parent>", "<parent>a</parent><pose>0 0 0.1 0.2 0 0</pose>")
    arm = arm.replace("<xyz>1 0 0</xyz>", "<xyz expressed_in='__model__'>1 0 0</xyz>")
    inner, place = arm.partition('name="m">')[2].partition("</model>")[0], "<pose>0.2 0 0.1 0.4 0 0.3</pose>"
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "model.sdf").write_text(arm)
    merge = ' merge="true"' if nested == "merge" else ""
    include = f"<include{merge}><uri>model://arm</uri><name>m</name>{place}</include>"
    text = f'<model name="m">{place}{inner}</model>' if nested == "model" else include
    (tmp_path / "cart.sdf").write_text(cart.format(arm=text, name="" if merge else "m::"))
    made = import_robot(tmp_path / "cart.sdf", packages={"arm": tmp_path / "arm"})
    by_hand = f'<frame name="f">{place}</frame>' + inner.replace("<pose>0 0 0.3", '<pose relative_to="f">0 0 0.3')
    (tmp_path / "hand.sdf").write_text(cart.format(arm=by_hand.replace("__model__", "f"), name=""))
    hand = import_robot(tmp_path / "hand.sdf")
    assert made.check.torque < 1e-12
    for one, other in zip(made.device.joints, hand.device.joints, strict=True):
        np.testing.assert_allclose(one.translation, other.translation, atol=1e-15)
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-15)


def test_an_sdf_that_includes_itself_or_another_package_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.sdf"
    path.write_text('<sdf><model name="m"><include><uri>m.sdf</uri></include></model></sdf>')
    with pytest.raises(RobotFileError, match="Keep 10 levels"):
        import_robot(path)
    path.write_text('<sdf><model name="m"><include><uri>model://arm</uri></include></model></sdf>')
    with pytest.raises(RobotFileError, match="--package arm=FOLDER"):
        import_robot(path)


def test_a_dh_table_says_its_convention(tmp_path: Path) -> None:
    """PUMA 560 by Craig's parameters, in degrees: the base parameters of the shipped device's geometry."""
    rows = ["name,alpha_deg,a,theta_deg,d", "1,0,0,0,0", "2,-90,0,0,0", "3,0,0.4318,0,0.15005", "4,-90,0.0203,0,0.4318"]
    text = "\n".join([*rows, "5,90,0,0,0", "6,-90,0,0,0"])
    with pytest.raises(RobotFileError, match="convention"):
        imported(tmp_path, text, "puma.csv")
    robot = imported(tmp_path, "# convention: craig\n" + text, "puma.csv")
    bodies = [name for name in haptid.DynamicModel(robot.device).base.names if not name.startswith("F")]
    assert len(bodies) == 36  # Gautier and Khalil (1990), without rotor inertias
    with pytest.raises(RobotFileError, match="deg or rad"):
        imported(tmp_path, "# convention: craig\n" + text.replace("alpha_deg", "alpha"), "puma.csv")


def test_a_dh_table_may_name_each_joints_variable(tmp_path: Path) -> None:
    """As tables in books do; they were refused as neither a number nor arithmetic."""
    head = "# convention: dh\nname,alpha_deg,a,theta_deg,d\n"
    plain = imported(
        tmp_path, head + "1,90,0.1,0,0\n2,-90,0.2,90,0.3\n3,0,0,-45,0\n4,0,0,0,l", "a.csv", lengths={"l": 0.5}
    )
    named = "1,90,0.1,q1,0\n2,-90,0.2,theta_2 + 90,0.3\n3,0,0,-45+q3,0\n4,0,0,*,l"
    own = imported(tmp_path, head + named, "b.csv", lengths={"l": 0.5})
    for one, other in zip(plain.device.joints, own.device.joints, strict=True):
        np.testing.assert_allclose(one.translation, other.translation, atol=1e-15)
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-15)
    sliding = imported(tmp_path, head + "1,0,0,0,q1 + 0.2\n2,90,0,q2,0", "c.csv")
    assert [joint.prismatic for joint in sliding.device.joints] == [True, False]
    assert sliding.device.joints[0].translation[2] == pytest.approx(0.2)
    for wrong in ("1,0,0,-q1,0", "1,0,0,2*q1,0", "1,0,0,0,d1"):  # another direction, a gear, a length without a value
        with pytest.raises(RobotFileError, match="neither a number"):
            imported(tmp_path, head + wrong, "d.csv")


def test_names_of_a_source_become_names_of_a_device() -> None:
    """No parameter of one joint may get the name of another's, whatever the joints are called."""
    names = ["left/arm.1", "left_arm_1", "base", "X1", "1", "é" * 60, "j" * 60, "j" * 61]
    made = clean_names(names)
    assert len(set(made.values())) == len(names)
    assert all(re.fullmatch(r"[A-Za-z0-9_]{1,40}", name) for name in made.values())
    assert made["left_arm_1"] != made["left/arm.1"]
    assert {"MX" + made["1"], "M" + made["X1"]} != {"MX1"}


def test_angles_give_every_rotation_back() -> None:
    """Also next to a right angle of the pitch, where two of them nearly share an axis."""
    rng = np.random.default_rng(0)
    for near in (1.0, 1e-3, 1e-6, 1e-9, 1e-12, 0.0):
        for _ in range(20):
            rpy = (rng.uniform(-3, 3), math.pi / 2 - near * rng.uniform(-1, 1), rng.uniform(-3, 3))
            R = placed([0, 0, 0], rpy)[:3, :3]
            assert np.abs(placed([0, 0, 0], angles(R))[:3, :3] - R).max() < 3e-14


def run(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["import", *words])
    return done.exit_code, done.output


def test_the_command_and_its_exit_status(tmp_path: Path) -> None:
    source, target = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    source.write_text(ARM)
    status, said = run(str(source), "--out", str(target))
    assert status == 0
    assert "approximate" in said
    assert run(str(source), "--out", str(target), "--strict")[0] == 1
    status, said = run(str(source), "--out", str(target), "--json")
    report = valid("import", said)
    assert report["joints"]["shoulder-pan"] == "shoulder_pan"
    assert not report["exact"]
    before = target.read_text()
    source.write_text(ARM.replace('value="1.2"', 'value="-1"'))
    status, said = run(str(source), "--out", str(target))
    assert status == 2
    assert "line 6" in said
    assert target.read_text() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.toml", "arm.urdf"]


def test_shipped_devices_are_no_robot_descriptions() -> None:
    with pytest.raises(RobotFileError, match="no robot description"):
        import_robot(str(files("haptid.device") / "library" / "sr400.toml"))


def test_commands_in_amperes(tmp_path: Path) -> None:
    given = {"shoulder-pan": 1.5, "elbow": -0.5}
    made = imported(tmp_path, ARM, torque_constant=given)
    assert {motor.command_unit for motor in made.device.motors} == {"A"}
    assert [motor.gear_ratio * motor.torque_constant for motor in made.device.motors] == pytest.approx([1.5, -0.5])
    for wrong in (given | {"rail": 1.0}, {"elbow": 1.0}, 0.0):
        with pytest.raises(RobotFileError, match=r"torque constant|N m/A"):
            imported(tmp_path, ARM, torque_constant=wrong)


def test_a_gear_ratio_in_words_costs_its_transmission_only(tmp_path: Path) -> None:
    """As in templates that nobody filled in: the joint is taken as driven directly, and the note names the line."""
    robot = imported(tmp_path, ARM.replace("<mechanicalReduction>50", "<mechanicalReduction>reduction"))
    assert any("'reduction', which is no number" in note.text and note.line for note in robot.notes)
    assert robot.check.torque < 1e-10


def test_limits_that_stand_for_none(tmp_path: Path) -> None:
    made = imported(tmp_path, ARM.replace('lower="-1" upper="1.5"', 'lower="-1e16" upper="1e16"'))
    assert made.device.joints[0].position_limits is None
    assert made.device.joints[0].velocity_limit == 2
