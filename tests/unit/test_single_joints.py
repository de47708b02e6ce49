"""Logs of single joints through the whole path: a device file and a table of samples, nothing else given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid.advice import advise
from haptid.device import read_device
from haptid.inference.diagnosis import diagnose
from haptid.study import read_study
from haptid.study.draft import draft_study
from haptid.study.identify import Identification, identify

DEVICE = """
schema = 1
name = "pendulum"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
[[terms]]
kind = "viscous"
joints = "all"
[[prior.bodies]]
link = "1"
mass = 0.7
com = [0.5, 0.0, 0.0]
inertia = [0.0, 0.0, 0.003, 0.0, 0.0, 0.0]
"""
WEIGHT, INERTIA = 0.7 * 0.5 * 9.81, 0.003 + 0.7 * 0.25


def swung(seconds: float = 12.0, rate: float = 250.0, seed: int = 1) -> tuple[np.ndarray, ...]:
    """Time, position, velocity and acceleration of a joint that follows five sines."""
    rng, t = np.random.default_rng(seed), np.arange(0, seconds, 1 / rate)
    w, phase = 2 * np.pi * rng.uniform(0.2, 1.4, (5, 1)), rng.uniform(0, 6, (5, 1))
    a = 0.9 / (1 + w)
    x = w * t + phase
    return t, (a * np.sin(x)).sum(0), (a * w * np.cos(x)).sum(0), -(a * w**2 * np.sin(x)).sum(0)


def identified(folder: Path, columns: dict[str, np.ndarray], more: str = "") -> Identification:
    """The study that is drafted for one log, carried out as it is, or with more tables."""
    (folder / "device.toml").write_text(DEVICE)
    names, values = list(columns), np.column_stack(list(columns.values()))
    np.savetxt(folder / "log.csv", values, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    text, _ = draft_study(
        [folder / "log.csv"], read_device(folder / "device.toml"), str(folder / "device.toml"), folder
    )
    (folder / "study.toml").write_text(f"{text}\n{more}")
    return identify(read_study(folder / "study.toml"))


@pytest.mark.parametrize("hand", [True, False])
def test_a_hand_that_moves_a_carried_weight_is_no_wrong_sign(tmp_path: Path, hand: bool) -> None:
    """The inertia of such a log is zero but for errors, here below it; a motor's wrong sign still is told."""
    t, q, v, a = swung()
    rng = np.random.default_rng(2)
    torque = 1.2 * WEIGHT * np.cos(q) - 0.0025 * a if hand else -(INERTIA * a + 0.05 * v + WEIGHT * np.cos(q))
    made = identified(tmp_path, {"t": t, "q1": q, "tau1": torque + 0.002 * rng.standard_normal(t.size)})
    found = diagnose(made.estimate)
    signs = [action for action in advise(made, found).actions if action.kind == "torque sign"]
    assert bool(signs) != hand
    assert ("moved from outside" in {finding.name for finding in found.findings}) == hand


def test_a_late_torque_with_positive_friction_is_not_called_reversed(tmp_path: Path) -> None:
    """A delay takes away viscous friction times itself of the inertia, here more than there is."""
    t, q, v, a = swung()
    torque = np.interp(t - 0.05, t, INERTIA * a + 7.0 * v + WEIGHT * np.cos(q))
    noise = 0.002 * np.random.default_rng(2).standard_normal(t.size)
    made = identified(tmp_path, {"t": t, "q1": q, "tau1": torque + noise}, "[treatment]\ntorque_delay_s = 0.0\n")
    found = diagnose(made.estimate)
    finding = next(one for one in found.findings if one.name == "units and signs")
    assert finding.figures["factor motor 1"] == pytest.approx(-1.0, abs=0.2)
    assert not [action for action in advise(made, found).actions if action.kind == "torque sign"]


def test_noise_of_the_positions_does_not_attenuate_a_free_swing(tmp_path: Path) -> None:
    """The torque of a pendulum that is kept swinging is a small difference of its weight and its inertia.

    The same noise matters far less behind a narrow parallel filter, and the parameters come back.
    """
    rate, seconds, fine = 250.0, 20.0, 4
    t = np.arange(0, seconds, 1 / rate / fine)
    torque = 0.25 * np.sin(4.0 * t) + 0.15 * np.sin(2.6 * t + 1.0) + 0.1 * np.sin(6.9 * t)
    q, v = np.empty_like(t), np.empty_like(t)
    x, s = -np.pi / 2, 0.0
    for k, drive in enumerate(torque):
        q[k], v[k] = x, s
        s += (drive - 0.03 * s - WEIGHT * np.cos(x)) / INERTIA / rate / fine
        x += s / rate / fine
    rng = np.random.default_rng(3)
    noise = np.zeros(t.size // fine)
    for k in range(1, noise.size):  # as of a belt or a frame that vibrates: more at low frequencies
        noise[k] = 0.8 * noise[k - 1] + 0.0012 * rng.standard_normal()
    columns = {
        "t": t[::fine],
        "q1": q[::fine] + noise,
        "tau1": torque[::fine] + 0.005 * rng.standard_normal(noise.size),
    }
    made = identified(tmp_path, columns)
    assert any("errors of the positions matter" in reason for reason in made.proposal.reasons)
    truth = np.array([INERTIA, WEIGHT / 9.81, 0.0, 0.03])
    np.testing.assert_array_less(np.abs(made.estimate.beta - truth), 4 * made.estimate.se)
    assert (made.estimate.se[:2] / truth[:2]).max() < 0.02  # 0.08 behind three times the bandwidth, and as much off


def test_a_pendulum_that_turns_is_read_in_radians(tmp_path: Path) -> None:
    """Beyond two turns the weight, a sine of the angle, tells the unit; advice corrects a wrong one in the study."""
    t, q, v, a = swung()
    q, v = q + 1.6 * t, v + 1.6
    torque = INERTIA * a + 0.05 * v + WEIGHT * np.cos(q) + 0.02 * np.random.default_rng(4).standard_normal(t.size)
    right = identified(tmp_path, {"t": t, "q1": q, "tau1": torque})
    assert right.study.logs[0].channels.position.unit == "rad"
    text = (tmp_path / "study.toml").read_text()
    (tmp_path / "study.toml").write_text(text.replace('unit = "rad"', 'unit = "deg"'))
    made = identify(read_study(tmp_path / "study.toml"))
    first = advise(made).actions[0]
    assert first.sentence.startswith("Read the positions in rad and not in deg: the error on")
    assert first.after < 10 < first.before
    (study,) = (edit for edit in first.edits)
    assert (study.path, study.value) == (("channels", "position", "unit"), "rad")
