"""Limit cycles: held positions that swing are told with size and frequency, decaying and moving ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest

import haptid
from haptid.inference.diagnosis.limit_cycle import limit_cycle
from loose_axis import Axis, estimated, recorded

DT, STEP = 1e-3, 2 * np.pi / 20_000


def held(swing, seed=0):
    """A log of 14 s: motion, then 8 s in which the axis is held and swings by a function of the time of the hold."""
    (log,) = recorded(Axis(), [seed], 6.0)
    t = DT * np.arange(14_000)
    rest = swing(t[6000:] - t[6000])
    position = np.concatenate([log.position[:, 0], log.position[-1, 0] + rest])
    torque = np.concatenate([log.torque[:, 0], 0.05 * np.random.default_rng(seed).standard_normal(len(rest))])
    seen = STEP * np.round(position / STEP)
    return replace(log, t=t, position=seen[:, None], torque=torque[:, None], segments=())


def found(log):
    return limit_cycle(estimated(Axis(), log))


@pytest.mark.parametrize("triangular", [False, True])
def test_a_held_axis_that_swings_is_told(triangular):
    """Ten millirad from end to end, 7.3 times a second, as a sine and as a triangle."""

    def swing(t):
        phase = (7.3 * t) % 1
        return 0.005 * (np.sin(2 * np.pi * phase) if not triangular else 4 * np.abs(phase - 0.5) - 1)

    finding = found(held(swing))
    assert finding.status == "bad"
    assert finding.figures["1, frequency"] == pytest.approx(7.3, rel=0.02)
    assert finding.figures["1, low"] < 0.01 < finding.figures["1, high"]
    assert finding.figures["1, high"] - finding.figures["1, low"] < 0.002
    assert "exclude = [[6, 14]]" in finding.sentence


@pytest.mark.parametrize(
    "swing",
    [
        lambda t: 0.01 * np.exp(-0.7 * t) * np.sin(2 * np.pi * 7 * t),
        lambda t: 0.002 * np.random.default_rng(1).standard_normal(len(t)),
        lambda t: STEP * (np.sin(2 * np.pi * 9 * t) > 0),
        lambda t: 0.003 * t,
    ],
    ids=["decays", "noise", "flicker of the encoder", "creeps"],
)
def test_other_rest_is_no_limit_cycle(swing):
    assert found(held(swing)).status == "ok"


def test_motion_is_no_limit_cycle_in_a_diagnosis():
    (log,) = recorded(Axis(), [1], 8.0)
    assert haptid.diagnose(estimated(Axis(), log))["limit cycle"].status == "ok"


def test_times_behind_a_gap_are_those_of_the_log():
    """The hold begins at 6 s of samples; 100 s are lost there, and the stamps are those of a clock that ran before."""
    log = held(lambda t: 0.005 * np.sin(2 * np.pi * 7.3 * t))
    t = log.t + 12_340 + np.where(np.arange(len(log.t)) < 6000, 0.0, 100.0)
    finding = found(replace(log, t=t, segments=((0, 6000), (6000, 14_000))))
    assert "exclude = [[12446, 12454]]" in finding.sentence


def test_a_log_on_disk_is_looked_at_too(tmp_path):
    log = held(lambda t: 0.005 * np.sin(2 * np.pi * 7.3 * t))
    channels = replace(log.channels, time="t")
    columns = {"t": log.t, channels.position.channels[0]: log.position[:, 0]}
    columns[channels.torque.channels[0]] = log.torque[:, 0]
    parquet.write_table(pyarrow.table(columns), tmp_path / "held.parquet")
    opened = haptid.open_log(tmp_path / "held.parquet", channels)
    assert found(opened).sentence == found(log).sentence
    assert haptid.diagnose(estimated(Axis(), opened))["limit cycle"].status == "bad"
