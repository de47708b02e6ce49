"""Robot descriptions: URDF, xacro, MJCF, SDF, USD, SYMORO and Denavit-Hartenberg tables as device files."""

from haptid.robot_files.check import Check
from haptid.robot_files.imported import ImportedRobot, import_robot
from haptid.robot_files.moving_tree import Moving, MovingTree, moving_tree
from haptid.robot_files.read import read_robot
from haptid.robot_files.tree import (
    ClosingJoint,
    Drive,
    Follows,
    Inertial,
    Note,
    RobotLink,
    RobotTree,
    TreeJoint,
)

__all__ = [
    "Check",
    "ClosingJoint",
    "Drive",
    "Follows",
    "ImportedRobot",
    "Inertial",
    "Moving",
    "MovingTree",
    "Note",
    "RobotLink",
    "RobotTree",
    "TreeJoint",
    "import_robot",
    "moving_tree",
    "read_robot",
]
