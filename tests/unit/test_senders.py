"""The senders of the examples send frames that are read as what was sent."""

from __future__ import annotations

import importlib
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from haptid.live import read_frame

SENDERS = Path(__file__).resolve().parents[2] / "examples" / "senders"
COMPILER = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)


@pytest.fixture
def heard() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        port.settimeout(20)
        yield port


@pytest.mark.parametrize("language", ["c", "python"])
def test_samples_arrive_with_their_numbers(heard, language, tmp_path):
    command = [sys.executable, str(SENDERS / "send.py")]
    if language == "c":
        if COMPILER is None:
            pytest.skip("no C compiler on this machine")
        command = [str(tmp_path / "send")]
        warnings = ["-Wall", "-Wextra", "-Werror", "-std=gnu11"]
        subprocess.run([COMPILER, *warnings, "-o", command[0], SENDERS / "send.c", "-lm"], check=True)
    with subprocess.Popen([*command, "127.0.0.1", str(heard.getsockname()[1]), "20"]) as sender:
        frames = [read_frame(heard.recv(70_000)) for _ in range(20)]
        assert sender.wait(20) == 0
    t = 1e-3 * np.arange(20)
    assert [frame.number for frame in frames] == list(range(20))
    position, torque = (np.concatenate([getattr(f, name) for f in frames]) for name in ("position", "torque"))
    np.testing.assert_allclose(position, 0.5 * np.sin(np.outer(t, [1.0, 1.3])), atol=1e-15)
    np.testing.assert_allclose(torque, np.cos(np.outer(t, [1.0, 1.3])), atol=1e-15)


def test_the_node_passes_joint_states_on(heard, monkeypatch):
    """With a stand-in for ROS 2: parameters, order of joints, messages that lack something."""
    given = {"address": "127.0.0.1", "port": heard.getsockname()[1], "joints": ["b", "a"]}

    class Node:
        def __init__(self, name):
            self.name = name

        def declare_parameter(self, name, _):
            assert name in given

        def get_parameter(self, name):
            return SimpleNamespace(value=given[name])

        def create_subscription(self, kind, topic, *_):
            assert (kind, topic) == ("JointState", "/joint_states")

    modules = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"JointState": "JointState"},
    }
    for name, content in modules.items():
        made = ModuleType(name)
        made.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, made)
    monkeypatch.syspath_prepend(str(SENDERS))
    node = importlib.import_module("ros2_sender").Sender()
    monkeypatch.delitem(sys.modules, "ros2_sender")
    monkeypatch.delitem(sys.modules, "send")
    node.passed_on(SimpleNamespace(name=["a", "b"], position=[1.0, 2.0], effort=[3.0, 4.0]))
    node.passed_on(SimpleNamespace(name=["a"], position=[1.0], effort=[3.0]))
    node.passed_on(SimpleNamespace(name=["a", "b"], position=[1.0, 2.0], effort=[]))
    node.passed_on(SimpleNamespace(name=["x", "a", "b"], position=[0.0, 5.0, 6.0], effort=[0.0, 7.0, 8.0]))
    first, second = (read_frame(heard.recv(70_000)) for _ in range(2))
    node.out.close()
    assert (first.number, second.number) == (0, 3)
    np.testing.assert_array_equal(first.position, [[2.0, 1.0]])
    np.testing.assert_array_equal(second.torque, [[8.0, 7.0]])
