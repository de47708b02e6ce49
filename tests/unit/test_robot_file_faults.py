"""Robot descriptions that fuzzing found to end in a traceback, or to take very long: each is one sentence."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from haptid.errors import RobotFileError
from haptid.robot_files import import_robot


def written(folder: Path, text: str) -> Path:
    """An MJCF file."""
    (folder / "robot.xml").write_text(text)
    return folder / "robot.xml"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty. Run `xacro` again"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
    ],
)
def test_files_of_nothing_say_where_the_description_is(text: str, words: str, tmp_path: Path) -> None:
    """A URDF of a xacro that failed, and a repository without its large files."""
    for name in ("robot.urdf", "table.csv", "robot.par"):
        (tmp_path / name).write_text(text)
        with pytest.raises(RobotFileError, match=words):
            import_robot(tmp_path / name)


def test_many_comments_before_a_description_take_no_time(tmp_path: Path) -> None:
    """Forty lines of licence without an XML declaration: told apart in one way, not in 2^40."""
    urdf = tmp_path / "licensed.urdf"
    urdf.write_text("<!-- a line of a licence -->\n" * 40 + "<robot/>")
    with pytest.raises(RobotFileError) as caught:
        import_robot(urdf)
    assert "not XML" not in str(caught.value)
    urdf.write_text("<!-- a line of a licence -->\n" * 40 + "<?xml version='1.0'?><robot/>")
    with pytest.raises(RobotFileError, match=re.escape(str(caught.value).partition(":")[2][:40])):
        import_robot(urdf)


def test_an_infinite_axis_is_refused_with_its_joint(tmp_path: Path) -> None:
    """Found by fuzzing: MuJoCo makes it an axis of NaN, of which the poses of a loop have no singular values."""
    text = """<mujoco><worldbody><body name="a"><joint name="crank" axis="0 1 inf"/>
    <inertial pos="0.1 0 0" mass="1" diaginertia=".01 .02 .02"/></body></worldbody>
    <actuator><motor joint="crank"/></actuator></mujoco>"""
    pytest.importorskip("mujoco")
    with pytest.raises(RobotFileError, match="joint crank has an axis or a place that is not finite"):
        import_robot(written(tmp_path, text))


GEARS = {
    "robot.urdf": """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
      <transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="j"/>
        <actuator name="m"><mechanicalReduction>GEAR</mechanicalReduction><motorInertia>0.1</motorInertia></actuator>
      </transmission></robot>""",
    "robot.xml": """<mujoco><worldbody>
      <body name="a"><joint name="j"/><geom type="box" size=".1 .1 .1"/></body></worldbody>
      <actuator><general name="m" joint="j" gear="GEAR" armature="0.1"/></actuator></mujoco>""",
    "robot.usda": """#usda 1.0
( metersPerUnit = GEAR )
def Xform "robot" ( prepend apiSchemas = ["PhysicsArticulationRootAPI"] )
{
    def Xform "a" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
    {
        float physics:mass = 1
        float3 physics:diagonalInertia = (1, 1, 1)
    }
    def Xform "b" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
    {
        float physics:mass = 1
        float3 physics:diagonalInertia = (1, 1, 1)
    }
    def PhysicsRevoluteJoint "j"
    {
        rel physics:body0 = </robot/a>
        rel physics:body1 = </robot/b>
    }
}
""",
}


@pytest.mark.parametrize("name", GEARS)
@pytest.mark.parametrize("gear", ["1e200", "1e-200"])
def test_a_gear_or_a_unit_of_a_size_that_none_has_is_refused(tmp_path: Path, name: str, gear: str) -> None:
    """Its square is no number, or zero. Found by fuzzing."""
    pytest.importorskip({".urdf": "numpy", ".xml": "mujoco", ".usda": "pxr"}[Path(name).suffix])
    (tmp_path / name).write_text(GEARS[name].replace("GEAR", gear))
    with pytest.raises(RobotFileError, match=rf"{name}.* is {re.escape(f'{float(gear):g}')}"):
        import_robot(tmp_path / name)
    (tmp_path / name).write_text(GEARS[name].replace("GEAR", "2"))
    import_robot(tmp_path / name)


def test_an_infinite_anchor_of_a_loop_is_refused_with_its_connection(tmp_path: Path) -> None:
    """Found by fuzzing: the gap of such a loop has no singular values."""
    text = """<mujoco><worldbody>
    <body name="a"><joint name="crank" axis="0 1 0"/><inertial pos="0.1 0 0" mass="1" diaginertia=".01 .02 .02"/></body>
    <body name="b" pos="0.4 0 0"><joint name="rocker" axis="0 1 0"/>
    <inertial pos="0.1 0 0" mass="1" diaginertia=".01 .02 .02"/></body></worldbody>
    <equality><connect name="rod" body1="a" body2="b" anchor="0.3 inf 0.1"/></equality>
    <actuator><motor joint="crank"/></actuator></mujoco>"""
    pytest.importorskip("mujoco")
    with pytest.raises(RobotFileError, match="connection rod that closes a loop has a place that is not finite"):
        import_robot(written(tmp_path, text))
