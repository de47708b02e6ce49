"""Objects and arrays of MATLAB and Simulink."""

from __future__ import annotations

import tomllib
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy import io

from haptid import errors
from haptid.log import Channels, Signal, read_log
from haptid.log.file_format import format_of
from haptid.log.formats.mat_objects import leaves
from haptid.log.survey import survey
from haptid.log.survey.draft import channels_table

N = 120
T = np.arange(N) * 0.01
DATA = np.column_stack([T, np.sin(2 * T), np.cos(3 * T)])


def read(path: Path, wanted: list[str]) -> dict[str, np.ndarray]:
    return format_of(path).columns(path, wanted)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
@pytest.mark.filterwarnings("ignore")
def test_tables_and_timetables_of_matlab(tmp_path: Path, version: str) -> None:
    import matio
    import pandas as pd

    stamps = pd.TimedeltaIndex((np.arange(N) * 500).astype("m8[us]"), name="Time")
    timed = pd.DataFrame({"q1": DATA[:, 1], "tau1": DATA[:, 2]}, index=stamps)
    plain = pd.DataFrame({"t": DATA[:, 0], "q1": DATA[:, 1]})
    path = tmp_path / "run.mat"
    matio.save_to_mat(str(path), {"run": timed, "other": plain, "array": DATA}, version=version)
    found = read(path, ["run.Time", "run.q1", "run.tau1", "other.t", "array[2]"])
    np.testing.assert_array_equal(found["run.Time"], np.arange(N) * 500_000)
    np.testing.assert_array_equal(found["run.tau1"], DATA[:, 2])
    np.testing.assert_array_equal(found["other.t"], DATA[:, 0])
    np.testing.assert_array_equal(np.ravel(found["array[2]"]), DATA[:, 1])
    log = read_log(path, Channels(Signal("run.q1", "rad"), Signal("run.tau1", "N m"), time="run.Time", time_unit="ns"))
    assert log.rate_hz == pytest.approx(2000)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
@pytest.mark.filterwarnings("ignore")
def test_objects_of_matlab_with_arrays_in_their_properties(tmp_path: Path, version: str) -> None:
    """As of a timeseries, whose times and units are in an object of their own."""
    import matio
    from matio.utils.matclass import MatlabOpaque

    about = MatlabOpaque({"Units": "seconds", "Start": np.zeros((1, 1))}, "tsdata.timemetadata")
    series = MatlabOpaque({"Data": DATA[:, 1:], "Time": DATA[:, :1], "TimeInfo": about}, "timeseries")
    path = tmp_path / "run.mat"
    matio.save_to_mat(str(path), {"arm": series}, version=version)
    found = read(path, ["arm.Time", "arm.Data[1]", "arm.Data[2]"])
    np.testing.assert_array_equal(np.ravel(found["arm.Time"]), DATA[:, 0])
    np.testing.assert_array_equal(found["arm.Data[2]"], DATA[:, 2])


@pytest.mark.parametrize("version", ["v7", "v7.3"])
@pytest.mark.filterwarnings("ignore")
def test_objects_that_are_not_read_are_named_and_the_file_is_not_called_damaged(
    tmp_path: Path, version: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import matio
    from matio.utils.matclass import MatlabOpaque

    path, both = tmp_path / "run.mat", tmp_path / "both.mat"
    text = MatlabOpaque({"Text": np.array(["no number"], dtype=object)}, "lab.Notes")
    matio.save_to_mat(str(path), {"notes": text}, version=version)
    matio.save_to_mat(str(both), {"notes": text, "log": DATA}, version=version)

    def unknown(*_: object, **__: object) -> None:
        raise KeyError("a class of a later release")

    for fails in (False, True):
        if fails:
            monkeypatch.setattr(matio, "load_from_mat", unknown)
        with pytest.raises(errors.LogFileError, match=r"is sound, .*: notes \(lab.Notes\)\.") as raised:
            survey(path)
        assert "save('run.mat'" in str(raised.value)
        assert [name for name in format_of(both).names(both) if "log" in name] == ["log[1]", "log[2]", "log[3]"]
    with pytest.raises(errors.LogChannelError, match="no channel 'tau'"):
        read_log(both, Channels(Signal("log[2]", "rad"), Signal("tau", "N m"), time="log[1]"))


@pytest.mark.parametrize("name", ["run.mat", "run.npz"])
def test_arrays_with_sides_of_one_element(tmp_path: Path, name: str) -> None:
    """As Simulink saves a signal that is a column."""
    path = tmp_path / name
    (np.savez if name.endswith("npz") else lambda file, **arrays: io.savemat(file, arrays))(
        path, t=DATA[:, :1], q=DATA[:, None, 1:], tau=DATA.T[1:, None, :]
    )
    found = read(path, ["t", "q[1]", "q[2]", "tau[2]"])
    np.testing.assert_array_equal(found["q[2]"], DATA[:, 2])
    np.testing.assert_array_equal(found["tau[2]"], DATA[:, 2])


@pytest.mark.filterwarnings("ignore")  # of the package, where it is imported here first
def test_signals_of_a_simulink_run_are_named_by_themselves() -> None:
    """A data set of two timeseries: one with its times, one with a start and a step, samples along the last axis.

    The objects are given as they are loaded: the writer of the package stores none in a cell.
    """
    from matio.utils.matclass import MatlabOpaque as Object

    def one(value: float) -> np.ndarray:
        return np.full((1, 1), value)

    about = Object({"Time_": np.empty((0, 0)), "Start_": one(0), "Increment_": one(0.01), "Length": one(N)}, "tsdata.t")
    stored = Object({"Data": DATA[:, 1].reshape(1, 1, N)}, "tsdata.StreamingStorage")
    streamed = Object({"Data_": np.empty((0, 0)), "TimeInfo": about, "Storage_": stored}, "timeseries")
    plain = Object({"Data_": DATA[:, 2:], "Time_": DATA[:, :1]}, "timeseries")
    kind = "Simulink.SimulationData"
    cells = np.empty((2, 1), dtype=object)
    for k, (name, series) in enumerate((("q1", streamed), ("tau1", plain))):
        cells[k, 0] = Object({"Name": np.array([name]), "Values": series, "PortIndex": one(1)}, f"{kind}.Signal")
    data_set = Object({"Name": np.array(["logsout"]), "Storage_": cells}, f"{kind}.Dataset")
    run = np.array([[(data_set, DATA[:, :1])]], dtype=[("logsout", object), ("tout", object)])
    found = dict(leaves("out", Object({"Data": run, "Metadata": DATA}, "Simulink.SimulationOutput"), 0))
    wanted = {f"out.logsout.{name}.Time": DATA[:, 0] for name in ("q1", "tau1")} | {"out.tout": DATA[:, 0]}
    wanted |= {"out.logsout.q1.Data": DATA[:, 1], "out.logsout.tau1.Data": DATA[:, 2]}
    assert found.keys() == wanted.keys()
    for name, samples in wanted.items():
        np.testing.assert_allclose(np.ravel(found[name]), samples, atol=1e-12)


@pytest.mark.parametrize("count", [300, 44])
def test_samples_taken_again_at_each_pose_are_no_joints(tmp_path: Path, count: int) -> None:
    """The first of each joint's are drafted, and what was measured before what was planned; the samples were joints."""
    rng = np.random.default_rng(0)
    poses = np.array([0.6, 1.1, 1.7])[:, None] * np.sin(np.arange(count) * np.array([[0.7], [0.9], [1.3]]))
    again = poses[:, :, None] + 1e-4 * rng.standard_normal((3, count, 5))
    effort = np.cos(again) + 0.4 * rng.standard_normal(again.shape)  # with outliers of its own
    io.savemat(tmp_path / "run.mat", {"pivot_positions": poses, "current_position": again, "desired_effort": effort})
    channels = tomllib.loads(survey(tmp_path / "run.mat").table)["channels"]
    assert channels["position"]["channels"] == [f"current_position[{k}][1]" for k in (1, 2, 3)]
    assert channels["torque"]["channels"] == [f"desired_effort[{k}][1]" for k in (1, 2, 3)]
    unsigned = np.rint(30_000 + 9_000 * again).astype(np.uint16)  # a sample below the first one is no large number
    io.savemat(tmp_path / "run.mat", {"q": unsigned, "tau": effort})
    channels = tomllib.loads(survey(tmp_path / "run.mat").table)["channels"]
    assert channels["position"]["channels"] == [f"q[{k}][1]" for k in (1, 2, 3)]
    io.savemat(tmp_path / "run.mat", {"q": np.full(again.shape, np.nan), "tau": effort})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "is it connected?" in survey(tmp_path / "run.mat").table
    trials = np.stack([np.sin(np.arange(300)[:, None] * np.array([0.03, 0.05, 0.08]) + k) for k in range(2)])
    io.savemat(tmp_path / "run.mat", {"dof_pos": trials, "torques": np.cos(trials)})  # joints that move as far
    channels = tomllib.loads(survey(tmp_path / "run.mat").table)["channels"]
    assert channels["position"] == {"field": "dof_pos[1]", "joints": [1, 2, 3], "unit": "rad"}


@pytest.mark.parametrize("name", ["run.mat", "run.npz"])
def test_arrays_of_trials(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    trials = np.stack([k * DATA[:, 1:] for k in range(1, 5)])
    arrays = {"angles": trials, "torques": trials.transpose(1, 2, 0) + 1.0, "pose": np.zeros((200, 200, 300))}
    np.savez(path, **arrays) if name.endswith("npz") else io.savemat(path, arrays)
    assert not any(channel.startswith("pose") for channel in format_of(path).names(path))
    found = read(path, ["angles[3][2]", "torques[4][1]"])
    np.testing.assert_array_equal(found["angles[3][2]"], 3 * DATA[:, 2])
    np.testing.assert_array_equal(found["torques[4][1]"], 4 * DATA[:, 1] + 1.0)
    channels = tomllib.loads(survey(path).table)["channels"]
    assert channels["position"]["field"] == "angles[1]"
    assert channels["torque"]["field"] == "torques[1]"
    assert channels["torque"]["joints"] == [1, 2]


@pytest.mark.parametrize(("axis", "names"), [(0, "[1][{}]"), (1, "[{}][1]")])
def test_joints_of_several_robots_are_as_many_as_the_device_s(tmp_path: Path, axis: int, names: str) -> None:
    """Rollouts of a simulation, robots before samples or behind them: two robots were drafted as two joints."""
    q = np.sin(np.arange(300)[:, None] * np.array([0.03, 0.05, 0.08]))
    robots = np.stack([q, 1.1 * q + 0.2], axis=axis)
    np.savez(tmp_path / "run.npz", joint_pos=robots, applied_torque=np.cos(robots))
    legs = [("hip",), ("thigh",), ("calf",)]
    table = channels_table(survey(tmp_path / "run.npz").topics, format_of(tmp_path / "run.npz"), legs, legs, ())
    for key, array in (("position", "joint_pos"), ("torque", "applied_torque")):
        signal = tomllib.loads(f"rate_hz = 100\n{table}")["channels"][key]
        found = signal.get("channels") or [f"{signal['field']}[{joint}]" for joint in signal["joints"]]
        assert found == [array + names.format(k) for k in (1, 2, 3)]


def named(pairs: dict[str, tuple[np.ndarray, str]], key: str, unit: str) -> np.ndarray:
    """An array of structs as dSPACE and Simulink write it, each with a name, samples and a unit."""
    rows = [(name, data[None], text, 1.0) for name, (data, text) in pairs.items()]
    return np.array(rows, dtype=[(key, object), ("Data", object), (unit, object), ("Raster", object)])


def test_arrays_of_structs_that_say_their_names(tmp_path: Path) -> None:
    """Signals of an experiment of dSPACE; the names by numbers stay readable."""
    t, q, tau = DATA.T
    pairs = {'"Plant"/"theta arm"/"Out1"': (q, "rad"), '"Plant"/"Motor torque"': (tau, "Nm"), "Gain": (t, "")}
    path = tmp_path / "run.mat"
    io.savemat(path, {"run": {"X": named({"Time": (t, "s")}, "Name", "Unit"), "Y": named(pairs, "Name", "Unit")}})
    assert format_of(path).names(path) == [
        "run.X.Time [s]", "run.Y.Plant/theta arm [rad]", "run.Y.Plant/Motor torque [Nm]", "run.Y.Gain",
    ]  # fmt: skip
    channels = tomllib.loads(survey(path).table)["channels"]
    assert (channels["time"], channels["time_unit"]) == ("run.X.Time [s]", "s")
    assert channels["position"] == {"channels": ["run.Y.Plant/theta arm [rad]"], "unit": "rad"}
    assert channels["torque"] == {"channels": ["run.Y.Plant/Motor torque [Nm]"], "unit": "N m"}
    found = read(path, [*format_of(path).names(path), "run.Y[2].Data"])
    np.testing.assert_array_equal(found["run.Y.Plant/Motor torque [Nm]"], tau)
    np.testing.assert_array_equal(found["run.Y[2].Data"], tau)


@pytest.mark.parametrize(
    ("fields", "found"),
    [
        ({"name": "run1", "time": 1, "joint1": {"q": 1, "tau": 1}}, ["S.time", "S.joint1.q", "S.joint1.tau"]),
        ({"name": "run1", "data": 1, "joint1": {"q": 1}}, ["S.data", "S.joint1.q"]),
        ({"name": "run1", "data": 1, "time": 1}, ["S.data", "S.time"]),
        ({"label": "arm of Jan", "q": 2, "unit": "rad"}, ["S.q[1]", "S.q[2]"]),
        ({"label": "arm", "values": 2, "unit": "rad"}, ["S.arm[1]", "S.arm[2]"]),
        ({"name": "q [rad]", "values": 1, "unit": "rad"}, ["S.q [rad]"]),
        ({"name": "q", "values": 1, "unit": "rad"}, ["S.q [rad]"]),
    ],
)
def test_only_structs_of_one_signal_have_its_name(tmp_path: Path, fields: dict, found: list[str]) -> None:
    """Numbers stand for arrays of as many columns."""

    def made(value: object) -> object:
        if isinstance(value, dict):
            return {key: made(own) for key, own in value.items()}
        return DATA[:, 1 : value + 1] if isinstance(value, int) else value

    path = tmp_path / "run.mat"
    io.savemat(path, {"S": made(fields)})
    assert format_of(path).names(path) == found
    assert read(path, found).keys() == set(found)


@pytest.mark.parametrize("second", ["q", ""])
def test_structs_without_names_of_their_own_are_numbered(tmp_path: Path, second: str) -> None:
    path = tmp_path / "run.mat"
    rows = [("q", DATA[:, 1]), (second, DATA[:, 2])]
    io.savemat(path, {"signals": np.array(rows, dtype=[("label", object), ("values", object)])})
    assert format_of(path).names(path) == ["signals[1].values", "signals[2].values"]


def test_times_beside_the_samples_of_each_array_are_no_signals(tmp_path: Path) -> None:
    """As of Simulink's `To File`, where each array has the times as its first row."""
    path = tmp_path / "run.mat"
    signals = {"data_theta": DATA[:, 1], "data_alpha": DATA[:, 2], "data_vm": np.sin(5 * T)}
    io.savemat(path, {name: np.stack((T, x)) for name, x in signals.items()})
    channels = tomllib.loads(survey(path).table)["channels"]
    assert channels["time"] == "data_theta[1]"
    assert channels["position"] == {"channels": ["data_theta[2]"], "unit": "rad"}
    assert channels["torque"]["channels"] == ["data_vm[2]"]


def stored(group: h5py.Group, name: str, value: np.ndarray | str | list[object]) -> None:
    """Write a variable as MATLAB does in files of level 7.3: a list is a cell, or a field of an array of structs."""
    if isinstance(value, list):
        cells = group.create_dataset(name, (len(value), 1), dtype=h5py.ref_dtype)
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        inner = group.file.require_group("#refs#")
        for k, cell in enumerate(value):
            own = f"{group.name}.{name}.{k}".replace("/", ".")
            stored(inner, own, cell)
            cells[k, 0] = inner[own].ref
        return
    text = isinstance(value, str)
    array = np.array([[ord(c)] for c in value], dtype=np.uint16) if text else np.atleast_2d(value)
    data = group.create_dataset(name, data=array)
    data.attrs["MATLAB_class"] = np.bytes_("char" if text else "double")


def as_matlab(path: Path) -> None:
    """Give a file the header of level 7.3."""
    raw = bytearray(path.read_bytes())
    raw[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(bytes(raw))


def test_signals_in_structs_of_level_7_3_have_their_names(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        out = file.create_group("out")
        stored(out, "time", T)
        signals = out.create_group("signals")
        stored(signals, "values", [DATA[:, 1], DATA[:, 2]])
        stored(signals, "label", ["theta", "Torque 1"])
        stored(signals, "unit", ["rad", "mNm"])
        for field in signals.values():
            del field.attrs["MATLAB_class"]
        one = file.create_group("one")
        stored(one, "data", DATA[:, 2])
        stored(one, "name", "speed")
        stored(file, "runs", [DATA[:50], DATA[50:]])
    as_matlab(path)
    named = ["out.signals.theta [rad]", "out.signals.Torque 1 [mNm]", "one.speed"]
    runs = [f"runs[{run}][{k}]" for run in (1, 2) for k in (1, 2, 3)]
    assert sorted(format_of(path).names(path)) == sorted(["out.time", *named, *runs])
    found = read(path, [*named, "out.signals[2].values", "runs[2][3]"])
    np.testing.assert_array_equal(found["out.signals.Torque 1 [mNm]"], DATA[:, 2])
    np.testing.assert_array_equal(found["out.signals[2].values"], DATA[:, 2])
    np.testing.assert_array_equal(found["runs[2][3]"], DATA[50:, 2])
    channels = tomllib.loads(survey(path).table)["channels"]
    assert (channels["position"]["unit"], channels["torque"]["unit"]) == ("rad", "mN m")


def test_signals_of_structs_that_hold_more_than_one_keep_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        run = file.create_group("run")
        stored(run, "name", ["first", "second"])
        stored(run, "q", [DATA[:, 1], DATA[:, 1]])
        stored(run, "data", [DATA[:, 2], DATA[:, 2]])
        for field in run.values():
            del field.attrs["MATLAB_class"]
    as_matlab(path)
    assert sorted(format_of(path).names(path)) == ["run[1].data", "run[1].q", "run[2].data", "run[2].q"]


def test_links_and_references_of_other_programs_make_no_channels(tmp_path: Path) -> None:
    """A link that leads nowhere, or to another file, is no damage; a reference leads to what has a name already."""
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        group["q1"] = np.arange(100.0)
        group["gone"], group["elsewhere"] = h5py.SoftLink("/nowhere"), h5py.ExternalLink("other.h5", "/x")
        group.create_dataset("which", (1,), dtype=h5py.ref_dtype)[0] = group["q1"].ref
    assert format_of(path).names(path) == ["run.q1"]
