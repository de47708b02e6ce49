"""Torque channels that are not connected and show noise: of many values, and of no weight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

import haptid
from diagnosed import log, phantom
from haptid.advice.recorder import faults
from haptid.log.noise_alone import check_torques, noise_alone
from small_study import columns

TREATMENT = haptid.Treatment(cutoff_hz=60.0, parallel_cutoff_hz=30.0, torque_delay_s=0.0)


def with_noise(size: float, share: float = 0.0) -> haptid.Log:
    """A clean log whose third torque channel is noise of this deviation, and this share of the torque."""
    made = log(3, noise=0.0)
    torque = np.array(made.torque)
    torque[:, 2] = share * torque[:, 2] + size * np.random.default_rng(1).standard_normal(len(torque))
    return replace(made, torque=torque)


@pytest.mark.parametrize("size", [1e-4, 1.0])
def test_a_channel_of_noise_is_refused(size: float) -> None:
    made = with_noise(size)
    assert noise_alone(made).tolist() == [False, False, True]
    with pytest.raises(haptid.errors.LogDataError, match=r"torque channel u3 shows noise alone .*constant_ok = true"):
        haptid.observe(phantom(), haptid.treat(made, TREATMENT))


@pytest.mark.parametrize("size", [1e-4, 1.0])
def test_a_channel_of_noise_that_is_allowed_hardly_counts(size: float) -> None:
    made = with_noise(size)
    torque = replace(made.channels.torque, constant_ok=True)
    made = replace(made, channels=replace(made.channels, torque=torque))
    rows = haptid.observe(phantom(), haptid.treat(made, TREATMENT))
    assert any(note.startswith("torque channel u3 shows noise alone") for note in rows.notes)
    found = haptid.estimate(rows, haptid.WLS())
    clean = haptid.estimate(haptid.observe(phantom(), haptid.treat(log(3, noise=0.0), TREATMENT)), haptid.WLS())
    for motor in rows.motors[:2]:
        assert motor.residual(found.beta) < 1.1 * motor.residual(clean.beta)
    assert [(fault.kind, fault.channel) for fault in faults(made)] == [("dead torque", 2)]


def test_a_noisy_torque_is_no_noise_alone() -> None:
    made = log(3, noise=0.0)
    rms = float(np.std(made.torque[:, 2]))
    assert not noise_alone(with_noise(3 * rms, share=1.0)).any()
    assert check_torques(made) == ()


def test_a_torque_that_is_switched_is_no_noise_alone() -> None:
    """As of a controller that chatters: the torque is right in the mean alone."""
    made, rng = log(3, noise=0.0), np.random.default_rng(2)
    torque = np.array(made.torque)
    limit = 2 * float(np.abs(torque[:, 2]).max())
    torque[:, 2] = limit * np.sign(torque[:, 2] / limit + rng.uniform(-1, 1, len(torque)))
    assert not noise_alone(replace(made, torque=torque)).any()


@pytest.mark.parametrize("allowed", [False, True])
def test_a_channel_of_noise_is_said_of_logs_on_disk_as_of_others(tmp_path: Path, allowed: bool) -> None:
    table = columns(1, 30.0)
    table["tau2"] = 0.05 * np.random.default_rng(3).standard_normal(len(table["t"]))
    pyarrow.parquet.write_table(pa.table(table), tmp_path / "log.parquet")
    torque = haptid.Signal(("tau1", "tau2"), "N m", constant_ok=allowed)
    channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), torque, time="t")
    said = []
    for read in (haptid.read_log, haptid.open_log):
        try:
            said.append(str(check_torques(read(tmp_path / "log.parquet", channels))))
        except haptid.errors.LogDataError as error:
            said.append(str(error))
    assert "tau2 shows noise alone" in said[0]
    assert said[0] == said[1]


def test_a_joint_that_stands_still_may_show_noise_alone() -> None:
    """As in logs of one axis after the other; its channel counts as it did."""
    made, rng = with_noise(1e-2), np.random.default_rng(3)
    position = np.array(made.position)
    position[:, 2] = position[0, 2] + 1e-5 * rng.standard_normal(len(position))
    made = replace(made, position=position)
    assert not noise_alone(made).any()
    assert check_torques(made) == ()
