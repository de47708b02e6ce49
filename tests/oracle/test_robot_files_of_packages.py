"""The recorded sweep of robot descriptions, and the robots of it that are compared anew where they are at hand.

    pip install --no-deps --target FOLDER example-robot-data robosuite dm-control gymnasium-robotics pybullet
    HAPTID_DESCRIPTIONS=FOLDER python -m pytest tests/oracle/test_robot_files_of_packages.py

These packages take more than a gigabyte, so the suite itself reads the record (`python benchmarks/robot_files.py`).
"""

from __future__ import annotations

import ast
import csv
import os
from pathlib import Path

import pytest

from haptid.robot_files import import_robot

RECORD = Path(__file__).parents[2] / "benchmarks" / "results" / "robot-files.csv"
FOLDER = os.environ.get("HAPTID_DESCRIPTIONS")
EXAMPLES = "cmeel.prefix/share/example-robot-data/robots/"
# Joints that the device has; torques agree with Pinocchio or MuJoCo to 1e-10 of the greatest one.
ROBOTS = {
    EXAMPLES + "panda_description/urdf/panda.urdf": 9,
    EXAMPLES + "so_arm_description/urdf/so101.urdf": 6,
    EXAMPLES + "xarm_description/urdf/xarm7.urdf": 7,
    EXAMPLES + "kinova_description/robots/kinova.urdf": 6,
    EXAMPLES + "allegro_hand_description/urdf/allegro_right_hand.urdf": 16,
    EXAMPLES + "pr2_description/urdf/pr2.urdf": 30,
    EXAMPLES + "baxter_description/urdf/baxter.urdf": 19,
    EXAMPLES + "tiago_pro_description/robots/tiago_pro.urdf": 33,
    EXAMPLES + "talos_data/robots/talos_left_arm.urdf": 7,
    EXAMPLES + "romeo_description/urdf/romeo.urdf": 55,
    "dexmate_urdf/robots/hands/f5d6_hand/f5d6_right.urdf": 11,
    "stretch_urdf/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf": 14,
    "share/openarm_mujoco/v2/openarm_bimanual.xml": 18,
    "robosuite/models/assets/robots/panda/robot.xml": 7,
    "robosuite/models/assets/robots/ur5e/robot.xml": 6,
    "robosuite/models/assets/robots/iiwa/robot.xml": 7,
    "robosuite/models/assets/robots/kinova3/robot.xml": 7,
    "robosuite/models/assets/robots/jaco/robot.xml": 7,
    "robosuite/models/assets/robots/sawyer/robot.xml": 7,
    "robosuite/models/assets/robots/baxter/robot.xml": 14,
    "robosuite/models/assets/robots/tiago/robot.xml": 15,
    "gymnasium_robotics/envs/assets/hand/reach.xml": 24,
    "gymnasium_robotics/envs/assets/adroit_hand/adroit_relocate.xml": 36,
    "dm_control/suite/manipulator.xml": 14,
    "dm_control/suite/acrobot.xml": 2,
    "pybullet_data/kuka_iiwa/model.urdf": 7,
}


@pytest.fixture(scope="module")
def record() -> dict[str, dict[str, str]]:
    with RECORD.open(newline="") as stream:
        return {row["file"]: row for row in csv.DictReader(stream)}


def largest(row: dict[str, str]) -> float:
    return max(ast.literal_eval(row["difference"]).values())


def test_the_sweep_has_no_traceback_and_no_wrong_torque(record: dict[str, dict[str, str]]) -> None:
    """Nine in ten of what another program loads are imported, and each of these was compared with that program."""
    assert {row["result"] for row in record.values()} <= {"exact", "approximate", "refused"}
    loads = [row for row in record.values() if row["peer"] == "loads"]
    read = [row for row in loads if row["result"] != "refused"]
    assert len(read) >= 0.9 * len(loads) > 250
    assert max(largest(row) for row in read) < 1e-9  # rounded angles


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_of_packages(record: dict[str, dict[str, str]], name: str) -> None:
    row = record[name]
    assert int(row["joints"]) == ROBOTS[name]
    assert max(float(row["torque"]), largest(row)) < 1e-10
    assert float(row["gap"]) < 1e-12
    if FOLDER is not None:
        robot = import_robot(Path(FOLDER) / name, packages={"root": FOLDER}, ask=True)
        assert len(robot.device.joints) == ROBOTS[name]
        assert max(robot.check.torque, *robot.check.others.values()) < 1e-10
