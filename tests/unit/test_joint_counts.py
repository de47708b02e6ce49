"""Zeros and directions of joints by another convention than the device file's, found on torques of a known arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_part_of_a_long_log import on_disk

import haptid
from haptid.advice.conventions import other_counts

ARM = """
schema = 1
name = "four joints"
gravity = [0.0, 0.0, -9.81]
convention = "modified-dh"
joints = [
    { name = "1" },
    { name = "2", alpha = "pi/2" },
    { name = "3", d = 0.4 },
    { name = "4", d = 0.35 },
]
terms = [{ kind = "viscous", joints = "all" }]
"""
TURN = np.pi / 2


@pytest.fixture
def model(tmp_path: Path) -> haptid.DynamicModel:
    (tmp_path / "arm.toml").write_text(ARM)
    return haptid.DynamicModel(haptid.read_device(tmp_path / "arm.toml"))


def moved(model: haptid.DynamicModel, direction: np.ndarray, turns: np.ndarray) -> haptid.Motion:
    """Torques of the arm with 1 % of noise, and positions as a log counts them: turns before the device's."""
    rng, t = np.random.default_rng(3), np.arange(0.0, 40.0, 0.01)
    q, qd, qdd = np.zeros((3, 4, t.size))
    for joint in range(4):
        for f in (0.11, 0.23, 0.37):
            a, p, w = rng.uniform(0.4, 1.0), rng.uniform(0, 6), 2 * np.pi * f * (1 + 0.07 * joint)
            q[joint] += a * np.sin(w * t + p)
            qd[joint] += a * w * np.cos(w * t + p)
            qdd[joint] -= a * w * w * np.sin(w * t + p)
    chi = np.zeros(len(model.device.parameters.names))
    values = {"M": (3, 2, 2, 1), "MX": (0.1, 0.1, 0.6, 0.2), "ZZ": (0.1, 0.2, 0.3, 0.1), "FV": (1, 1, 0.5, 0.2)}
    for k, name in enumerate(model.device.parameters.names):
        stem = name.rstrip("1234")
        if stem in values:
            chi[k] = values[stem][int(name[len(stem) :]) - 1]
    tau = haptid.inverse_dynamics(model, model.base.of(chi), q, qd, qdd)
    tau += 0.01 * tau.std(axis=1, keepdims=True) * rng.standard_normal(tau.shape)
    counted = direction[:, None] * (q - turns[:, None])
    rates = tuple(direction * rate.T for rate in (qd, qdd))
    treatment = haptid.Treatment(cutoff_hz=5.0, parallel_cutoff_hz=4.0, decimation=5, block_s=1.0)
    return haptid.Motion(0.01, counted.T, (direction[:, None] * tau).T, treatment, rates=rates)


@pytest.mark.parametrize(
    ("turns", "words"),
    [
        ((0, 1, 0, 0), "add 90 deg to the position of joint 2"),
        ((0, 2, 0, 0), "add 180 deg to the position of joint 2"),
        ((0, 1, -1, 0), "add 90 deg to the position of joint 2 and add -90 deg to the position of joint 3"),
        ((0, 1, 1, 0), "add 90 deg to the position of joint 2 and joint 3"),
    ],
)
def test_quarter_turns_are_found_joint_by_joint_or_as_neighbours(
    turns: tuple[int, ...], words: str, model: haptid.DynamicModel
) -> None:
    motion = moved(model, np.ones(4), TURN * np.array(turns))
    found = other_counts(model, [motion], np.zeros(len(model.base)), (), 0.4)
    assert found is not None
    assert found.words == words
    assert found.after < 3.0
    assert [edit.value / TURN for edit in found.edits] == pytest.approx([k for k in turns if k])


def test_reversed_joints_are_found_with_their_torques(model: haptid.DynamicModel) -> None:
    motion = moved(model, np.array([1.0, 1.0, -1.0, 1.0]), np.array([0.0, TURN, 0.0, 0.0]))
    found = other_counts(model, [motion], np.zeros(len(model.base)), (), 0.4)
    assert found is not None
    assert found.places == ("joint 2", "joint 3")
    assert {(edit.path[1], edit.path[2]) for edit in found.edits if edit.operation == "multiply"} == {
        (signal, key) for signal in ("position", "torque") for key in ("gain", "offset")
    }
    assert found.after < 3.0


def test_a_log_that_counts_as_the_device_file_is_left_alone(model: haptid.DynamicModel) -> None:
    assert other_counts(model, [moved(model, np.ones(4), np.zeros(4))], np.zeros(len(model.base)), (), 0.4) is None


def recorded(motion: haptid.Motion, every: int) -> haptid.Log:
    """A log of every n-th sample."""
    q, tau = motion.q[::every], motion.tau[::every]
    channels = haptid.Channels(haptid.Signal(tuple("1234"), "rad"), haptid.Signal(tuple("abcd"), "N m"), "t")
    return haptid.Log(Path("log"), "", 0.01 * every * np.arange(len(q)), q, tau, channels)


def test_logs_of_a_fit_have_filters_that_their_own_rates_carry(model: haptid.DynamicModel) -> None:
    """A cut-off that passes the motion of the fastest log was above half the rate of a slow one: an error."""
    fast = moved(model, np.ones(4), TURN * np.array([0, 1, 0, 0]))
    settings = haptid.Treatment(cutoff_hz=3.5, parallel_cutoff_hz=1.5, decimation=1, block_s=1.0)
    motions = [haptid.treat(recorded(fast, every), settings) for every in (1, 10)]
    found = other_counts(model, motions, np.zeros(len(model.base)), (), 2.0)
    assert found is not None
    assert found.places == ("joint 2",)


def test_torques_of_a_log_on_disk_are_read_once(model: haptid.DynamicModel) -> None:
    """In each of dozens of trials all were read, and delayed."""
    short = moved(model, np.ones(4), TURN * np.array([0, 1, 0, 0]))
    q, tau = (np.tile(x, (5, 1)) for x in (short.q, short.tau))
    signals = [haptid.Signal(tuple("1234"), "rad"), haptid.Signal(tuple("abcd"), "N m")]
    parts = tuple((k * len(short), (k + 1) * len(short)) for k in range(5))
    log = haptid.Log(Path("long"), "", 0.01 * np.arange(len(q)), q, tau, haptid.Channels(*signals, "t"), segments=parts)
    motion = haptid.treat(on_disk(log), short.treatment)
    before = motion.log.torque.read
    found = other_counts(model, [motion], np.zeros(len(model.base)), (), 0.4)
    assert found is not None
    assert found.places == ("joint 2",)
    assert motion.log.torque.read - before < 2 * len(q)
