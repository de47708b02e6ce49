"""Joints of a description for which it has no motor: what the import and the error of a missing torque say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid import Channels, DynamicModel, Log, Signal, Treatment
from haptid.errors import LogMismatchError
from haptid.robot_files import import_robot

CART_POLE = """<mujoco model="cart-pole">
<worldbody><body name="cart"><joint name="slider" type="slide" axis="1 0 0"/><geom type="box" size=".1 .05 .05"/>
<body name="pole"><joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.6" size=".02"/></body>
</body></worldbody>
<actuator><motor name="push" joint="slider" gear="10"/></actuator></mujoco>
"""


def test_a_joint_without_a_motor_is_free_as_the_note_says(tmp_path: Path) -> None:
    (tmp_path / "cart-pole.xml").write_text(CART_POLE)
    robot = import_robot(tmp_path / "cart-pole.xml")
    (note,) = (note.text for note in robot.notes if "no motor for hinge" in note.text)
    assert 'write torque = "zero"' in note

    t = np.arange(0.0, 2.0, 2e-3)
    q = 0.2 * np.column_stack([np.sin(5 * t), np.cos(4 * t)])
    channels = Channels(Signal(("x", "angle"), "m", units=("m", "rad")), Signal(("force",), "N"), rate_hz=500.0)
    log = Log(Path("made"), "", t, q, np.sin(6 * t)[:, None], channels)
    motion = haptid.treat(log, Treatment(cutoff_hz=None))
    with pytest.raises(LogMismatchError, match=r'1 torque channels, .* requires 2: .* has torque = "zero"'):
        haptid.observe(DynamicModel(robot.device), motion)

    motor = '[[motors]]\nname = "hinge"\ngear_ratio = 1.0\n'
    assert motor in robot.text
    text = robot.text.replace(motor, "").replace('name = "hinge"\n', 'name = "hinge"\ntorque = "zero"\n', 1)
    (tmp_path / "free.toml").write_text(text)
    free = DynamicModel(haptid.read_device(tmp_path / "free.toml"))
    assert haptid.observe(free, motion).rows > 0
