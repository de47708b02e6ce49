"""Robot descriptions: URDF, xacro, MJCF, SDF, SYMORO and Denavit-Hartenberg tables as device files."""

from haptid.robot_files.check import Check
from haptid.robot_files.imported import ImportedRobot, import_robot
from haptid.robot_files.read import read_robot
from haptid.robot_files.reduced import Moving, Reduced, reduced
from haptid.robot_files.tree import (
    ClosingJoint,
    Drive,
    Follows,
    Inertial,
    Link,
    Note,
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
    "Link",
    "Moving",
    "Note",
    "Reduced",
    "RobotTree",
    "TreeJoint",
    "import_robot",
    "read_robot",
    "reduced",
]
