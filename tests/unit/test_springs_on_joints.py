"""Springs on joints that no motor is on: refused where no torque of a row has theirs, and nowhere else."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.errors import LogMismatchError
from haptid.motion.channels import check_log, position_channels, torque_channels

ARM = """
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[motors]]
name = "b"
drives = { "2" = 1.0 }
"""
MOTOR = """
[[motors]]
name = "a"
drives = { "1" = 1.0 }
"""
SPRING = """
[[terms]]
kind = "spring"
joints = ["1"]
"""
ELASTIC = """
[[terms]]
kind = "elastic"
motors = ["NAME"]
[[terms]]
kind = "rotor-inertia"
motors = "all"
"""


def crank_moved_by_the_rocker() -> str:
    """A four-bar linkage whose crank is measured, and whose motor is on its rocker, which is passive."""
    linkage = (files("haptid.device.library") / "four_bar.toml").read_text()
    return linkage.replace('[[motors]]\nname = "crank"', '[[motors]]\nname = "rocker"') + SPRING.replace("1", "crank")


@pytest.mark.parametrize(
    ("text", "stiffness", "told"),
    [
        (ARM + SPRING, "K1", False),
        (ARM.replace('name = "1"', 'name = "1"\ntorque = "zero"') + SPRING, "K1", True),
        (ARM + MOTOR + SPRING, "K1", True),
        (ARM + MOTOR + ELASTIC.replace("NAME", "a") + SPRING, "K1", True),
        (ARM + ELASTIC.replace("NAME", "b") + SPRING, "K1", False),
        (crank_moved_by_the_rocker(), "Kcrank", True),
    ],
    ids=[
        "no motor",
        "torque zero",
        "motor",
        "behind an elastic motor",
        "beside an elastic motor",
        "motor on a passive joint",
    ],
)
def test_a_spring_is_refused_where_its_stiffness_is_no_base_parameter(
    tmp_path: Path, text: str, stiffness: str, told: bool
) -> None:
    text = text if text.startswith("#") else f'schema = 1\nname = "arm"\n{text}'
    (tmp_path / "device.toml").write_text(text)
    device = haptid.read_device(tmp_path / "device.toml")
    assert (stiffness in haptid.DynamicModel(device).base.names) == told
    positions, torques = position_channels(device, "joint"), torque_channels(device, "motor")
    q, tau = np.random.default_rng(1).uniform(-1, 1, (100, len(positions))), np.ones((100, len(torques)))
    signals = haptid.Signal(tuple(positions), "rad"), haptid.Signal(tuple(torques), "N m", side="motor")
    log = haptid.Log(Path("made"), "", 1e-3 * np.arange(100), q, tau, haptid.Channels(*signals, "t"))
    if told:
        check_log(device, log)
    else:
        with pytest.raises(LogMismatchError, match="a spring holds 1, which no motor moves"):
            check_log(device, log)
