"""Slip and play between motors and links that are both measured: made logs with known sizes, silence on others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import haptid
from elastic_motors import STEP, axis, recorded
from haptid.inference.diagnosis.torsion import torsion_findings
from loose_axis import Axis
from loose_axis import recorded as loose

DRY = [
    {"kind": "elastic", "motors": "all"},
    {"kind": "rotor-inertia", "motors": "all"},
    {"kind": "viscous", "joints": "all"},
    {"kind": "coulomb", "joints": "all"},
    {"kind": "coulomb", "motors": "all"},
]


def estimated(model: haptid.DynamicModel, log: haptid.Log) -> haptid.Estimate:
    """With both sides measured, treated as proposed."""
    return haptid.estimate(haptid.observe(model, haptid.treat(log, haptid.propose(model, log).treatment)), haptid.WLS())


def slipped(*slips: tuple[float, float], seconds: float = 8.0) -> haptid.Log:
    """Both sides of the elastic axis; its motor's encoder reads more from some times on, by whole steps."""
    log = recorded(seconds=seconds)
    position = np.array(log.position)
    for at, size in slips:
        position[log.t >= at, 1] += STEP * round(size / STEP)
    return replace(log, position=position)


def test_slips_are_told_with_times_and_sizes():
    slip, play = torsion_findings(estimated(axis(), slipped((3.0, 0.004), (6.5, -0.006))))
    assert (slip.name, slip.status, play.name, play.status) == ("slip", "bad", "play", "ok")
    assert sum(name.endswith(", at") for name in slip.figures) == 2
    for n, (at, size) in enumerate(((3.0, 0.004), (6.5, -0.006)), 1):
        when, found, low, high = (slip.figures[f"motor 1, slip {n}, {what}"] for what in ("at", "size", "low", "high"))
        assert abs(when - at) < 0.1
        assert abs(found - size) < 0.02 * abs(size)
        assert high - low < 0.05 * abs(size)
    assert "time_range = [3" in slip.sentence  # the longest part


def test_the_interval_of_a_slip_holds_it():
    """Sixteen steps of the encoder, 0.4 % of the torsion's range."""
    (slip, _) = torsion_findings(estimated(axis(), slipped((5.0, 0.0005))))
    low, high = (slip.figures[f"motor 1, slip 1, {what}"] for what in ("low", "high"))
    assert low < STEP * round(0.0005 / STEP) < high


def test_a_zero_of_the_torque_that_changes_is_no_slip():
    log = recorded(seconds=8.0)
    torque = np.array(log.torque)
    torque[log.t >= 4.0] += 2.0
    slip, play = torsion_findings(estimated(axis(), replace(log, torque=torque)))
    assert slip.status == play.status == "ok"


def test_play_is_found_between_both_sides():
    """Against two bodies with a dead zone, whose flanks do not pull."""
    model = axis(terms=DRY)
    for size in (0.001, 0.004):
        (log,) = loose(Axis(size, stiffness=600.0), [0], 8.0, link=True)
        slip, play = torsion_findings(estimated(model, log))
        assert (slip.status, play.status) == ("ok", "bad")
        assert play.figures["motor 1, play"] == pytest.approx(size, rel=0.03)
        assert play.figures["motor 1, low"] < size * 1.01
        assert play.figures["motor 1, high"] > size * 0.99


@pytest.mark.parametrize("counts", [4096.0, 20_000.0])
def test_nothing_is_said_of_a_spring_without_play(counts):
    (log,) = loose(Axis(0.0, stiffness=600.0, counts=counts), [0], 8.0, link=True)
    assert [finding.status for finding in torsion_findings(estimated(axis(terms=DRY), log))] == ["ok", "ok"]


def test_a_diagnosis_tells_of_slip():
    estimate = estimated(axis(), slipped((5.0, 0.004)))
    assert haptid.diagnose(estimate)["slip"].status == "bad"
    assert haptid.diagnose(estimated(axis(), slipped()))["slip"].status == "ok"
