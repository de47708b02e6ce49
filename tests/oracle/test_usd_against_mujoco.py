"""An arm as USD, in centimetres and y upwards, has the torques that MuJoCo computes from the same arm as MJCF."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.errors import RobotFileError
from haptid.robot_files import ImportedRobot, import_robot

pytest.importorskip("mujoco")
pytest.importorskip("pxr")

USD = """#usda 1.0
(
    defaultPrim = "arm"
    metersPerUnit = 0.01
    kilogramsPerUnit = 0.1
    upAxis = "Y"
)
def PhysicsScene "scene" {
    vector3f physics:gravityDirection = (0, -1, 0)
    float physics:gravityMagnitude = 980
}
def Xform "arm" ( prepend apiSchemas = ["PhysicsArticulationRootAPI"] )
{
    def Xform "base" ( prepend apiSchemas = ["PhysicsRigidBodyAPI"] )
    {
        double3 xformOp:translate = (10, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "upper" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
    {
        double3 xformOp:translate = (10, 20, 0)
        double3 xformOp:scale = (2, 2, 2)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
        float physics:mass = 20
        point3f physics:centerOfMass = (5, 1, 0)
        float3 physics:diagonalInertia = (200, 400, 500)
        quatf physics:principalAxes = (0.8, 0.6, 0, 0)
        def Capsule "shape" ( prepend apiSchemas = ["PhysicsCollisionAPI"] )
        {
            uniform token axis = "X"
            double radius = 1
            double height = 10
        }
    }
    def Xform "slider" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
    {
        double3 xformOp:translate = (40, 20, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        float physics:mass = 5
        point3f physics:centerOfMass = (2, 0, 1)
        float3 physics:diagonalInertia = (50, 60, 70)
    }
    def Xform "finger" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
    {
        double3 xformOp:translate = (10, 20, 10)
        quatd xformOp:orient = (0.6, 0, 0, 0.8)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]
        float physics:mass = 2
        point3f physics:centerOfMass = (4, 0, 0)
        float3 physics:diagonalInertia = (3, 4, 5)
    }
    def PhysicsFixedJoint "ground"
    {
        rel physics:body1 = </arm/base>
    }
    def PhysicsRevoluteJoint "shoulder" ( prepend apiSchemas = ["PhysicsDriveAPI:angular"] )
    {
        rel physics:body0 = </arm/base>
        rel physics:body1 = </arm/upper>
        uniform token physics:axis = "Z"
        point3f physics:localPos0 = (0, 20, 0)
        float physics:lowerLimit = -90
        float physics:upperLimit = 180
        float drive:angular:physics:maxForce = 200000
        float physxJoint:armature = 300
        float physxJointAxis:angular:dynamicFrictionEffort = 1000
    }
    def PhysicsPrismaticJoint "slide" ( prepend apiSchemas = ["PhysicsDriveAPI:linear"] )
    {
        rel physics:body0 = </arm/slider>
        rel physics:body1 = </arm/upper>
        uniform token physics:axis = "Y"
        point3f physics:localPos0 = (0, 0, 0)
        point3f physics:localPos1 = (15, 0, 0)
        quatf physics:localRot0 = (0.70710677, 0, 0, 0.70710677)
        quatf physics:localRot1 = (0.70710677, 0, 0, 0.70710677)
        float physics:lowerLimit = -10
        float physics:upperLimit = 5
        float physxJoint:armature = 1
    }
    def PhysicsRevoluteJoint "curl" ( prepend apiSchemas = ["PhysxMimicJointAPI:rotZ"] )
    {
        rel physics:body0 = </arm/upper>
        rel physics:body1 = </arm/finger>
        uniform token physics:axis = "Z"
        point3f physics:localPos0 = (0, 0, 5)
        rel physxMimicJoint:rotZ:referenceJoint = </arm/shoulder>
        float physxMimicJoint:rotZ:gearing = -0.5
    }
}
"""
MJCF = """<mujoco><compiler angle="radian"/><option gravity="0 -9.8 0"/><worldbody><body pos="0.1 0 0">
 <body name="upper" pos="0 0.2 0"><joint name="shoulder" axis="0 0 1" armature="0.003" frictionloss="0.01"
   range="-1.5707963267948966 3.141592653589793" limited="true"/>
  <inertial pos="0.1 0.02 0" quat="0.8 0.6 0 0" mass="2" diaginertia="0.002 0.004 0.005"/>
  <body name="slider" pos="0.3 0 0"><joint name="slide" type="slide" axis="1 0 0" armature="0.1"/>
   <inertial pos="0.02 0 0.01" mass="0.5" diaginertia="0.0005 0.0006 0.0007"/></body>
  <body name="finger" pos="0 0 0.1"><joint name="curl" axis="0 0 1"/>
   <inertial pos="0.04 0 0" mass="0.2" diaginertia="0.00003 0.00004 0.00005"/></body>
 </body></body></worldbody>
 <equality><joint joint1="curl" joint2="shoulder" polycoef="0 0.5 0 0 0"/></equality>
 <actuator><motor joint="shoulder"/><motor joint="slide"/></actuator></mujoco>"""


def read(folder: Path, text: str, name: str) -> ImportedRobot:
    (folder / name).write_text(text)
    return import_robot(folder / name, ask=name.endswith("xml") or find_spec("pinocchio") is not None)


def torque(robot: ImportedRobot, signs: tuple[float, ...]) -> np.ndarray:
    """Torques at random states, for coordinates of these signs."""
    model, sign = haptid.DynamicModel(robot.device), np.array(signs)[:, None]
    states = sign * np.random.default_rng(5).uniform(-1, 1, (3, len(sign), 40))
    return sign * haptid.inverse_dynamics(model, model.base.of(np.nan_to_num(robot.device.chi_prior)), *states)


def test_a_tree_with_a_mimic_joint(tmp_path: Path) -> None:
    """Units of length and mass, scaled bodies, a joint written from the child to the parent, poses, mimic."""
    usd, mjcf = read(tmp_path, USD, "arm.usda"), read(tmp_path, MJCF, "arm.xml")
    assert usd.device.joint_names == ("shoulder", "slide", "curl")
    wanted = torque(mjcf, (1, -1))  # the slide is written from the slider to the upper arm
    np.testing.assert_allclose(torque(usd, (1, 1)), wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    shoulder, slide, _ = usd.device.joints
    assert shoulder.position_limits == pytest.approx((-np.pi / 2, np.pi))
    assert slide.position_limits == pytest.approx((-0.1, 0.05))
    (shape,) = usd.device.collision
    assert shape.size == pytest.approx((0.02, 0.1))


def bar(name: str, mass: float, x: float, z: float, more: str = "") -> str:
    """A rod along z of a four-bar; its frame is at its lower end."""
    return f"""
def Xform "{name}" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
{{
    double3 xformOp:translate = ({x}, 0, {z})
    uniform token[] xformOpOrder = ["xformOp:translate"]
    float physics:mass = {mass}
    point3f physics:centerOfMass = (0.1, 0, 0.05)
    float3 physics:diagonalInertia = (0.01, 0.02, 0.02)
    {more}
}}"""


def hinge(name: str, one: str, other: str, at: tuple[float, ...], to: tuple[float, ...], more: str = "") -> str:
    """A joint about y between points of two bodies; no body is the world."""
    sides = "".join(f"    rel physics:body{k} = </{body}>\n" for k, body in enumerate((one, other)) if body)
    return f"""
def PhysicsRevoluteJoint "{name}" {more}
{{
{sides}    uniform token physics:axis = "Y"
    point3f physics:localPos0 = {at}
    point3f physics:localPos1 = {to}
}}"""


DRIVE = '( prepend apiSchemas = ["PhysicsDriveAPI:angular"] )'
HEAD = '#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n)'
LOOP = (
    HEAD
    + bar("crank", 1, 0, 0)
    + bar("rod", 0.5, 0.1, 0.2)
    + bar("rocker", 0.8, 0.5, 0)
    + hinge("crank_joint", "", "crank", (0, 0, 0), (0, 0, 0), DRIVE)
    + hinge("rod_joint", "crank", "rod", (0.1, 0, 0.2), (0, 0, 0))
    + hinge("rocker_joint", "", "rocker", (0.5, 0, 0), (0, 0, 0))
    + hinge("pin", "rod", "rocker", (0.3, 0, 0.1), (-0.1, 0, 0.3))
)
LOOP_MJCF = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
 <body name="crank"><joint name="crank_joint" axis="0 1 0"/>
  <inertial pos="0.1 0 0.05" mass="1" diaginertia=".01 .02 .02"/>
  <body name="rod" pos="0.1 0 0.2"><joint name="rod_joint" axis="0 1 0"/>
   <inertial pos="0.1 0 0.05" mass="0.5" diaginertia=".01 .02 .02"/></body></body>
 <body name="rocker" pos="0.5 0 0"><joint name="rocker_joint" axis="0 1 0"/>
  <inertial pos="0.1 0 0.05" mass="0.8" diaginertia=".01 .02 .02"/></body></worldbody>
 <equality><connect body1="rod" body2="rocker" anchor="0.3 0 0.1"/></equality>
 <actuator><motor joint="crank_joint"/></actuator></mujoco>"""


def test_a_loop(tmp_path: Path) -> None:
    """A four-bar; with joints without drives passive, whichever joint of the loop the file excludes."""
    mjcf = read(tmp_path, LOOP_MJCF, "loop.xml")
    wanted = torque(mjcf, (0.3,))
    for excluded in ("", "rod_joint"):
        text = LOOP.replace(f'"{excluded}" \n{{', f'"{excluded}" \n{{\n    bool physics:excludeFromArticulation = true')
        usd = read(tmp_path, text, "loop.usda")
        assert [usd.device.joints[k].name for k in usd.device.active] == ["crank_joint"]
        assert usd.check.gap < 1e-12
        assert ("pin" in usd.names) == bool(excluded)
        np.testing.assert_allclose(torque(usd, (0.3,)), wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


def test_a_free_base_is_held_and_said(tmp_path: Path) -> None:
    text = HEAD + bar("crank", 1, 0, 0) + bar("rod", 0.5, 0.1, 0.2)
    robot = read(tmp_path, text + hinge("elbow", "crank", "rod", (0.1, 0, 0.2), (0, 0, 0)), "free.usda")
    assert robot.device.joint_names == ("elbow",)
    notes = [str(note) for note in robot.notes]
    assert "approximate: floating joint crank free is held as the source places it" in notes
    assert any("gravity" in note for note in notes)


HOSTILE = {
    "outside its folder": "\n(\n    subLayers = [@../secret.usda@]\n)",
    "cannot be read": '\ndef "a" ( payload = @nothing.usda@ )\n{\n}',
    "its parser says": "\ndef def",
    "negative moment": LOOP[len("#usda 1.0") :].replace("(0.01, 0.02, 0.02)", "(0.01, -0.02, 0.02)"),
    "has the mass -1": LOOP[len("#usda 1.0") :].replace("physics:mass = 1", "physics:mass = -1"),
    "connect the same two bodies": LOOP[len("#usda 1.0") :] + hinge("twin", "", "rocker", (0.5, 0, 0), (0, 0, 0)),
    "sheared, mirrored or without size": LOOP[len("#usda 1.0") :].replace(
        '["xformOp:translate"]', '["xformOp:translate", "xformOp:scale"]\n    double3 xformOp:scale = (-1, 1, 1)'
    ),
}


@pytest.mark.parametrize("said", HOSTILE)
def test_hostile_usd_is_one_clear_error(tmp_path: Path, said: str) -> None:
    (tmp_path / "secret.usda").write_text("#usda 1.0\n")
    (tmp_path / "inside").mkdir()
    with pytest.raises(RobotFileError, match=said.strip()) as caught:
        read(tmp_path / "inside", "#usda 1.0" + HOSTILE[said], "robot.usda")
    assert len(str(caught.value)) < 600
    assert "pxr" not in str(caught.value)
