"""A hand guides a device that compensates its own gravity: the log says so, and no sign is called wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.advice import advise
from haptid.inference.diagnosis import diagnose
from motions import multisine

PENDULUM = """
schema = 1
name = "pendulum"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
[[prior.bodies]]
link = "1"
mass = 0.7
com = [0.4, 0.0, 0.0]
inertia = [0.01, 0.02, 0.02, 0.0, 0.0, 0.0]
"""


def identified(folder: Path, by_hand: bool, inertia: float = 0.02, dry: float = 0.05) -> haptid.Identification:
    q, qd, qdd = (x[0] for x in multisine(1, 20.0, 2e-3, 4))
    t, rng = 2e-3 * np.arange(q.size), np.random.default_rng(1)
    weight = 0.7 * 0.4 * 9.81 * np.cos(q)
    # A controller's gravity compensation lags a little: what there is of inertia has the wrong sign.
    tau = weight - 0.002 * qdd if by_hand else weight + (0.7 * 0.16 + 0.02) * qdd + 0.02 * qd + dry * np.sign(qd)
    tau = tau + 0.01 * rng.standard_normal(q.size)
    table = np.column_stack([t, 1e-4 * np.round(q / 1e-4), tau])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="t,q1,tau1", comments="")
    (folder / "device.toml").write_text(PENDULUM.replace("0.01, 0.02, 0.02", f"0.01, {inertia}, {inertia}"))
    (folder / "study.toml").write_text(
        'schema = 1\ndevice = "device.toml"\n[channels]\ntime = "t"\nposition = { channels = ["q1"], unit = "rad" }\n'
        'torque = { channels = ["tau1"], unit = "N m" }\n[[logs]]\npath = "log.csv"\n'
    )
    return haptid.identify(haptid.read_study(folder / "study.toml"))


@pytest.mark.parametrize("by_hand", [True, False])
def test_a_device_that_a_hand_moves_is_told_from_one_with_a_wrong_sign(tmp_path: Path, by_hand: bool) -> None:
    found = identified(tmp_path, by_hand)
    diagnosis = diagnose(found.estimate)
    names = {finding.name for finding in diagnosis.findings if finding.status == "bad"}
    assert ("moved from outside" in names) == by_hand
    assert "units and signs" not in names
    if by_hand:
        figures = diagnosis["moved from outside"].figures
        assert figures["weight motor 1"] == pytest.approx(1.0, abs=0.02)
        assert figures["inertial motor 1"] == pytest.approx(-0.002 / 0.132, abs=0.01)
        assert "something else moved the device" in diagnosis["moved from outside"].sentence
    assert not any(action.kind in ("torque sign", "unit") for action in advise(found, diagnosis).actions)


def test_a_motor_that_overcomes_dry_friction_moves_its_joint(tmp_path: Path) -> None:
    """Robot descriptions state inertias that are far too large, such as a widespread one of the UR5's wrist."""
    found = identified(tmp_path, by_hand=False, inertia=1.0, dry=0.6)
    findings = {finding.name: finding for finding in diagnose(found.estimate).findings}
    assert "moved from outside" not in findings
    factor = findings["units and signs"].figures["factor motor 1"]
    assert factor == pytest.approx((0.7 * 0.16 + 0.02) / (0.7 * 0.16 + 1.0), rel=0.02)
