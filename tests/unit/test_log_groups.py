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
