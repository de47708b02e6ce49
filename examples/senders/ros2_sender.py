"""ROS 2 node: passes `sensor_msgs/JointState` on to the live page of the workbench as frames by UDP.

python ros2_sender.py --ros-args -p port:=PORT -p joints:="[joint1, joint2]"

Efforts are the torques. A message without one of the joints, or without efforts, is left out, and counts as lost.
"""

from __future__ import annotations

import socket
from typing import Any

import rclpy
from rclpy.node import Node
from send import frame_of
from sensor_msgs.msg import JointState


class Sender(Node):
    """Sends the position and effort of some joints, in their order."""

    def __init__(self) -> None:
        super().__init__("haptid_sender")
        self.declare_parameter("address", "127.0.0.1")
        self.declare_parameter("port", 0)
        self.declare_parameter("joints", [""])
        self.joints = [name for name in self.get_parameter("joints").value if name]
        self.to = (self.get_parameter("address").value, int(self.get_parameter("port").value))
        self.out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.number = 0
        self.create_subscription(JointState, "/joint_states", self.passed_on, 100)

    def passed_on(self, message: Any) -> None:
        """One message as one sample."""
        number, self.number = self.number, self.number + 1
        at = {name: k for k, name in enumerate(message.name)}
        wanted = self.joints or list(message.name)
        if len(message.effort) != len(message.name) or any(name not in at for name in wanted):
            return
        position, effort = ([values[at[name]] for name in wanted] for values in (message.position, message.effort))
        self.out.sendto(frame_of(number, position, effort), self.to)


def main() -> None:
    """Run until it is interrupted."""
    rclpy.init()
    rclpy.spin(Sender())


if __name__ == "__main__":
    main()
