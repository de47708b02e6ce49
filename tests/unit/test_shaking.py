"""Rotors that a controller shakes by the steps of their encoders: slow rows are dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import haptid
from elastic_motors import DT, IA, STEP, axis, recorded
from haptid.treatment_choice.shaking import shaken_speeds

DRY = [
    {"kind": "elastic", "motors": "all"},
    {"kind": "rotor-inertia", "motors": "all"},
    {"kind": "viscous", "joints": "all"},
    {"kind": "coulomb", "motors": "all"},
]
GAIN, BANDWIDTH = 20.0, 11.0


def coarse(loop: bool) -> haptid.Log:
    """Both sides of the elastic axis with steps of 3 mrad; in a loop with a gain on speed, too."""
    log, step = recorded(seconds=12.0), 100 * STEP
    position = step * np.round(log.position / step)
    torque = np.array(log.torque)
    if loop:
        torque[:, 0] -= GAIN * np.gradient(position[:, 1] - log.position[:, 1], DT)
    return replace(log, position=position, torque=torque)


@pytest.fixture(scope="module")
def treatment():
    return haptid.Treatment(cutoff_hz=40.0, decimation=10, parallel_cutoff_hz=16.0)


def test_the_speed_follows_from_the_loop_and_the_rotor(treatment):
    """A gain on speed times white rounding, over the inertia; the slope by differences is a sine of the frequency."""
    speeds = shaken_speeds(axis(terms=DRY), [coarse(True)], treatment, BANDWIDTH)
    f = np.linspace(4 * BANDWIDTH, 450.0, 500)
    seen = np.mean((np.sin(2 * np.pi * f * DT) / (2 * np.pi * f * DT)) ** 2) * (450 - 4 * BANDWIDTH) / 500
    expected = 2.5 * GAIN * 100 * STEP / np.sqrt(12) * np.sqrt(seen) / IA
    assert speeds == pytest.approx([expected, expected], rel=0.15)


def test_torque_that_does_not_follow_the_steps_shakes_nothing(treatment):
    log = coarse(False)
    noisy = replace(log, torque=log.torque + np.random.default_rng(0).standard_normal(log.torque.shape))
    assert not shaken_speeds(axis(terms=DRY), [noisy], treatment, BANDWIDTH).any()
    rigid = axis(terms=DRY[1:])
    channels = haptid.Channels(haptid.Signal(("q",), "rad"), log.channels.torque, "t")
    motor = replace(coarse(True), position=np.ascontiguousarray(log.position[:, 1:]), channels=channels)
    assert not shaken_speeds(rigid, [motor], treatment, BANDWIDTH).any()


def test_slow_rows_of_a_shaken_rotor_are_dropped():
    still, shaken = (haptid.propose(axis(terms=DRY), coarse(loop)) for loop in (False, True))
    assert max(shaken.treatment.reversal_speed) > 2 * max(still.treatment.reversal_speed)
    assert shaken.treatment.reversal_guard_s is None  # windows without any of it
    assert any("shakes the rotors" in reason for reason in shaken.reasons)
    assert not any("shakes the rotors" in reason for reason in still.reasons)
