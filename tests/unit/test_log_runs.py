"""Drafts of studies: joints found by names that are part of a channel's, and folders of runs."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from haptid import errors
from haptid.cli import app
from haptid.device import read_device
from haptid.log.survey import survey
from haptid.log.survey.joint_names import are_named, matched
from haptid.study import read_study
from haptid.study.draft import draft_study

ARM = 'schema = 1\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\n'


def device(folder: Path, *joints: str) -> str:
    parents = ["", *(f'parent = "{name}"\n' for name in joints)]
    text = ARM + "".join(f'[[joints]]\nname = "{n}"\n{p}alpha = 1.57\n' for n, p in zip(joints, parents, strict=False))
    (folder / "arm.toml").write_text(text)
    return str(folder / "arm.toml")


def motion(joints: int, seed: float = 0.0, n: int = 600) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), positions and torques, (n, joints)."""
    t = np.arange(n) / 100
    q = np.stack([0.7 * np.sin((2 + k) * t + seed) + 0.1 * k for k in range(joints)], axis=1)
    return t, q, 5 * np.cos(q) - 0.3 * np.sin(3 * t)[:, None]


def written(path: Path, header: str, *columns: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9f")


@pytest.mark.parametrize(
    ("channels", "joints", "found"),
    [
        (["elbow_states", "yaw_states", "pitch_states"], [("yaw",), ("pitch",), ("elbow",)], ([1, 2, 0], ())),
        (["pos.lift", "pos.pan"], [("shoulder_pan_joint", "pan"), ("shoulder_lift_joint", "lift")], ([1, 0], ())),
        (["wrist_roll_pos", "wrist_pos"], [("wrist",), ("wrist_roll",)], ([1, 0], ())),
        (["rw angle", "pendulum angle"], [("pole",), ("rw",)], ([1, 0], ("pendulum angle", "pole"))),
        (["a_pos", "b_pos", "elbow_pos"], [("elbow",), ("x",), ("y",)], ([], ())),
        (["left_elbow", "right_elbow", "base"], [("elbow",), ("base",)], ([], ())),
        (["q1", "q2"], [("1",), ("2",)], ([], ())),
        (["a_pos", "b_pos"], [("x",), ("y",)], ([], ())),
    ],
)
def test_channels_by_words_of_their_joints(
    channels: list[str], joints: list[tuple[str, ...]], found: tuple[list[int], tuple[str, ...]]
) -> None:
    assert matched(channels, joints) == found


def test_a_file_for_each_joint_is_in_the_device_s_order_and_not_the_alphabet_s(tmp_path: Path) -> None:
    t, q, tau = motion(3)
    for k, name in enumerate(("yaw", "pitch", "elbow")):
        written(tmp_path / "run" / f"{name}_states.csv", "t,pos,effort", t, q[:, k], tau[:, k])
    text, _ = draft_study([tmp_path / "run"], read_device(device(tmp_path, "yaw", "pitch", "elbow")), "arm.toml")
    channels = tomllib.loads(text)["channels"]
    assert channels["position"]["channels"] == [f"{n}_states.pos" for n in ("yaw", "pitch", "elbow")]
    assert channels["torque"]["channels"] == [f"{n}_states.effort" for n in ("yaw", "pitch", "elbow")]
    text, _ = draft_study([tmp_path / "run"], read_device(device(tmp_path, "j1", "j2", "j3")), "arm.toml")
    assert "none is named as a joint of the device: put them, and the torques, in the order of j1, j2, j3" in text
    assert are_named(["elbow_pos", "yaw_pos"])
    assert not are_named(["arm_q1", "arm_q2"])


def test_joints_that_the_log_lacks_are_named_with_what_to_do(tmp_path: Path) -> None:
    t, q, tau = motion(2)
    written(tmp_path / "run.csv", "t,q1,q2,tau1,tau2", t, q, tau)
    text, _ = draft_study([tmp_path / "run.csv"], read_device(device(tmp_path, "1", "2", "finger")), "arm.toml")
    assert "the device has 3 joints (1, 2, finger), and these are 2" in text
    assert "--hold" in text


def test_numbered_joints_and_others_are_of_one_family(tmp_path: Path) -> None:
    """`lift` has no number, and motors of a coupled wrist have names of their own: channels are those of all joints."""
    names = ["lift", "arm_1", "arm_2"]
    t, q, tau = motion(3)
    for key, values in (("position", q), ("effort", tau)):
        written(tmp_path / "log" / f"{key}.csv", ",".join(["t", *(f"- {n}_joint_{key}" for n in names)]), t, values)
    file = device(tmp_path, "wheel", *(f"{n}_joint" for n in names), "finger")
    text, _ = draft_study([tmp_path / "log"], read_device(file), "arm.toml", tmp_path)
    made = tomllib.loads(text)["channels"]
    for key in ("position", "effort"):
        own = made["torque" if key == "effort" else key]["channels"]
        assert own == [f"{key}.- {n}_joint_{key}" for n in names]
    assert "haptid import --only lift_joint,arm_1_joint,arm_2_joint" in text
    drives = '[[motors]]\nname = "m{}"\ndrives = {{ arm_1_joint = 1.0, arm_2_joint = {} }}\n'
    own = Path(device(tmp_path, *(f"{n}_joint" for n in names)))
    motors = '[[motors]]\nname = "lift_joint"\n' + drives.format(1, 1.0) + drives.format(2, -1.0)
    own.write_text(own.read_text() + motors)
    made = tomllib.loads(draft_study([tmp_path / "log"], read_device(own), "arm.toml", tmp_path)[0])["channels"]
    assert made["torque"]["channels"] == [f"effort.- {n}_joint_effort" for n in names]


def test_a_folder_of_whole_runs_is_a_study_of_them(tmp_path: Path) -> None:
    for k, path in enumerate(("run2.csv", "run10.csv")):
        t, q, tau = motion(2, k, 600 + 50 * k)
        written(tmp_path / "runs" / path, "t,q1,q2,tau1,tau2", t, q, tau)
        written(tmp_path / "deep" / path[:-4] / "data.csv", "t,q1,q2,tau1,tau2", t, q, tau)
    arm = read_device(device(tmp_path, "1", "2"))
    for folder, ends in (("runs", ("run2.csv", "run10.csv")), ("deep", ("run2/data.csv", "run10/data.csv"))):
        text, surveyed = draft_study([tmp_path / folder], arm, "arm.toml", tmp_path)
        made = tomllib.loads(text)
        assert made["channels"]["position"]["channels"] == ["q1", "q2"]
        assert [log["path"] for log in made["logs"]] == [f"{folder}/{end}" for end in ends]
        assert [log.get("role") for log in made["logs"]] == [None, "validate"]
        assert "holds 2 runs" in surveyed.notes[0]


def test_runs_behind_a_star_may_have_columns_of_their_own(tmp_path: Path) -> None:
    """Ten runs were drafted as one log of twenty joints, as two of them had no planned positions."""
    for k, day in enumerate(("143339", "143524", "154220")):
        t, q, tau = motion(2, k)
        planned = [] if day == "154220" else [q + 0.01]
        header = "t,q1,q2,tau1,tau2" + (",q_des1,q_des2" if planned else "")
        written(tmp_path / day / "trajectory.csv", header, t, q, tau, *planned)
    arm = read_device(device(tmp_path, "1", "2"))
    text, surveyed = draft_study([tmp_path / "*" / "trajectory.csv"], arm, "arm.toml", tmp_path)
    made = tomllib.loads(text)
    assert made["channels"]["position"]["channels"] == ["q1", "q2"]
    assert [log["path"] for log in made["logs"]] == [f"{day}/trajectory.csv" for day in ("143339", "143524", "154220")]
    assert "channels are of 143339/trajectory.csv" in surveyed.notes[0]


@pytest.mark.parametrize(
    ("names", "apart"),
    [
        (("run1", "run2"), True),
        (("train", "test"), True),
        (("joint1", "joint2"), False),
        (("left_arm", "right_arm"), False),
        (("elbow", "wrist"), False),
        (("training_elbow", "training_wrist"), False),
        (("test_joint1", "test_joint2"), False),
        (("arm1_joint1", "arm1_joint2"), False),
        (("joint_1_test", "joint_10_test"), False),
        (("leg1_run1", "leg1_run2"), True),
        (("leg1_run1", "leg2_run2"), True),
        (("leg1_run1", "leg2_run1"), False),
        (("leg1_train", "leg1_test"), True),
    ],
)
@pytest.mark.parametrize("header", ["t,q1,q2,tau1,tau2", ""])
def test_without_a_device_runs_are_not_joined_and_limbs_are(
    tmp_path: Path, names: tuple[str, str], apart: bool, header: str
) -> None:
    """Two runs of two joints were drafted as one of four, or those without a header as the longer one alone."""
    for k, name in enumerate(names):
        t, q, tau = motion(2, k, 600 + 50 * k * apart)
        path, values = tmp_path / "log" / f"{name}.csv", np.column_stack([t, q, np.gradient(q, t, axis=0), tau])
        path.parent.mkdir(exist_ok=True)
        head = header.replace("tau1", "dq1,dq2,tau1")
        np.savetxt(path, values, delimiter=",", header=head, comments="")
    (tmp_path / "log" / "notes.csv").write_text("what,who\nfirst,me\n")
    asked = CliRunner().invoke(app, ["channels", str(tmp_path / "log"), "--toml"])
    assert asked.exit_code == (2 if apart else 0), asked.output
    assert ("have positions and torques each" in asked.output) is apart


def test_of_many_runs_each_is_held_out_and_those_in_another_unit_are_named(tmp_path: Path) -> None:
    for k in range(5):
        t, q, tau = motion(2, k)
        turned, larger = (np.rad2deg(q) if k == 2 else q), (1e3 * tau if k == 3 else tau)
        written(tmp_path / "runs" / f"run{k}.csv", "t,q1,q2,tau1,tau2", t, turned, larger)
    arm = read_device(device(tmp_path, "1", "2"))
    text, surveyed = draft_study([tmp_path / "runs"], arm, "arm.toml", tmp_path)
    made = tomllib.loads(text)
    assert [log.get("role") for log in made["logs"]] == 5 * [None]
    assert made["validation"] == {"cross_validation": "leave-one-log-out"}
    odd = [note.split(" those")[0] for note in surveyed.notes[1:]]
    assert [line.split(" are ")[0] for line in odd] == ["run2.csv: its positions", "run3.csv: its torques"]
    assert 30 < float(odd[0].split()[-2]) < 100 < 500 < float(odd[1].split()[-2]) < 2000
    lines = text.splitlines()
    assert ["in another unit" in line for line in lines if line.startswith("path")] == [False, False, True, True, False]


def test_a_folder_that_is_no_log_names_the_logs_in_it(tmp_path: Path) -> None:
    t, q, tau = motion(1)
    written(tmp_path / "day" / "a" / "data.csv", "t,q1,tau1", t, q, tau)
    with pytest.raises(errors.LogFileError, match=r"a/data\.csv.*--device"):
        survey(tmp_path / "day")


def test_a_recording_of_goals_alone_says_what_is_missing(tmp_path: Path) -> None:
    """As of a hobby arm: positions and the positions that were commanded, `actions`, which are no torques."""
    t, q, tau = motion(2)
    rows = [{"time": float(t[k]), "joint_positions": q[k].tolist()} for k in range(len(t))]
    (tmp_path / "run.json").write_text(json.dumps({"actions": q.tolist(), "sensor_data": rows}))
    path = device(tmp_path, "1", "2")
    result = CliRunner().invoke(
        app, ["channels", str(tmp_path / "run.json"), "--device", path, "--out", str(tmp_path / "study.toml")]
    )
    assert result.exit_code == 0, result.output
    assert "Present_Load" in result.output
    assert "haptid excite" in result.output
    assert "is it" not in (tmp_path / "study.toml").read_text()
    with pytest.raises(errors.StudyFileError, match="without them nothing is identified"):
        read_study(tmp_path / "study.toml")
    for row, load in zip(rows, np.round(100 * tau).astype(int), strict=True):
        row["joint_loads"] = load.tolist()
    (tmp_path / "run.json").write_text(json.dumps({"actions": q.tolist(), "sensor_data": rows}))
    text, _ = draft_study([tmp_path / "run.json"], read_device(path), "arm.toml")
    assert tomllib.loads(text)["channels"]["torque"]["field"] == "sensor_data.joint_loads"
