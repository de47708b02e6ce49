"""Imported robots have the torques that Pinocchio and MuJoCo compute from the same files."""

from __future__ import annotations

import importlib.util
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.device import poses
from haptid.errors import HaptidError
from haptid.robot_files import ImportedRobot, import_robot

mujoco = pytest.importorskip("mujoco")
# Of the greatest torque of the bodies.
LARGEST = 1e-10


def packaged(package: str, *parts: str) -> Path:
    """A file of an installed package; the test is skipped without it."""
    found = importlib.util.find_spec(package)
    places = [Path(x) for x in (found.submodule_search_locations or [])] if found else []
    places += [Path(sys.prefix), Path(sysconfig.get_path("data"))]
    path = next((place.joinpath(*parts) for place in places if place.joinpath(*parts).is_file()), None)
    if path is None:
        pytest.skip(f"{package} is not installed")
    return path


def agrees(robot: ImportedRobot) -> None:
    assert robot.check.torque < LARGEST
    assert max(robot.check.others.values()) < LARGEST


@pytest.mark.parametrize(
    ("name", "joints", "active", "snap"),
    [("hands/f5d6_hand/f5d6_right.urdf", 11, 6, 0.0), ("humanoid/vega_1u/vega_1u_gripper.urdf", 23, 21, 1e-4)],
)
def test_urdf_of_dexmate(name: str, joints: int, active: int, snap: float) -> None:
    """Angles of the second are rounded to 1.5708: only where they are snapped are the torques those of base parameters
    that are well determined. Pinocchio is asked about the file as it is."""
    pytest.importorskip("pinocchio")
    robot = import_robot(packaged("dexmate_urdf", "robots", *name.split("/")), ask=True, snap=snap)
    assert (len(robot.device.joints), len(robot.device.active)) == (joints, active)
    assert robot.check.torque < LARGEST
    assert robot.check.others["pinocchio"] < (1e-9 if snap else LARGEST)


def test_mjcf_of_openarm() -> None:
    """Two arms on two roots, equalities of joints, armature, friction, springs."""
    robot = import_robot(packaged("openarm_mujoco", "share", "openarm_mujoco", "v2", "openarm_bimanual.xml"), ask=True)
    assert (len(robot.device.joints), len(robot.device.active)) == (18, 16)
    assert robot.is_exact
    agrees(robot)


HARD = """<mujoco model="hard"><compiler angle="degree" eulerseq="ZYX" autolimits="true"/><option gravity="0.3 -9 2"/>
<default><joint damping="0.4" armature="0.01"/><default class="stiff"><joint stiffness="3" springref="20"/></default>
</default>
<worldbody>
 <frame pos="0.1 0.2 0.3" euler="10 20 30">
  <body name="two joints" pos="0 0 1" quat="0.9 0.1 -0.3 0.2">
   <inertial pos="0.1 0 0.05" mass="2" fullinertia="0.04 0.05 0.06 0.001 0.002 0.003"/>
   <joint name="turn" axis="1 1 0" pos="0.05 0.02 0" ref="15" range="-90 90"/>
   <joint name="slide" type="slide" axis="0 0.6 0.8" ref="0.1" class="stiff" frictionloss="0.2"/>
   <body name="geoms" pos="0.3 0 0"><joint name="last" axis="0 0 1" pos="0.1 0 0"/>
     <geom type="capsule" size="0.03" fromto="0 0 0 0.2 0.1 0"/>
     <geom type="box" size="0.1 0.05 0.02" pos="0.1 0 0.1" mass="0.7"/>
   </body>
   <body name="follower" pos="0 0.2 0"><joint name="follows" axis="0 1 0" ref="5"/>
     <inertial pos="0 0 0.1" mass="0.4" diaginertia="0.01 0.01 0.004"/></body>
  </body>
 </frame>
</worldbody>
<equality><joint joint1="follows" joint2="last" polycoef="0.1 -2 0 0 0"/></equality>
<actuator><motor joint="turn" gear="30" armature="1e-4"/><motor joint="slide"/><motor joint="last"/></actuator>
</mujoco>"""


def test_mjcf_with_what_mujoco_has_and_others_have_not(tmp_path: Path) -> None:
    """Frames, degrees, defaults, several joints of a body beside its origin, ref, springref, shapes, tilted gravity."""
    path = tmp_path / "hard.xml"
    path.write_text(HARD)
    robot = import_robot(path, ask=True)
    agrees(robot)
    assert robot.device.joint_names == ("turn", "slide", "last", "follows")
    assert [joint.body for joint in robot.device.joints] == [False, True, True, True]
    assert robot.device.drives[0].gear_ratio == 30


LOOP = """<mujoco><worldbody>
 <body name="crank"><joint name="crank" axis="{axis}"/><inertial pos="0.05 0 0" mass="1" diaginertia=".01 .02 .02"/>
  <body name="rod" pos="0.1 0 0.15"><joint name="rod" axis="{axis}"/>{more}
   <inertial pos="0.15 0 0" mass="0.5" diaginertia=".01 .02 .02"/></body></body>
 <body name="rocker" pos="0.4 0 0"><joint name="rocker" axis="{axis}"/>
  <inertial pos="0 0 0.1" mass="0.8" diaginertia=".01 .02 .02"/></body></worldbody>
 <equality><connect body1="rod" body2="rocker" anchor="0.3 0 0.1"/></equality>
 <actuator><motor joint="crank"/></actuator></mujoco>"""


@pytest.mark.parametrize("spatial", [False, True], ids=["in a plane", "in space"])
def test_mjcf_with_a_loop(tmp_path: Path, spatial: bool) -> None:
    """A ball that closes a plane loop is a hinge; in space it is a spherical cut."""
    path = tmp_path / "loop.xml"
    more = '<joint name="bend" axis="0.2 0.1 1"/>' if spatial else ""
    path.write_text(
        LOOP.format(axis="0 1 0", more=more).replace(
            'name="rocker" axis="0 1 0"', 'name="rocker" axis="0 1 0.3"' if spatial else 'name="rocker" axis="0 1 0"'
        )
    )
    robot = import_robot(path, ask=True)
    device = robot.device
    assert [device.joints[k].name for k in device.active] == ["crank"]
    assert len(device.joints) == (4 if spatial else 3)
    assert robot.check.gap < 1e-12
    agrees(robot)


LEG = """<mujoco><compiler angle="radian"/><worldbody>
 <body name="hip"><joint name="hip" axis="1 0 0"/><inertial pos="0.05 0 0" mass="1" diaginertia=".01 .02 .02"/>
  <body name="rod" pos="0 0 0.05"><joint name="rod" type="ball"/>
   <inertial pos="0.25 0 0" mass="0.2" diaginertia=".00001 .004 .004"/></body>
  <body name="knee" pos="0 0 -0.1"><joint name="knee" axis="0 1 0" damping="0.4"/>
   <inertial pos="0.1 0 0" mass="0.8" diaginertia=".01 .02 .02"/>
   <body name="shin" pos="0.2 0 0"><joint name="shin" axis="0 1 0" stiffness="300" damping="0.1"/>
    <inertial pos="0.1 0 0" mass="0.6" diaginertia=".01 .02 .02"/>
    <body name="tarsus" pos="0.3 0 0"><joint name="tarsus" axis="0 1 0" damping="0.1"/>
     <inertial pos="0.1 0 0.02" mass="0.5" diaginertia=".01 .02 .02"/>
     <body name="heel" pos="0 0 0.15"><joint name="heel" axis="0.1 1 0" stiffness="200"/>
      <inertial pos="0.02 0 0" mass="0.1" diaginertia=".001 .002 .002"/></body></body></body></body></body></worldbody>
 <equality><connect body1="rod" body2="heel" anchor="0.5 0 0"/></equality>
 <actuator><motor joint="hip"/><motor joint="knee"/></actuator></mujoco>"""


def test_springs_beside_a_loop_move_by_themselves(tmp_path: Path) -> None:
    """A leg with springs in series: rod and tarsus follow hip, knee and both springs; only the rod's spin is held."""
    path = tmp_path / "leg.xml"
    path.write_text(LEG)
    robot = import_robot(path, ask=True)
    device = robot.device
    assert [device.joints[k].name for k in device.active] == ["hip", "knee", "shin", "heel"]
    assert not any(name.startswith("rod_z") or "rod z" in name for name in device.joint_names)
    said = [note.text for note in robot.notes if note.grade == "exact" and "spins freely" in note.text]
    assert len(said) == 1
    assert robot.check.gap < 1e-12
    agrees(robot)


TENDONS = """<mujoco><compiler angle="radian"/><worldbody>
 <body><joint name="a" axis="0 1 0"/><inertial pos="0.1 0 0" mass="1" diaginertia="0.02 0.02 0.01"/>
  <body pos="0.3 0 0"><joint name="b" axis="0 1 0" ref="0.2"/>
   <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.02 0.02 0.01"/></body></body></worldbody>
 <tendon><fixed name="belt" stiffness="30" springlength="0.1" damping="0.3" frictionloss="0.1" armature="0.02">
   <joint joint="a" coef="0.8"/><joint joint="b" coef="-0.5"/></fixed>
  <fixed name="slack" stiffness="30" springlength="-0.1 0.1"><joint joint="a" coef="1"/></fixed></tendon></mujoco>"""


def test_tendons_of_mjcf(tmp_path: Path) -> None:
    """Stiffness, damping, friction and inertia of a sum of positions; a slack tendon is left out, and said."""
    path = tmp_path / "tendons.xml"
    path.write_text(TENDONS)
    robot = import_robot(path, ask=True)
    agrees(robot)
    values = dict(zip(robot.device.parameters.names, robot.device.chi_prior, strict=True))
    found = {name: values[name] for name in values if name.endswith("tendon_belt")}
    assert found == {"Ktendon_belt": 30, "FVtendon_belt": 0.3, "FCtendon_belt": 0.1, "IAtendon_belt": 0.02}
    assert [str(note) for note in robot.notes if note.grade == "left out"] == [
        "left out (line 7): stiffness of tendon slack, which is not linear"
    ]
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)  # friction, which MuJoCo smooths
    model.tendon_stiffness[1] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a = np.array([[0.4, -0.7], [1.0, 0.3], [0.2, -2.0]])
    mujoco.mj_inverse(model, data)
    values = values | {name: 0.0 for name in values if name.startswith("F") and name != "FVtendon_belt"}
    haptid_model = haptid.DynamicModel(robot.device)
    beta = haptid_model.base.of(np.array(list(values.values())))
    tau = haptid.inverse_dynamics(haptid_model, beta, q[:, None], v[:, None], a[:, None])[:, 0]
    np.testing.assert_allclose(tau, data.qfrc_inverse, rtol=1e-10)


SHAPES = """<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="1 1 1"/>
 <body pos="0 0 0.5"><joint name="a" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <geom type="capsule" size="0.04" fromto="0 0 0 0.3 0 0.1"/><geom type="box" size="0.1 0.2 0.3" pos="0.5 0 0"/>
  <geom type="sphere" size="0.02" contype="0" conaffinity="0"/><geom type="ellipsoid" size="0.1 0.1 0.2"/>
  <body pos="0.3 0 0"><joint name="b" axis="0 0 1" pos="0.05 0 0"/>
   <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="cylinder" size="0.03 0.2" euler="0.4 0 0.2"/>
   <geom type="sphere" size="0.06" pos="0 0.1 0"/></body></body></worldbody></mujoco>"""


def test_collision_shapes_of_mjcf(tmp_path: Path) -> None:
    """Shapes lie where MuJoCo places them; pictures are no shapes, and what a device file lacks is named in it."""
    path = tmp_path / "shapes.xml"
    path.write_text(SHAPES)
    robot = import_robot(path)
    shapes = robot.device.collision
    assert [shape.kind for shape in shapes] == ["capsule", "box", "cylinder", "sphere"]
    assert "not imported, of: world, body 1" in robot.text
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = q = np.array([0.7, -0.4])
    mujoco.mj_forward(model, data)
    links = poses(robot.device, q[None])[0]
    for shape, geom in zip(shapes, (1, 2, 5, 6), strict=True):
        R, p = links[shape.link][:3, :3], links[shape.link][:3, 3]
        np.testing.assert_allclose(R @ shape.frame.translation + p, data.geom_xpos[geom], atol=1e-12)
        np.testing.assert_allclose(
            R @ shape.frame.rotation, data.geom_xmat[geom].reshape(3, 3), atol=1e-12, err_msg=shape.kind
        )
        np.testing.assert_allclose(shape.size, model.geom_size[geom][: len(shape.size)], rtol=1e-12)


def test_mjcf_that_would_harm(tmp_path: Path) -> None:
    """A million replicates, includes from elsewhere, deep nesting: one error each, before MuJoCo sees the file."""
    body = '<body><joint/><geom size="0.1"/></body>'
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "other.xml").write_text("<mujoco/>")
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "link.xml").symlink_to(tmp_path / "elsewhere" / "other.xml")
    hostile = {
        "copies": f"<mujoco><worldbody><replicate count='1000000'>{body}</replicate></worldbody></mujoco>",
        "DTD": '<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>',
        "nested": "<mujoco><worldbody>" + "<body>" * 20_000 + "</body>" * 20_000 + "</worldbody></mujoco>",
        "outside": '<mujoco><include file="../elsewhere/other.xml"/></mujoco>',
        "outside ": f'<mujoco><include file="{tmp_path}/elsewhere/other.xml"/></mujoco>',
        " outside": '<mujoco><include file="link.xml"/></mujoco>',
        "parser": "<mujoco><worldbody><body><joint axis='0 0 0'/></body></worldbody></mujoco>",
        "no joint moves": "<mujoco><worldbody><body/></worldbody></mujoco>",
    }
    for said, text in hostile.items():
        path = inside / "robot.xml"
        path.write_text(text)
        with pytest.raises(HaptidError, match=said.strip()) as caught:
            import_robot(path)
        assert len(str(caught.value)) < 600


XACRO = """<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="mass" default="1"/>
<link name="base"/>{include}
<link name="a"><inertial><mass value="$(arg mass)"/>
<inertia ixx="${{0.1 * 2}}" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="j" type="revolute"><parent link="base"/><child link="a"/>
<origin xyz="{where} 0 0"/></joint></robot>
"""


def test_xacro(tmp_path: Path) -> None:
    """Arguments and arithmetic work; files from elsewhere, the environment and endless arithmetic do not."""
    pytest.importorskip("xacro")
    macros = tmp_path / "macros.xacro"
    macros.write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m" params="a"/></robot>')
    with pytest.raises(HaptidError, match="calls these macros"):
        import_robot(macros)
    path, outside = tmp_path / "in" / "robot.urdf.xacro", tmp_path / "secret.yaml"
    path.parent.mkdir()
    outside.write_text("key: 1")
    plain = {"include": "", "where": "${pi}"}
    path.write_text(XACRO.format(**plain))
    robot = import_robot(path, xacro_arguments={"mass": "2.5"})
    assert robot.device.prior["Mj"].value == 2.5
    assert robot.check.torque < LARGEST
    for change, said in (
        ({"where": f"${{xacro.load_yaml('{outside}')['key']}}"}, "outside"),
        ({"where": "$(env HOME)"}, "env HOME"),
        ({"include": '<xacro:include filename="$(find elsewhere)/x"/>'}, "--package elsewhere="),
        ({"where": "$(arg reach)"}, r"--xacro-arg reach=VALUE.*mass \(1\)"),
    ):
        path.write_text(XACRO.format(**(plain | change)))
        with pytest.raises(HaptidError, match=said):
            import_robot(path)
