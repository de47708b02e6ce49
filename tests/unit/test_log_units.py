"""One unit for each channel: an arm with angles and a length, at the joint side, from file to estimate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.errors import LogChannelError, LogMismatchError
from haptid.log import Channels, Signal
from haptid.log.units import closest_unit, known_unit, scale
from haptid.study.draft import draft_study

SCARA = """
schema = 1
name = "scara"
gravity = [0.0, 0.0, -9.81]

[[joints]]
name = "1"

[[joints]]
name = "2"
d = 0.3

[[joints]]
name = "3"
type = "prismatic"
d = 0.25

[[terms]]
kind = "viscous"
joints = "all"
"""
T = np.arange(0.0, 20, 0.004)


def recorded(folder: Path) -> tuple[Path, haptid.DynamicModel, np.ndarray]:
    """Degrees and mm, N m and N, of known parameters."""
    file = folder / "scara.toml"
    file.write_text(SCARA)
    model = haptid.DynamicModel(haptid.read_device(file))
    chi = np.random.default_rng(4).uniform(0.2, 1.0, len(model.device.parameters.names))
    w = 2 * np.pi * np.array([[0.31, 0.83], [0.47, 0.71], [0.59, 0.37]])
    size = np.array([[0.8, 0.3], [0.7, 0.4], [0.06, 0.03]])
    q = [
        np.sum(size[..., None] * w[..., None] ** k * np.sin(w[..., None] * T + 0.5 * k * np.pi), axis=1)
        for k in range(3)
    ]
    beta = model.base.of(chi)
    tau = haptid.inverse_dynamics(model, beta, *q)
    table = np.column_stack([T, np.degrees(q[0][:2]).T, 1e3 * q[0][2], tau.T])
    log = folder / "log.csv"
    np.savetxt(log, table, "%.9g", ",", header="t,q1,q2,q3,tau1,tau2,tau3", comments="")
    return log, model, beta


def test_angles_and_lengths_in_one_signal(tmp_path: Path) -> None:
    path, model, beta = recorded(tmp_path)
    position = Signal(("q1", "q2", "q3"), "", units=("deg", "deg", "mm"))
    torque = Signal(("tau1", "tau2", "tau3"), "", units=("N m", "N m", "N"))
    log = haptid.read_log(path, Channels(position, torque, "t"))
    motion = haptid.treat(log, haptid.propose(model, log).treatment)
    estimate = haptid.estimate(haptid.observe(model, motion), haptid.WLS())
    np.testing.assert_allclose([p.value for p in estimate.parameters], beta, rtol=0.02, atol=0.01)
    for units in (("deg", "deg", "deg"), ("mm", "deg", "mm")):
        wrong = haptid.read_log(path, Channels(Signal(position.channels, "", units=units), torque, "t"))
        with pytest.raises(LogMismatchError, match=r'unit = \["deg", "deg", "mm"\]'):
            haptid.propose(model, wrong)


def test_a_draft_has_the_units_of_the_joints(tmp_path: Path) -> None:
    path, model, _ = recorded(tmp_path)
    text, _ = draft_study([path], model.device, "scara.toml", tmp_path)
    assert 'unit = ["deg", "deg", "mm"]' in text
    assert 'unit = ["N m", "N m", "N"]' in text
    study = tmp_path / "study.toml"
    study.write_text(text)
    log = haptid.read_study(study).logs[0]
    assert log.channels is not None
    assert log.channels.position.scales("position") == pytest.approx((np.pi / 180, np.pi / 180, 1e-3))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("mN", 1e-3), ("kN", 1e3), ("MN", 1e6), ("kNm", 1e3), ("mNm", 1e-3), ("MNm", 1e6), ("MN m", 1e6), ("MN·m", 1e6),
     ("mnm", 1e-3), ("mn", 1e-3), ("N.mm", 1e-3), ("Nmm", 1e-3), ("N-m", 1.0), ("mN-m", 1e-3)],
)  # fmt: skip
def test_multiples_of_forces_and_torques(unit: str, factor: float) -> None:
    quantity, name = known_unit(unit) or ("", "")
    assert quantity == "torque"
    assert scale(name, "torque") == ("N m" if "m" in unit[1:] else "N", factor)
    assert closest_unit(unit, "torque") == name


def test_an_unknown_unit_that_may_be_two_is_asked() -> None:
    with pytest.raises(LogChannelError) as raised:
        scale("MNM", "torque")
    assert raised.value.advice.startswith("Write 'mN m' or 'MN m'.")
