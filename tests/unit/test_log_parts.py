"""Recordings of which each quantity is in a file of its own: which files belong together, and how they are joined."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
import small_study
from haptid import errors
from haptid.app.work import digest_of
from haptid.cli import app
from haptid.log.file_format import sha256_of
from haptid.log.formats.folders import matched_files, root_of
from haptid.log.survey import survey
from haptid.log.survey.parts import parts_in_words, recordings
from haptid.report.run import _file_stem
from haptid.study.draft import draft_study
from haptid.study.read import read_study
from motions import multisine

RATE = 250.0
T = np.arange(0.0, 6.0, 1.0 / RATE)
Q, QD, _ = multisine(2, 6.0, 1.0 / RATE, 3)
Q, QD = Q[:, : T.size].T, QD[:, : T.size].T
TAU = 4.0 * np.cos(Q) + np.sign(QD) + 0.1 * np.random.default_rng(3).standard_normal(Q.shape)


def write(folder: Path, name: str, array: np.ndarray, header: str = "") -> Path:
    """One table, as CSV."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / name, array, delimiter=",", header=header, comments="")
    return folder / name


def names(found: Sequence[Path], folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in found]


def device(folder: Path) -> haptid.Device:
    (folder / "device.toml").write_text(small_study.DEVICE)
    return haptid.read_device(folder / "device.toml")


def test_files_of_a_folder_are_one_log(tmp_path: Path) -> None:
    made = {"q.csv": Q, "qd.csv": QD, "tau.csv": TAU, "time.csv": T}
    files = [write(tmp_path / "run", name, array) for name, array in made.items()]
    found = recordings(files)
    assert found == [tmp_path / "run"]
    assert (
        parts_in_words(found)
        == "q.csv, qd.csv, tau.csv and time.csv are one recording, each quantity in a file of its own"
    )
    assert recordings([tmp_path / "run"]) == []  # a log already
    shown = CliRunner().invoke(app, ["channels", *map(str, files)]).output
    assert "are one recording" in shown
    assert 'position = { field = "q", joints = [1, 2], unit = "rad" }' in shown


@pytest.mark.parametrize(
    ("files", "patterns"),
    [
        (("run1_q", "run1_tau", "run2_q", "run2_tau"), ["run1_*.csv", "run2_*.csv"]),
        (("joint_positions_1", "joint_torques_1", "joint_positions_2", "joint_torques_2"), ["*_1.csv", "*_2.csv"]),
        (("position/a", "position/b", "torque/a", "torque/b"), ["*/a.csv", "*/b.csv"]),
        (("a/q", "a/tau", "b/q", "b/tau"), ["a", "b"]),
        (("ex-meas_pos-9", "ex-effort-9", "ex-meas_pos-10", "ex-effort-10"), ["ex-*-9.csv", "ex-*-10.csv"]),
    ],
)
def test_runs_of_several_files_each_are_told_by_their_names(
    tmp_path: Path, files: Sequence[str], patterns: Sequence[str]
) -> None:
    for name in files:
        write(tmp_path, f"{name}.csv", TAU if "t" in name.replace("position", "").replace("meas", "") else Q)
    assert names(recordings([tmp_path]), tmp_path) == patterns
    draft = tomllib.loads(draft_study([tmp_path], device(tmp_path), "device.toml", tmp_path)[0])
    assert [log["path"] for log in draft["logs"]] == patterns
    assert draft["logs"][1]["role"] == "validate"


def test_files_whose_names_tell_nothing_are_joined_by_what_is_in_them(tmp_path: Path) -> None:
    files = [
        write(tmp_path, "log_a.csv", np.c_[T, Q], "t,q1,q2"),
        write(tmp_path, "log_b.csv", np.c_[T, TAU], "t,tau1,tau2"),
    ]
    write(tmp_path, "other.csv", T)
    assert names(recordings(files), tmp_path) == ["log_*.csv"]


def test_logs_with_all_quantities_are_no_parts(tmp_path: Path) -> None:
    files = [
        write(tmp_path, f"{name}.csv", np.c_[T, Q, TAU], "t,q1,q2,tau1,tau2")
        for name in ("slow_position", "fast_torque")
    ]
    assert recordings(files) == []
    assert recordings(files[:1]) == []
    draft = tomllib.loads(draft_study(files, device(tmp_path), "device.toml", tmp_path)[0])
    assert [log["path"] for log in draft["logs"]] == ["slow_position.csv", "fast_torque.csv"]


def test_files_of_different_length_are_refused_by_how_much(tmp_path: Path) -> None:
    files = [write(tmp_path, "q.csv", Q), write(tmp_path, "tau.csv", TAU[:-7]), write(tmp_path, "time.csv", T)]
    said = f"{len(Q)} rows and tau[1] has {len(Q) - 7}, 7 fewer: without times of their own"
    with pytest.raises(errors.LogFileError) as refused:
        draft_study(files, device(tmp_path), "device.toml", tmp_path)
    assert said in str(refused.value)
    shown = " ".join(CliRunner().invoke(app, ["channels", str(tmp_path)]).output.split())
    assert said in shown
    channels = haptid.Channels(
        haptid.Signal(("q[1]", "q[2]"), "rad"), haptid.Signal(("tau[1]", "tau[2]"), "N m"), time="time"
    )
    with pytest.raises(errors.LogDataError, match="7 fewer"):
        haptid.read_log(tmp_path, channels)


def test_files_with_headers_and_other_times_are_joined_by_these(tmp_path: Path) -> None:
    """Torques at half of the rate, and 1 ms later, were taken row by row where there were as many of them."""
    late = T[::2] + 1e-3
    torque = np.column_stack([np.interp(late, T, own) for own in TAU.T])
    write(tmp_path, "q.csv", np.c_[T, Q], "time,j1,j2")
    write(tmp_path, "tau.csv", np.c_[late, torque], "stamp,j1,j2")
    assert sorted({c.name for c in survey(tmp_path).topics[0].channels}) == ["q.j1", "q.j2", "tau.j1", "tau.j2", "time"]
    table = tomllib.loads(survey(tmp_path).table)["channels"]
    assert table["time"] == "time"
    channels = haptid.Channels(
        haptid.Signal(("q.j1", "q.j2"), "rad"), haptid.Signal(("tau.j1", "tau.j2"), "N m"), time="time"
    )
    log = haptid.read_log(tmp_path, channels)
    kept = (late[0] <= T) & (late[-1] >= T)  # beyond these no torque is known
    wanted = np.column_stack([np.interp(T[kept], late, own) for own in torque.T])
    np.testing.assert_allclose(log.position, Q[kept], atol=1e-12)
    np.testing.assert_allclose(log.torque, wanted, atol=1e-9 * np.abs(TAU).max())
    write(tmp_path, "tau.csv", np.c_[T, TAU], "stamp,j1,j2")
    assert "q.time" in {c.name for c in survey(tmp_path).topics[0].channels}  # row by row: times are equal


def test_a_study_reads_files_by_a_pattern_and_their_hash_is_of_all(tmp_path: Path) -> None:
    model = haptid.DynamicModel(device(tmp_path))
    q, qd, qdd = multisine(2, 6.0, 1.0 / RATE, 3)
    beta = model.base.of(np.random.default_rng(0).uniform(0.1, 0.3, len(model.device.parameters)))
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau += 0.02 * np.random.default_rng(1).standard_normal(tau.shape)
    t = np.arange(q.shape[1]) / RATE
    for name, array in (("q", q.T), ("tau", tau.T), ("time", t)):
        write(tmp_path, f"run1_{name}.csv", array)
        write(tmp_path, f"run2_{name}.csv", 2 * array)
    text = draft_study([tmp_path], device(tmp_path), str(tmp_path / "device.toml"), tmp_path)[0]
    (tmp_path / "study.toml").write_text(text.split('\n[[logs]]\npath = "run2_')[0])
    found = haptid.identify(read_study(tmp_path / "study.toml"))
    np.testing.assert_allclose(found.estimate["ZZ2"].value, beta[model.base.names.index("ZZ2")], rtol=0.02)
    before, seen = sha256_of(tmp_path / "run1_*.csv"), digest_of(tmp_path / "study.toml")
    write(tmp_path, "run1_tau.csv", tau.T + 1.0)
    assert sha256_of(tmp_path / "run1_*.csv") != before
    os.utime(tmp_path / "run1_tau.csv", (1.0, 1.0))
    assert digest_of(tmp_path / "study.toml") != seen
    with pytest.raises(errors.LogFileError, match="no table or array matches"):
        haptid.read_log(tmp_path / "run9_*.csv")


def test_a_pattern_below_a_folder_with_a_star_and_too_many_files(tmp_path: Path) -> None:
    folder = tmp_path / "set*1"
    for name, array in (("q", Q), ("tau", TAU)):
        write(folder, f"run1_{name}.csv", array)
    assert [name for name, _ in matched_files(folder / "run1_*.csv")] == ["q", "tau"]
    assert survey(folder / "run1_*.csv").quantities >= {"position", "torque"}
    for k in range(70):
        write(folder, f"many_{k}.csv", T[:3])
    with pytest.raises(errors.LogFileError, match="70 files match; at most 64 are one log"):
        survey(folder / "many_*.csv")
    with pytest.raises(errors.LogFileError, match="no such file"):
        survey(folder / "none" / "*.csv")


def test_files_of_a_pattern_are_named_from_the_folder_above_its_star() -> None:
    assert root_of(Path("/haptid-none-*.csv")) == Path("/")
    assert root_of(Path("haptid-none-*.csv")) == Path()
    assert len(sha256_of(Path("/haptid-none-*.csv"))) == 64


@pytest.mark.parametrize(
    ("log", "stem"),
    [("run1_*.csv", "run1"), ("*/run1.csv", "run1"), ("a/ex-*-9.csv", "ex-9"), ("*_2.csv", "2"), ("*.csv", "")],
)
def test_pictures_of_a_pattern_have_no_star_in_their_names(log: str, stem: str) -> None:
    assert _file_stem(log) == stem


ELBOW = small_study.DEVICE.replace('name = "1"', 'name = "shoulder"').replace('name = "2"', 'name = "elbow"')
JOINTS = [("shoulder",), ("elbow",)]


@pytest.mark.parametrize("ends", [("shoulder", "elbow"), ("2", "1")])
def test_files_of_one_joint_and_quantity_each_are_one_log(tmp_path: Path, ends: tuple[str, str]) -> None:
    """They were drafted as a run of each joint."""
    folder = tmp_path / "log"
    files = [
        write(folder, f"{end}_{quantity}.csv", array[:, k])
        for k, end in enumerate(ends)
        for quantity, array in (("position", Q), ("torque", TAU))
    ]
    assert recordings([folder], JOINTS) == []
    assert recordings([folder], [("a",), ("b",)], JOINTS) == []  # names of drives
    assert recordings(files, JOINTS) == [folder]
    assert len(recordings([folder])) == (2 if "1" in ends else 0)
    (tmp_path / "device.toml").write_text(ELBOW)
    found = haptid.read_device(tmp_path / "device.toml")
    for given in ([folder], files):
        draft = tomllib.loads(draft_study(given, found, "device.toml", tmp_path)[0])
        assert [log["path"] for log in draft["logs"]] == ["log"]
        if "1" not in ends:
            assert draft["channels"]["position"]["channels"] == ["shoulder_position", "elbow_position"]


@pytest.mark.parametrize("ends", [("shoulder", "elbow"), ("joint1", "joint2")])
@pytest.mark.parametrize("whole", [False, True])
def test_runs_of_a_file_for_each_joint_are_a_log_each(tmp_path: Path, ends: tuple[str, str], whole: bool) -> None:
    """They were drafted as a log of each joint, or as one of all runs."""
    folder = tmp_path / "log"
    for run in (1, 2):
        for k, end in enumerate(ends):
            if whole:
                write(folder, f"run{run}_{end}.csv", np.column_stack([T, Q[:, k], TAU[:, k]]), "t,q,tau")
            else:
                write(folder, f"run{run}_{end}_q.csv", Q[:, k])
                write(folder, f"run{run}_{end}_tau.csv", TAU[:, k])
    assert names(recordings([folder], JOINTS), folder) == ["run1_*.csv", "run2_*.csv"]
    (tmp_path / "device.toml").write_text(ELBOW)
    draft = tomllib.loads(
        draft_study([folder], haptid.read_device(tmp_path / "device.toml"), "device.toml", tmp_path)[0]
    )
    assert [log["path"] for log in draft["logs"]] == ["log/run1_*.csv", "log/run2_*.csv"]
    own = "{}.q" if whole else "{}_q"
    assert draft["channels"]["position"]["channels"] == [own.format(end) for end in ends]


def test_runs_whose_files_no_pattern_names_need_folders(tmp_path: Path) -> None:
    for run in (1, 2):
        for k, end in enumerate(("shoulder", "elbow")):
            write(tmp_path, f"{end}_{run}_q.csv", Q[:, k])
            write(tmp_path, f"{end}_{run}_tau.csv", TAU[:, k])
    with pytest.raises(errors.LogFileError, match=r"are of two joints of one run.*folder of its own"):
        recordings([tmp_path], JOINTS)


def test_runs_that_are_called_by_the_joint_that_they_move_have_all_joints(tmp_path: Path) -> None:
    for run in (1, 2):
        for end in ("shoulder", "elbow"):
            write(tmp_path, f"run{run}_{end}.csv", np.column_stack([T, Q, TAU]), "t,q1,q2,tau1,tau2")
    assert recordings([tmp_path], JOINTS) == []


def test_runs_with_a_file_of_all_joints_for_each_quantity_are_a_log_each(tmp_path: Path) -> None:
    """They are called by the joint that they move."""
    for run in (1, 2):
        for end in ("shoulder", "elbow"):
            write(tmp_path, f"run{run}_{end}_q.csv", Q)
            write(tmp_path, f"run{run}_{end}_tau.csv", TAU)
    found = names(recordings([tmp_path], JOINTS), tmp_path)
    assert sorted(found) == sorted(f"run{run}_{end}_*.csv" for run in (1, 2) for end in ("shoulder", "elbow"))


def test_runs_called_by_words_are_runs_of_a_device_with_other_joints(tmp_path: Path) -> None:
    for run in ("slow", "fast"):
        for quantity, array in (("q", Q), ("tau", TAU)):
            write(tmp_path, f"{run}_{quantity}.csv", array)
    assert names(recordings([tmp_path], JOINTS), tmp_path) == ["fast_*.csv", "slow_*.csv"]
    assert recordings([tmp_path]) == []


@pytest.mark.parametrize(("run", "other"), [("run1", "run1_cold"), ("run", "run_2")])
def test_a_pattern_that_stands_for_another_run_too_is_refused(tmp_path: Path, run: str, other: str) -> None:
    """Runs whose names begin alike were one log."""
    made = {"q": Q, "tau": TAU, "time": T}
    files = [write(tmp_path, f"{run}_{name}.csv", array) for name, array in made.items()]
    assert recordings(files, JOINTS) == [tmp_path]
    for name, array in made.items():
        write(tmp_path, f"{other}_{name}.csv", array)
    said = "stands for files of two recordings, as run.*_q.csv and run.*_q.csv"
    with pytest.raises(errors.LogFileError, match=said):
        survey(tmp_path / f"{run}_*.csv")
    with pytest.raises(errors.LogFileError, match=said):
        recordings([tmp_path], JOINTS)
    with pytest.raises(errors.LogFileError, match=said):
        recordings(files, JOINTS)
    assert len(survey(tmp_path / f"{other}_*.csv").topics[0].channels) == 5


def test_files_beside_others_that_their_pattern_would_take_need_a_folder(tmp_path: Path) -> None:
    files = [write(tmp_path, f"run1_{name}.csv", array) for name, array in (("q", Q), ("tau", TAU))]
    write(tmp_path, "run1_notes.csv", T)
    with pytest.raises(errors.LogFileError, match=r"cannot be one log by a path with `\*`.*folder of their own"):
        recordings(files)


def test_words_of_quantities_beside_each_other_are_of_one_recording(tmp_path: Path) -> None:
    for name, array in {"q": Q, "tau": TAU, "joint_q": Q, "des_q": Q, "des_tau": TAU, "sensor_tau": TAU}.items():
        write(tmp_path, f"run1_{name}.csv", array)
    assert len(survey(tmp_path / "run1_*.csv").topics[0].channels) == 12


def test_a_pattern_of_complete_runs_stands_for_several_logs(tmp_path: Path) -> None:
    """The first one was used alone."""
    for k in (1, 2):
        write(tmp_path, f"run_{k}.csv", np.c_[T, Q, k * TAU], "t,q1,q2,tau1,tau2")
    write(tmp_path, "other.csv", T)
    draft = tomllib.loads(draft_study([tmp_path / "run_*.csv"], device(tmp_path), "device.toml", tmp_path)[0])
    assert [log["path"] for log in draft["logs"]] == ["run_1.csv", "run_2.csv"]
    shown = CliRunner().invoke(app, ["channels", str(tmp_path / "run_*.csv")])
    assert shown.exit_code == 2
    assert "stands for files of one quantity each" in " ".join(shown.output.split())


def test_a_pattern_of_a_file_for_each_joint_is_one_log(tmp_path: Path) -> None:
    for k, joint in enumerate(("shoulder", "elbow")):
        write(tmp_path, f"run_{joint}.csv", np.c_[T, Q[:, k], TAU[:, k]], "t,q,tau")
    (tmp_path / "device.toml").write_text(ELBOW)
    found = haptid.read_device(tmp_path / "device.toml")
    draft = tomllib.loads(draft_study([tmp_path / "run_*.csv"], found, "device.toml", tmp_path)[0])
    assert [log["path"] for log in draft["logs"]] == ["run_*.csv"]


def test_files_whose_times_differ_and_cannot_be_joined_are_refused(tmp_path: Path) -> None:
    """They were taken row by row: of another epoch or unit, set back, or beside a file that has none."""
    channels = haptid.Channels(
        haptid.Signal(("q.j1", "q.j2"), "rad"), haptid.Signal(("tau.j1", "tau.j2"), "N m"), time="q.time"
    )
    write(tmp_path, "q.csv", np.c_[T, Q], "time,j1,j2")
    back = np.r_[T[: T.size // 2], T[: T.size - T.size // 2]]
    for own in (T + 1.7e9, 1e3 * T, back):
        write(tmp_path, "tau.csv", np.c_[own, TAU], "time,j1,j2")
        with pytest.raises(errors.LogFileError, match=r"times of files differ, q\.csv from 0 to .* tau\.csv from"):
            haptid.read_log(tmp_path, channels)
    write(tmp_path, "tau.csv", np.c_[T + 0.1, TAU], "time,j1,j2")
    write(tmp_path, "heat.csv", TAU, "motor1,motor2")
    with pytest.raises(errors.LogFileError, match=r"times of files differ"):
        haptid.read_log(tmp_path, channels)
    write(tmp_path, "tau.csv", np.c_[T, TAU], "time,j1,j2")
    np.testing.assert_allclose(haptid.read_log(tmp_path, channels).torque, TAU, atol=1e-6)
