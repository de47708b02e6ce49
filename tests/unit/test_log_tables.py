"""Dialects of text, list columns, timetables, TDMS, data sets, arrays: what labs bring besides plain tables."""

from __future__ import annotations

import sys
import tomllib
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import h5py
import nptdms
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy import io

import recorders
from haptid import errors
from haptid.log import Channels, Signal, read_log
from haptid.log.file_format import format_of
from haptid.log.request import Request
from haptid.log.survey import survey

N = 120
T = np.arange(N) * 0.01
DATA = np.column_stack([T, np.sin(2 * T), np.cos(3 * T)])


def read(path: Path, wanted: list[str], **more: Any) -> tuple[dict[str, np.ndarray], list[str]]:
    request = Request(**more)
    return format_of(path).columns(path, wanted, request), request.notes


def rows(separator: str, decimal: str = ".", end: str = "\n") -> str:
    return end.join(separator.join(f"{v:.6f}".replace(".", decimal) for v in row) for row in DATA) + end


DIALECTS = {
    "blanks": ("t q1 tau1\n", rows(" "), "blanks"),
    "runs of blanks": ("   t    q1  tau1\n", "  " + rows("   "), "blanks"),
    "blanks, decimal comma": ("t q1 tau1\n", rows(" ", ","), "decimal commas"),
    "semicolons, decimal comma": ("t;q1;tau1\n", rows(";", ","), "semicolons"),
    "tabs, decimal comma": ("t\tq1\ttau1\n", rows("\t", ","), "tabs"),
    "commas and blanks": ("t, q1, tau1\n", rows(", "), ""),
    "Windows, byte order mark": ("\ufefft q1 tau1\r\n", rows(" ", end="\r\n"), "blanks"),
    "units below": ("t,q1,tau1\ns,deg,mN m\n", rows(","), "units"),
    "units below, in brackets": ("t;q1;tau1\n[s];[deg];[Nm]\n", rows(";"), "units"),
    "lines before": ("Robot: R2 D2\nDate;2026-11-22\n\nt,q1,tau1\n", rows(","), "2 lines before"),
    "settings before": (
        "Started,12:00:01,1\nInterval,0.01,0.01\nt,q1,tau1\n",
        rows(","),
        "2 lines before",
    ),
    "comments": ("# made by hand\n% 1, 2\nt,q1,tau1\n", rows(","), ""),
    "header in a comment": ("# t,q1,tau1\n", rows(","), ""),
}


@pytest.mark.parametrize("name", DIALECTS)
def test_dialects_are_sniffed_and_said(tmp_path: Path, name: str) -> None:
    head, body, said = DIALECTS[name]
    path = tmp_path / "log.csv"
    path.write_bytes((head + body).encode())
    found, notes = read(path, ["t", "q1", "tau1"])
    np.testing.assert_allclose(np.column_stack([*found.values()]), DATA, rtol=0, atol=6e-7)
    assert list(found) == ["t", "q1", "tau1"]
    assert said in "; ".join(notes)
    assert bool(notes) == bool(said)


def test_columns_without_a_header_or_counted_from_0(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text(rows(" "))
    found, notes = read(path, ["column[1]", "column[3]"])
    np.testing.assert_allclose(found["column[3]"], DATA[:, 2], atol=6e-7)
    assert "no header" in notes[0]
    path.write_text("0,1,2\n" + rows(","))
    found, notes = read(path, ["0", "2"])
    np.testing.assert_allclose(found["2"], DATA[:, 2], atol=6e-7)
    assert "from 0" in notes[0]


@pytest.mark.parametrize("arrow", [True, False])
def test_dates_and_times_of_day_are_seconds_since_the_first(
    tmp_path: Path, arrow: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not arrow:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    start = datetime(2026, 12, 31, 23, 59, 59, 250_000, timezone(timedelta(hours=5, minutes=30)))
    times = [start + timedelta(milliseconds=20 * k) for k in range(N)]
    path = tmp_path / "log.csv"
    cells = [f"{x.isoformat(' ')},{x.time().isoformat('microseconds')},{k}" for k, x in enumerate(times)]
    path.write_text("Timestamp,clock,q1\n" + "\n".join(cells) + "\n")
    found, notes = read(path, ["Timestamp", "clock", "q1"])
    np.testing.assert_allclose(found["Timestamp"], 0.02 * np.arange(N), atol=1e-9)
    np.testing.assert_allclose(found["clock"], 0.02 * np.arange(N), atol=1e-9)
    assert "Timestamp holds dates" in notes[0]
    assert 'time = "Timestamp"\ntime_unit = "s"' in survey(path).table
    path.write_text("Timestamp,q1\n" + "\n".join([*(f"{x.isoformat()},1" for x in times), "later,2"]) + "\n")
    with pytest.raises(errors.LogFileError, match="`later`, not a date"):
        read(path, ["Timestamp"])


def test_the_present_value_is_no_electric_current(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,target_angle,current_angle,motor_current\n" + rows(",").replace("\n", ",0.5\n"))
    kinds = {channel.name: channel.quantity for channel in survey(path).topics[0].channels}
    assert kinds == {"t": "time", "target_angle": "position", "current_angle": "position", "motor_current": "torque"}
    assert '"current_angle"' in survey(path).table


def test_columns_of_one_name_are_numbered(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,tau,tau\n" + rows(","))
    found, notes = read(path, ["t", "tau (2)"])
    np.testing.assert_allclose(found["tau (2)"], DATA[:, 2], atol=6e-7)
    assert "2 columns are named tau" in notes[0]
    with pytest.raises(errors.LogFileError, match="two columns are named 'tau'"):
        read(path, ["t", "tau"])


def test_a_header_with_units_is_not_taken_in_others(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,q1,tau1\ns,deg,N m\n" + rows(","))
    with pytest.raises(errors.LogChannelError, match="the file states deg") as raised:
        read_log(path)
    assert raised.value.where == "q1"
    path.write_text("t [s],q1 [deg],tau1 [N m]\n" + rows(","))
    assert format_of(path).units(path) == {"t [s]": "s", "q1 [deg]": "deg", "tau1 [N m]": "N m"}
    log = read_log(path, Channels(Signal("q1 [deg]", "deg"), Signal("tau1 [N m]", "N m"), time="t [s]"))
    np.testing.assert_allclose(log.position[:, 0], np.deg2rad(DATA[:, 1]), atol=2e-8)


def test_ur_rtde(tmp_path: Path) -> None:
    """The recorder of UR RTDE writes blanks, joints counted from 0, and seconds since the robot was started."""
    names = ["timestamp", *(f"{a}_{k}" for a in ("actual_q", "actual_current") for k in range(2)), "robot_mode"]
    path = tmp_path / "robot_data.csv"
    lines = [" ".join(names)]
    for k in range(N):
        lines.append(f"{4711.002 + 0.002 * k:.3f} {np.sin(k / 9)} {np.cos(k / 7)} {np.cos(k / 9)} {np.sin(k / 8)} 7")
    path.write_text("\n".join(lines) + "\n")
    q, i = (tuple(f"{a}_{k}" for k in range(2)) for a in ("actual_q", "actual_current"))
    log = read_log(path, Channels(Signal(q, "rad"), Signal(i, "A"), time="timestamp"))
    np.testing.assert_allclose(log.position[:, 1], np.cos(np.arange(N) / 7))
    assert log.rate_hz == pytest.approx(500)


def test_parquet_lists_structs_and_stamps(tmp_path: Path) -> None:
    flat = pa.array(DATA[:, 1:].ravel())
    table = pa.table(
        {
            "fixed": pa.FixedSizeListArray.from_arrays(flat, 2),
            "free": pa.array(DATA[:, 1:].tolist()),
            "ragged": pa.array([row[: 1 + (k != 7)] for k, row in enumerate(DATA[:, 1:].tolist())]),
            "arm": pa.StructArray.from_arrays([pa.array(DATA[:, 1]), pa.array(DATA[:, 1:].tolist())], ["q", "all"]),
            "when": pa.array((1_700_000_000_000_000 + np.arange(N)), pa.timestamp("us", "UTC")),
        }
    )
    path = tmp_path / "log.parquet"
    parquet.write_table(table, path)
    wanted = ["fixed[2]", "free[1]", "ragged[2]", "arm.q", "arm.all[2]", "when"]
    assert set(wanted) <= set(format_of(path).names(path))
    found, _ = read(path, wanted)
    for name, column in (("fixed[2]", 2), ("free[1]", 1), ("arm.q", 1), ("arm.all[2]", 2)):
        np.testing.assert_array_equal(found[name], DATA[:, column])
    assert np.flatnonzero(np.isnan(found["ragged[2]"])).tolist() == [7]
    np.testing.assert_array_equal(found["when"], 1000 * (1_700_000_000_000_000 + np.arange(N)))
    some = format_of(path).rows(path, wanted, 10, 20)
    np.testing.assert_array_equal(some[0], DATA[10:20, 2])


@pytest.mark.parametrize("version", [2, 3])
def test_lerobot_data_sets(tmp_path: Path, version: int) -> None:
    """Episodes are segments; elements have the names of the description; the stored times begin again each time."""
    names = ["shoulder.pos", "elbow.pos"]
    rng = np.random.default_rng(version)
    episodes = [{"observation.state": np.cumsum(rng.normal(size=(n, 2)), 0).astype(np.float32)} for n in (80, 90, 70)]
    for episode in episodes:
        episode["action"] = episode["observation.state"][:, ::-1] ** 2
    features = {"observation.state": names, "action": names}
    folder = recorders.lerobot(tmp_path / "set", episodes, features, 50.0, version)
    mapping = Channels(
        Signal(tuple(f"observation.state[{n}]" for n in names), "deg"),
        Signal(("action[elbow.pos]", "action[2]")[:1], "A"),
        time="time",
    )
    log = read_log(folder, mapping, episodes=[0, 2])
    assert log.segments == ((0, 80), (80, 150))
    assert log.rate_hz == pytest.approx(50)
    want = np.concatenate([episodes[0]["observation.state"], episodes[2]["observation.state"]])
    np.testing.assert_allclose(log.position, np.deg2rad(want.astype(float)))
    np.testing.assert_array_equal(log.torque[:80, 0], episodes[0]["action"][:, 1])
    whole = read_log(folder, mapping)
    assert len(whole.segments) == 3
    assert whole.sha256 == log.sha256
    with pytest.raises(errors.LogFileError, match="no episode 7"):
        read_log(folder, mapping, episodes=[7])


def test_tdms(tmp_path: Path) -> None:
    path = tmp_path / "run.tdms"
    about = {"wf_increment": 0.001, "wf_start_time": np.datetime64("2026-01-01T00:00:00.25"), "unit_string": "deg"}
    with nptdms.TdmsWriter(path) as writer:
        for part in np.array_split(DATA, 4):
            writer.write_segment([nptdms.ChannelObject("arm", f"c{k}", part[:, k], properties=about) for k in range(3)])
    found, notes = read(path, ["arm.c1", "arm.c2", "arm.c1@time"])
    np.testing.assert_array_equal(found["arm.c2"], DATA[:, 2])
    start = np.datetime64("2026-01-01T00:00:00.25", "ns").astype(np.int64)
    np.testing.assert_array_equal(found["arm.c1@time"] - start, np.arange(N) * 1_000_000)
    assert notes == []
    assert format_of(path).units(path)["arm.c1"] == "deg"
    raw = path.read_bytes()
    path.write_bytes(raw[:-300])
    found, notes = read(path, ["arm.c1", "arm.c2"])
    count = found["arm.c1"].size
    assert 0.5 * N < count < N
    np.testing.assert_array_equal(found["arm.c1"], DATA[:count, 1])
    assert "not closed" in notes[0]


def test_a_folder_of_tables_is_one_log(tmp_path: Path) -> None:
    """A file for each signal, with and without a header, and a file of one column; a note beside them."""
    np.savetxt(tmp_path / "position.csv", np.column_stack([DATA[:, 1], DATA[:, 2]]), delimiter=",")
    np.savetxt(tmp_path / "drive.csv", np.column_stack([DATA[:, 2], T]), delimiter=",", header="tau,heat", comments="")
    np.save(tmp_path / "t.npy", T)
    (tmp_path / "read me.txt").write_text("Recorded by hand.\n")
    wanted = {"position[1]": DATA[:, 1], "position[2]": DATA[:, 2], "drive.tau": DATA[:, 2], "t": T}
    assert set(wanted) < set(format_of(tmp_path).names(tmp_path))
    found, _ = read(tmp_path, list(wanted))
    for name, samples in wanted.items():
        np.testing.assert_allclose(found[name], samples)
    log = read_log(tmp_path, Channels(Signal("position[1]", "rad"), Signal("drive.tau", "N m"), time="t"))
    assert log.t.size == N
    assert len(log.sha256) == 64
    table = tomllib.loads(survey(tmp_path).table)["channels"]
    assert (table["time"], table["torque"]["channels"]) == ("t", ["drive.tau"])


def test_labelled_lines_above_the_samples_are_no_samples(tmp_path: Path) -> None:
    """Each signal with its times, and lines of settings that hold as many numbers as texts."""
    ahead = "Start,12:00,Start,12:00\nInterval,0.01,Interval,0.01\nChannel,q,Channel,tau\nUnit,deg,Unit,V\n"
    rows = "".join(f"{t},{q},{t},{tau}\n" for t, q, tau in DATA)
    (tmp_path / "log.csv").write_text(ahead + rows)
    assert format_of(tmp_path / "log.csv").names(tmp_path / "log.csv") == ["Channel (1)", "q", "Channel (2)", "tau"]
    found, _ = read(tmp_path / "log.csv", ["q", "tau"])
    np.testing.assert_allclose(found["tau"], DATA[:, 2])


def test_cells_of_a_matlab_file_are_numbered(tmp_path: Path) -> None:
    cells = np.empty((1, 2), dtype=object)
    cells[0, :] = [{"q": DATA[:, 1]}, DATA]
    io.savemat(tmp_path / "run.mat", {"trial": cells})
    found, _ = read(tmp_path / "run.mat", ["trial[1].q", "trial[2][3]"])
    np.testing.assert_array_equal(np.ravel(found["trial[1].q"]), DATA[:, 1])
    np.testing.assert_array_equal(found["trial[2][3]"], DATA[:, 2])


@pytest.mark.parametrize("array", [False, True], ids=["one signal", "several"])
def test_structure_with_time_of_simulink(tmp_path: Path, array: bool) -> None:
    """`out.signals` is one struct, or an array of them, called by its label; its path remains readable."""
    one = {"values": DATA[:, 1:], "dimensions": 2.0, "label": "q"}
    kinds = [("values", object), ("dimensions", object), ("label", object)]
    several = np.array([(DATA[:, k : k + 1], 1.0, f"q{k}") for k in (1, 2)], dtype=kinds).reshape(1, 2)
    made = {"time": DATA[:, :1], "signals": several if array else one, "blockName": "arm/out"}
    path = tmp_path / "out.mat"
    io.savemat(path, {"out": made})
    names = [f"out.signals[{k}].values" if array else f"out.signals.values[{k}]" for k in (1, 2)]
    labelled = ["out.signals.q1", "out.signals.q2"] if array else ["out.signals.q[1]", "out.signals.q[2]"]
    assert format_of(path).names(path) == ["out.time", *labelled]
    found, _ = read(path, labelled)
    np.testing.assert_array_equal(np.ravel(found[labelled[1]]), DATA[:, 2])
    log = read_log(path, Channels(Signal((names[0],), "rad"), Signal((names[1],), "N m"), time="out.time"))
    assert log.rate_hz == pytest.approx(1 / (DATA[1, 0] - DATA[0, 0]))


def test_single_arrays_and_the_mapping_of_mujoco(tmp_path: Path) -> None:
    from mujoco.sysid._src import timeseries

    np.save(tmp_path / "log.npy", DATA)
    found, _ = read(tmp_path / "log.npy", ["data[1]", "data[3]"])
    np.testing.assert_array_equal(found["data[3]"], DATA[:, 2])
    records = np.rec.fromarrays(DATA.T, names="t,q,tau")
    np.save(tmp_path / "records.npy", records)
    found, _ = read(tmp_path / "records.npy", ["t", "tau"])
    np.testing.assert_array_equal(found["tau"], DATA[:, 2])
    sensor = timeseries.SignalType.MjSensor
    series = timeseries.TimeSeries(T, DATA, {"pos": (sensor, np.array([1])), "both": (sensor, np.array([2, 0]))})
    series.save_to_disk(tmp_path / "series.npz")
    found, _ = read(tmp_path / "series.npz", ["times", "data[pos]", "data[both.1]"])
    np.testing.assert_array_equal(found["data[pos]"], DATA[:, 1])
    np.testing.assert_array_equal(found["data[both.1]"], DATA[:, 2])


def made(folder: Path, kind: str) -> tuple[Path, list[str]]:
    """A small file of each kind, and channels of it."""
    folder.mkdir()
    path = folder / f"log.{kind}"
    if kind == "tdms":
        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment(
                [nptdms.ChannelObject("g", "a", DATA[:, 1]), nptdms.ChannelObject("g", "b", DATA[:, 2])]
            )
        return path, ["g.a", "g.b"]
    if kind == "npy":
        np.save(path, DATA)
        return path, ["data[1]"]
    if kind == "csv":
        path.write_text("t q1;tau1\n" + rows(" "))
        return path, ["column[1]", "t"]
    if kind == "parquet":
        parquet.write_table(pa.table({"a": pa.array(DATA.tolist()), "b": T}), path)
        return path, ["a[1]", "b"]
    path = recorders.lerobot(folder / "set", [{"q": DATA}], {"q": ["a", "b", "c"]}, 50.0)
    return path, ["time", "q[a]"]


@pytest.mark.parametrize("kind", ["tdms", "npy", "csv", "parquet", "lerobot"])
def test_mutated_tables_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    path, wanted = made(tmp_path / "files", kind)
    target = path / "meta" / "info.json" if kind == "lerobot" else path
    raw, rng = target.read_bytes(), np.random.default_rng(6)
    for _ in range(100):
        changed = bytearray(raw)
        for at in rng.integers(0, len(raw), rng.integers(1, 6)):
            changed[at] = rng.integers(256)
        target.write_bytes(changed[: rng.integers(1, len(raw)) if rng.random() < 0.3 else len(raw)])
        try:
            format_of(path).names(path)
            format_of(path).columns(path, wanted, Request())
        except errors.LogError:
            continue


def _joined(path: Path, named: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """A table of two topics by an outer join: positions at 100 Hz, and torques at 250 Hz on rows of their own."""
    t, own = np.arange(0.0, 4, 0.01) + 1.7e9, np.arange(0.0013, 4, 0.004) + 1.7e9
    lines = [(at, f"{at:.6f},{at - 1e-4:.6f},{np.sin(at - 1.7e9):.9f},{12 + np.cos(at - 1.7e9):.9f},,") for at in t]
    lines += [(at, f"{at:.6f},,,,{np.cos(at - 1.7e9):.9f},{np.sin(2 * (at - 1.7e9)):.9f}") for at in own]
    head = "__time,/joint_states/header/stamp,/joint_states/elbow/position,/joint_states/wrist/position"
    head += ",/motors/elbow/torque,/motors/wrist/torque" if named else ",/motors/torque[0],/motors/torque[1]"
    path.write_text("\n".join([head, *(line for _, line in sorted(lines))]) + "\n")
    return t - 1.7e9, own - 1.7e9


@pytest.mark.parametrize("named", [True, False])
def test_topics_that_were_joined_in_one_table_are_merged_by_time(tmp_path: Path, named: bool) -> None:
    path = tmp_path / "joined.csv"
    _joined(path, named)
    found = survey(path)
    table = tomllib.loads(found.table)["channels"]
    assert table["time"] == "__time"  # and not the stamp, which the torques have not
    assert table["position"]["channels"] == ["/joint_states/elbow/position", "/joint_states/wrist/position"]
    assert table["position"]["unit"] == "rad"  # ROS prescribes it; 12 rad is an offset
    assert table["merge"] == {"method": "linear"}
    torque = table["torque"]
    names = torque.get("channels") or [f"{torque['field']}[{k}]" for k in torque["joints"]]
    channels = Channels(Signal(tuple(table["position"]["channels"]), "rad"), Signal(tuple(names), "N m"), "__time")
    log = read_log(path, channels)
    at = log.t
    np.testing.assert_allclose(log.position[:, 0], np.sin(at + 0.01), atol=1e-4)  # the first row is before all torques
    np.testing.assert_allclose(log.torque[:, 0], np.cos(at + 0.01), atol=1e-4)
    np.testing.assert_allclose(log.torque[:, 1], np.sin(2 * (at + 0.01)), atol=1e-4)
    assert any("merged by time (linear): 1000 samples on 400 rows" in note for note in log.notes)


def test_drives_that_answer_in_rows_of_their_own_are_merged(tmp_path: Path) -> None:
    """A bus recorder writes one row for each answer of each drive."""
    path, t = tmp_path / "bus.csv", np.arange(0.0, 4, 0.002)
    lines = ["t,q1,tau1,q2,tau2"]
    for k, at in enumerate(t):
        own = f"{np.sin(at):.9f},{np.cos(at):.9f}"
        lines.append(f"{at:.6f}," + (f"{own},," if k % 2 else f",,{own}"))
    path.write_text("\n".join(lines) + "\n")
    channels = Channels(Signal(("q1", "q2"), "rad"), Signal(("tau1", "tau2"), "N m"), "t")
    log = read_log(path, channels)
    for column in (log.position, log.torque):
        np.testing.assert_allclose(column[:, 0], column[:, 1], atol=1e-5)  # without merging they differ by 2e-3


def test_a_missing_cell_among_its_neighbours_stays_an_error(tmp_path: Path) -> None:
    path, values = tmp_path / "hole.csv", DATA.astype(object)
    values[60, 1] = ""
    path.write_text("t,q1,tau1\n" + "\n".join(",".join(map(str, row)) for row in values) + "\n")
    with pytest.raises(errors.LogDataError, match="q1"):
        read_log(path, Channels(Signal(("q1",), "rad"), Signal(("tau1",), "N m"), "t"))


@pytest.mark.parametrize(
    "info", ["[1]", "3", "{}", '{"fps": null}', '{"fps": [30]}', '{"fps": 30, "features": [1]}', '{"fps": 1e9}']
)
def test_descriptions_of_another_structure_are_one_error(tmp_path: Path, info: str) -> None:
    """A TypeError over the content of a file, raised where haptid reads it, was taken for a mistake of haptid's."""
    path, _ = made(tmp_path / "files", "lerobot")
    (path / "meta" / "info.json").write_text(info)
    with pytest.raises(errors.LogFileError, match="LeRobot content cannot be read"):
        format_of(path).names(path)


@pytest.mark.parametrize("signal", ["3", "null", "[]", "[1, 3]", '["pos", [null]]', '["pos", [[0]]]', "{}"])
def test_mappings_of_mujoco_of_another_structure_are_one_error(tmp_path: Path, signal: str) -> None:
    path = tmp_path / "series.npz"
    np.savez(path, times=T, data=DATA, signal_mapping=np.array(f'{{"pos": {signal}}}'))
    with pytest.raises(errors.LogFileError, match="signal_mapping has no columns for 'pos'"):
        format_of(path).names(path)


def test_classes_of_matlab_may_be_text_or_something_else(tmp_path: Path) -> None:
    """Only MATLAB itself writes them as bytes."""
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        for name, kind in (("q", "double"), ("label", "char"), ("tau", 3.5)):
            file[name] = T
            file[name].attrs["MATLAB_class"] = kind
    assert format_of(path).names(path) == ["q", "tau"]
