"""Files of several groups: units of datasets, records, and groups with times of their own."""

from __future__ import annotations

import tomllib
from pathlib import Path

import h5py
import nptdms
import numpy as np
import pytest

import haptid
import small_study
from haptid import errors
from haptid.log.survey import survey
from haptid.study.draft import draft_study

T = 0.002 * np.arange(2000)
Q = np.column_stack([np.sin(w * T) for w in (1.1, 2.3)])
TAU = np.column_stack([np.cos(w * T) for w in (1.7, 2.1)])
LATE = T[::4] + 7e-4
HELD = np.column_stack([np.cos(w * LATE) for w in (1.7, 2.1)])


def test_units_of_datasets_are_those_of_their_attributes(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"] = T
        for k, name in enumerate(("shoulder", "elbow")):
            position = file.create_dataset(f"joints/{name}/position", data=np.rad2deg(Q[:, k]))
            torque = file.create_dataset(f"joints/{name}/torque", data=1e3 * TAU[:, k])
            position.attrs["unit"], torque.attrs["units"] = np.bytes_(b"deg"), "mNm"
    table = tomllib.loads(survey(tmp_path / "run.h5").table)["channels"]
    assert (table["position"]["unit"], table["torque"]["unit"]) == ("deg", "mN m")


def test_fields_of_records_are_channels(tmp_path: Path) -> None:
    records = np.zeros(T.size, [("t", "f8"), ("q", "f8", (2,)), ("tau", "f8", (2,)), ("note", "S4")])
    for name, values in (("t", T), ("q", Q), ("tau", TAU)):
        records[name] = values
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["log"] = records
    table = tomllib.loads(survey(tmp_path / "run.h5").table)["channels"]
    assert table["time"] == "log.t"
    assert table["position"]["field"] == "log.q"
    signals = haptid.Signal(("log.q[1]", "log.q[2]"), "rad"), haptid.Signal(("log.tau[1]", "log.tau[2]"), "N m")
    log = haptid.read_log(tmp_path / "run.h5", haptid.Channels(*signals, time="log.t"))
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.torque, TAU)


def grouped(path: Path, times: bool = True) -> Path:
    """Positions at 500 Hz and torques at 125 Hz, 0.7 ms later, each in a group of its own."""
    if path.suffix == ".tdms":
        with nptdms.TdmsWriter(path) as file:
            own = [nptdms.ChannelObject("encoder", f"q{k + 1}", Q[:, k]) for k in range(2)]
            own += [nptdms.ChannelObject("drive", f"tau{k + 1}", HELD[:, k]) for k in range(2)]
            own += [nptdms.ChannelObject("encoder", "t", T)]
            own += [nptdms.ChannelObject("drive", "t", LATE)] if times else []
            file.write_segment(own)
        return path
    with h5py.File(path, "w") as file:
        for group, array, stamps in (("encoder", Q, T), ("drive", HELD, LATE)):
            for k in range(2):
                file[f"{group}/{'q' if group == 'encoder' else 'tau'}{k + 1}"] = array[:, k]
            if times or group == "encoder":
                file[f"{group}/t"] = stamps
    return path


@pytest.mark.parametrize("suffix", [".h5", ".tdms"])
def test_groups_with_times_of_their_own_are_merged_by_these(tmp_path: Path, suffix: str) -> None:
    path = grouped(tmp_path / f"run{suffix}")
    (tmp_path / "device.toml").write_text(small_study.DEVICE)
    device = haptid.read_device(tmp_path / "device.toml")
    text, _ = draft_study([path], device, str(tmp_path / "device.toml"), tmp_path)
    table = tomllib.loads(text)["channels"]
    signals = (haptid.Signal(tuple(table[key]["channels"]), table[key]["unit"]) for key in ("position", "torque"))
    log = haptid.read_log(path, haptid.Channels(*signals, time=table["time"]))
    kept = (LATE[0] <= T) & (LATE[-1] >= T)
    np.testing.assert_allclose(log.position, Q[kept], atol=1e-12)
    wanted = np.column_stack([np.interp(T[kept], LATE, own) for own in HELD.T])
    np.testing.assert_allclose(log.torque, wanted, atol=1e-6)  # times are whole nanoseconds
    assert any("merged by time (linear): 500 samples on 2000 rows" in note for note in log.notes)


def test_groups_without_times_of_their_own_are_refused_by_how_much(tmp_path: Path) -> None:
    path = grouped(tmp_path / "run.h5", times=False)
    assert "1500 fewer: without times of their own" in survey(path).unequal
    signals = haptid.Signal(("encoder.q1", "encoder.q2"), "rad"), haptid.Signal(("drive.tau1", "drive.tau2"), "N m")
    with pytest.raises(errors.LogDataError, match="1500 fewer"):
        haptid.read_log(path, haptid.Channels(*signals, time="encoder.t"))


def two_groups(path: Path, own: np.ndarray, tau: np.ndarray, name: str = "time", **attributes: str) -> Path:
    """Positions and torques in groups of their own, each with times."""
    with h5py.File(path, "w") as file:
        file["enc/time"] = T
        stamps = file.create_dataset(f"drv/{name}", data=own)
        stamps.attrs.update(attributes)
        for k in range(2):
            file[f"enc/q{k + 1}"], file[f"drv/tau{k + 1}"] = Q[:, k], tau[:, k]
    return path


def read_groups(path: Path) -> haptid.Log:
    signals = haptid.Signal(("enc.q1", "enc.q2"), "rad"), haptid.Signal(("drv.tau1", "drv.tau2"), "N m")
    return haptid.read_log(path, haptid.Channels(*signals, time="enc.time"))


def torques_at(t: np.ndarray) -> np.ndarray:
    return np.column_stack([np.cos(w * t) for w in (1.7, 2.1)])


@pytest.mark.parametrize(("name", "attributes"), [("time_ms", {}), ("time", {"units": "ms"})])
def test_times_of_a_group_have_the_unit_that_is_stated_of_them(tmp_path: Path, name: str, attributes: dict) -> None:
    log = read_groups(two_groups(tmp_path / "run.h5", 1e3 * LATE, HELD, name, **attributes))
    np.testing.assert_allclose(log.torque, torques_at(log.t + T[1]), atol=1e-4)
    assert any(f"by drv.{name} in ms" in note for note in log.notes)


def test_times_in_a_unit_that_is_not_stated_are_refused(tmp_path: Path) -> None:
    with pytest.raises(errors.LogTimeError, match=r"run from 0\.7 to 3992\.7 s .* last 3\.998 s: the clocks have"):
        read_groups(two_groups(tmp_path / "run.h5", 1e3 * LATE, HELD))
    slow = np.arange(0.0, 4.0, 0.05)[: T.size]
    assert read_groups(two_groups(tmp_path / "slow.h5", slow, torques_at(slow))).torque.shape[0] > 1900
    slower = np.arange(0.0, 24.0, 0.3)
    with pytest.raises(errors.LogTimeError, match=r"are 0\.3 s apart, .* 0\.002 s \(limit 0\.1 s\)"):
        read_groups(two_groups(tmp_path / "slower.h5", slower, torques_at(slower)))


def test_groups_of_equal_rows_and_other_times_are_merged_by_these(tmp_path: Path) -> None:
    late = T + 0.05
    log = read_groups(two_groups(tmp_path / "run.h5", late, torques_at(late)))
    np.testing.assert_allclose(log.torque, torques_at(log.t + 0.05), atol=1e-5)
    assert log.t.size == T.size - 25
    with pytest.raises(errors.LogTimeError, match=r"'drv\.time', which are not those of 'enc\.time'"):
        haptid.open_log(tmp_path / "run.h5", log.channels)
    same = read_groups(two_groups(tmp_path / "same.h5", 1e3 * (T + 1e-7), TAU, "time_ms"))
    np.testing.assert_array_equal(same.torque, TAU)
    assert not any("merged" in note for note in same.notes)
    with pytest.raises(errors.LogTimeError, match="the clocks have no time in common"):
        read_groups(two_groups(tmp_path / "epoch.h5", T + 1.7e9, TAU))


def test_times_of_a_group_are_checked_as_those_of_the_positions(tmp_path: Path) -> None:
    back = T.copy()
    back[500:] -= 0.9
    missing = T + 0.001
    missing[700] = np.nan
    huge = T + 0.001
    huge[700] = 1e300
    counts = np.arange(T.size, dtype=np.uint64)
    counts[900] = np.uint64(2**64 - 5)
    for own, found, kind in (
        (back, "time decreases at sample 500 of 'drv.time'", errors.LogTimeError),
        (missing, "drv.time", errors.LogDataError),
        (huge, "drv.time", errors.LogDataError),
        (counts, "time decreases at sample 900 of 'drv.time'", errors.LogTimeError),
        (np.zeros(T.size), "1999 of 2000 stamps in 'drv.time'", errors.LogTimeError),
    ):
        with pytest.raises(kind, match=found):
            read_groups(two_groups(tmp_path / "run.h5", own, TAU))


def test_whole_times_are_subtracted_without_rounding(tmp_path: Path) -> None:
    first = 2**63 + 10**9  # as uint64, of nanoseconds
    begin = np.rint(1e9 * T).astype(np.uint64) + np.uint64(first)
    late = np.rint(1e9 * LATE).astype(np.uint64) + np.uint64(first)
    with h5py.File(two_groups(tmp_path / "run.h5", late, HELD, "time_ns"), "r+") as file:
        del file["enc/time"]
        file["enc/time_ns"] = begin
    signals = haptid.Signal(("enc.q1", "enc.q2"), "rad"), haptid.Signal(("drv.tau1", "drv.tau2"), "N m")
    log = haptid.read_log(tmp_path / "run.h5", haptid.Channels(*signals, time="enc.time_ns", time_unit="ns"))
    np.testing.assert_allclose(log.torque, torques_at(log.t + T[1]), atol=1e-4)


def test_an_attribute_of_records_is_no_unit_of_their_fields(tmp_path: Path) -> None:
    """`deg` of a data set with times, positions and torques made its torques positions."""
    records = np.zeros(T.size, [("t", "f8"), ("q", "f8", (2,)), ("tau", "f8", (2,))])
    for name, values in (("t", T), ("q", Q), ("tau", TAU)):
        records[name] = values
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("rec", data=records).attrs["unit"] = "deg"
    quantities = {c.name: c.quantity for c in survey(tmp_path / "run.h5").topics[0].channels}
    assert quantities["rec.tau[1]"] == "torque"
    assert quantities["rec.t"] == "time"
    table = tomllib.loads(survey(tmp_path / "run.h5").table)["channels"]
    assert (table["position"]["unit"], table["torque"]["field"]) == ("rad", "rec.tau")


def test_the_rate_of_a_survey_is_that_of_the_positions(tmp_path: Path) -> None:
    """`drv` stands before `enc`, and its 333 Hz stood beside the rows of the positions."""
    slow = 0.003 * np.arange(1333)
    assert survey(two_groups(tmp_path / "run.h5", slow, torques_at(slow))).topics[0].rate_hz == pytest.approx(500.0)


def test_whole_seconds_and_their_fraction_are_times_of_a_group(tmp_path: Path) -> None:
    """Of the group alone: the positions have one channel of times."""
    late = T + 5e-4
    with h5py.File(two_groups(tmp_path / "run.h5", np.floor(late).astype(int), torques_at(late), "sec"), "r+") as file:
        file["drv/nsec"] = np.rint(late % 1 * 1e9).astype(int)
        file["drv/ticks"] = np.rint(1e3 * Q[:, 0]).astype(int)  # of an encoder
    log = read_groups(tmp_path / "run.h5")
    assert log.t.size == T.size - 1
    np.testing.assert_allclose(log.torque, torques_at(log.t + T[1]), atol=1e-4)
