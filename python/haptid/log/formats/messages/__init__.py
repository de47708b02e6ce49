"""Logs of messages: MCAP, ROS 1 bags, ROS 2 databases and their folders."""

from haptid.log.formats.messages.topics import columns, names

__all__ = ["columns", "names"]
