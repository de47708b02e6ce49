"""Measured logs are read as their authors describe them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from haptid import errors
from haptid.log import Channels, Signal, read_log


def numbered(name: str, n: int = 6) -> tuple[str, ...]:
    return tuple(name.format(k) for k in range(1, n + 1))


ARM = Channels(
    position=Signal(numbered("rec.act_pos_mot_deg[{}]"), "deg"),
    torque=Signal(numbered("rec.act_torque_abs_nm[{}]"), "N m", "motor"),
    time="rec.time_cont",
)


@pytest.mark.parametrize("name", ["DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"])
def test_positioning_axis(shared_data: Path, name: str) -> None:
    channels = Channels(Signal("qm", "m"), Signal("vir", "V", "motor"), time="t")
    log = read_log(shared_data / "emps" / name, channels)
    assert log.position.shape == log.torque.shape == (24841, 1)
    assert log.rate_hz == pytest.approx(1000, rel=1e-6)
    assert log.t[-1] == pytest.approx(24.84, rel=1e-6)
    assert log.channels.torque_unit == "V"
    assert log.notes == ()  # its stamps jitter by 24 ns, which moves no position


def test_positioning_axis_gives_the_published_parameters_roughly(shared_data: Path) -> None:
    """Least squares on the raw log, smoothed over 25 ms: within 2 % of the published mass and friction."""
    channels = Channels(Signal("qm", "m"), Signal("vir", "V", "motor"), time="t")
    log = read_log(shared_data / "emps" / "DATA_EMPS.mat", channels)
    published = json.loads((shared_data / "emps" / "params.json").read_text())
    window = np.hanning(51) / np.hanning(51).sum()

    def smooth(x: np.ndarray) -> np.ndarray:
        return np.convolve(x, window, "same")

    v = np.gradient(smooth(log.position[:, 0]), log.dt)
    W = np.column_stack([smooth(x) for x in (np.gradient(v, log.dt), v, np.sign(v), np.ones_like(v))])
    y = smooth(smooth(log.torque[:, 0])) * published["gtau_N_per_V"]
    part = slice(200, -200, 10)
    mass, viscous, dry, _ = np.linalg.lstsq(W[part], y[part], rcond=None)[0]
    assert mass == pytest.approx(published["published"]["M"], rel=0.02)
    assert viscous == pytest.approx(published["published"]["Fv"], rel=0.05)
    assert dry == pytest.approx(published["published"]["Fc"], rel=0.05)


def test_six_axis_arm_of_the_motor_side(shared_data: Path) -> None:
    channels = Channels(Signal(numbered("qm{}"), "rad", "motor"), Signal(numbered("taum{}"), "N m", "motor"), time="t")
    log = read_log(shared_data / "staubli_tx40" / "tx40_log.parquet", channels)
    assert log.position.shape == log.torque.shape == (45000, 6)
    assert log.rate_hz == pytest.approx(5000, rel=1e-9)
    assert log.notes == ()
    np.testing.assert_array_equal(log.position[0, :3], [3.1958e-05, 50.265, -70.685])


@pytest.mark.parametrize("run", "ABC")
def test_heavy_arm_with_structs(shared_data: Path, run: str) -> None:
    log = read_log(shared_data / "kuka_kr300" / f"recorded_FF_{run}.mat", ARM)
    assert log.position.shape == log.torque.shape == (2501, 6)
    assert log.rate_hz == pytest.approx(250, rel=1e-6)
    assert np.abs(log.position).max() < np.radians(80)
    assert log.notes == ()


def test_encoders_that_are_not_fitted_are_named(shared_data: Path) -> None:
    """The secondary encoders 4 to 6 of this arm are zero throughout."""
    position = Signal(numbered("rec.act_pos_se_deg[{}]"), "deg")
    with pytest.raises(errors.LogDataError, match=r"rec\.act_pos_se_deg\[4\]"):
        read_log(shared_data / "kuka_kr300" / "recorded_FF_A.mat", Channels(position, ARM.torque, ARM.time))


def test_no_check_fires_on_a_part_of_a_measured_log(shared_data: Path) -> None:
    channels = Channels(Signal(numbered("qm{}"), "rad", "motor"), Signal(numbered("taum{}"), "N m", "motor"), time="t")
    path = shared_data / "staubli_tx40" / "tx40_log.parquet"
    for start in range(7):
        assert read_log(path, channels, time_range=(start, start + 1)).t.size == 5001
