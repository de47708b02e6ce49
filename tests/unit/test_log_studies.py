"""One recording in several formats, from the log to the result: the estimate is the same."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

import recorders
import small_study
from haptid import errors
from haptid.cli import app
from haptid.device import read_device
from haptid.log.survey import survey
from haptid.study import read_study
from haptid.study.check import check_study
from haptid.study.draft import draft_study
from haptid.study.identify import identify

JOINTS = ("arm/upper", "arm/lower")
SIGNALS = {"observation.state": "pos", "observation.current": "current"}
KIND = "sensor_msgs/msg/JointState"
CHANNELS = {
    "mcap": """
time = { topic = "/joint_states", stamp = "header" }
position = { topic = "/joint_states", field = "position", joints = ["arm/upper", "arm/lower"], unit = "rad" }
torque = { topic = "/joint_states", field = "effort", joints = ["arm/upper", "arm/lower"], unit = "N m" }
""",
    "merged": """
time = { stamp = "receive" }
merge = { onto = "position", method = "nearest", largest_gap = 0.001 }
position = { topic = "/joint_states", field = "position", joints = ["arm/upper", "arm/lower"], unit = "rad" }
torque = { topic = "/commands", field = "data", joints = [2, 1], unit = "N m" }
""",
    "lerobot": """
time = "time"
position = { field = "observation.state", joints = ["arm/upper.pos", "arm/lower.pos"], unit = "rad" }
torque = { field = "observation.state", joints = ["arm/upper.torque", "arm/lower.torque"], unit = "N m" }
""",
}


def recorded(folder: Path, kind: str) -> Path:
    """The small study with its logs in another format."""
    small_study.write_study(folder)
    text, names = small_study.STUDY, []
    for seed, name in ((1, "log"), (2, "check")):
        log = small_study.columns(seed)
        q, tau = (np.column_stack([log[f"{what}{k}"] for k in (1, 2)]) for what in ("q", "tau"))
        names.append(name)
        if kind == "lerobot":
            state = {"observation.state": np.hstack([q, tau])}
            elements = [f"{joint}.{what}" for what in ("pos", "torque") for joint in JOINTS]
            recorders.lerobot(folder / name, [state], {"observation.state": elements}, 500.0)
        else:
            recorders.ros2(folder / f"{name}.bag", messages(q, tau, kind == "merged"))
        text = text.replace(f'"{name}.csv"', f'"{name}"' if kind == "lerobot" else f'"{name}.bag"')
    head, _, rest = text.partition("[channels]")
    study = folder / "study.toml"
    study.write_text(f"{head}[channels]{CHANNELS[kind]}{rest[rest.index('[[logs]]') :]}")
    return study


def messages(q: np.ndarray, tau: np.ndarray, apart: bool) -> list[recorders.Said]:
    """Joint states in changing order; torques in the same messages, or in an array of another topic, lower first."""
    rng, sent, types = np.random.default_rng(3), [], recorders.STORE.types
    for k in range(len(q)):
        stamp, order = recorders.START + 2_000_000 * k, rng.permutation(2)
        names = [JOINTS[i] for i in order]
        state = recorders.joint_state(stamp, names, q[k, order], () if apart else tau[k, order])
        sent.append(("/joint_states", stamp, KIND, state))
        if apart:
            layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            command = types["std_msgs/msg/Float64MultiArray"](layout=layout, data=np.ascontiguousarray(tau[k, ::-1]))
            sent.append(("/commands", stamp + 300_000, "std_msgs/msg/Float64MultiArray", command))
    return sent


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    study = small_study.write_study(tmp_path_factory.mktemp("csv"))
    return np.asarray(identify(read_study(study)).estimate.beta)


@pytest.mark.parametrize("kind", CHANNELS)
def test_the_estimate_does_not_depend_on_the_format(tmp_path: Path, kind: str, expected: np.ndarray) -> None:
    found = np.asarray(identify(read_study(recorded(tmp_path, kind))).estimate.beta)
    # Stamps in ns, and times of frames, differ from those of the text by rounding only.
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_arrays_of_messages_without_names_are_drafted_by_how_they_move(tmp_path: Path) -> None:
    """Positions, their rates, torques and the time in one `Float64MultiArray`, as a controller's own node says them."""
    rng, t, types = np.random.default_rng(3), np.arange(1500) * 2e-3, recorders.STORE.types
    q = np.column_stack([np.sin(w * t) + 0.4 * np.cos(2.3 * w * t) for w in (3.0, 4.1, 5.3)])
    rows = np.column_stack((q, np.gradient(q, t, axis=0), 3 * np.cos(q) + rng.standard_normal(q.shape), t))
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    kind = "std_msgs/msg/Float64MultiArray"
    sent = [
        ("/robot/information", recorders.START + 2_000_000 * k, kind, types[kind](layout=layout, data=row))
        for k, row in enumerate(rows)
    ]
    recorders.ros2(tmp_path / "log.bag", sent)
    channels = tomllib.loads(survey(tmp_path / "log.bag").table)["channels"]
    where = {"topic": "/robot/information", "field": "data"}
    assert channels["position"] == {**where, "joints": [1, 2, 3], "unit": "rad"}
    assert channels["velocity"] == {**where, "joints": [4, 5, 6], "unit": "rad/s"}
    assert channels["torque"] == {**where, "joints": [7, 8, 9], "unit": "N m"}


def test_the_printed_table_is_a_study(tmp_path: Path, expected: np.ndarray) -> None:
    """What `haptid channels` prints of a log in rad and N m can be pasted, and gives the same estimate."""
    study = recorded(tmp_path, "mcap")
    result = CliRunner().invoke(app, ["channels", str(tmp_path / "log.bag"), "--toml"])
    assert result.exit_code == 0
    ordered = result.stdout.replace('["arm/lower", "arm/upper"]', '["arm/upper", "arm/lower"]')
    head, _, rest = study.read_text().partition("[channels]")
    study.write_text(head + ordered + rest[rest.index("[[logs]]") :])
    found = np.asarray(identify(read_study(study)).estimate.beta)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_episodes_of_one_data_set_have_their_own_roles(tmp_path: Path) -> None:
    study = recorded(tmp_path, "lerobot")
    text = study.read_text()
    head, _, rest = text.partition("[[logs]]")
    entries = '[[logs]]\npath = "log"\nepisodes = [0]\n[[logs]]\npath = "log"\nrole = "validate"\nepisodes = [{k}]\n'
    tail = rest[rest.index("[treatment]") :]
    study.write_text(head + entries.replace("{k}", "1") + tail)
    assert [entry.episodes for entry in read_study(study).logs] == [(0,), (1,)]
    study.write_text(head + entries.replace("{k}", "0") + tail)
    with pytest.raises(errors.StudyFileError, match="named twice"):
        read_study(study)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('topic = "/joint_states", stamp', "stamp", None),
        (
            'time = { topic = "/joint_states", stamp = "header" }',
            'time = { stamp = "header" }\ntime_unit = "s"',
            "time_unit",
        ),
        ('field = "position", ', "", "channels.position"),
        ('field = "position", ', 'field = "position", channels = ["q"], ', "channels.position"),
        ('stamp = "header"', 'stamp = "sender"', "stamp"),
    ],
)
def test_keys_of_channels(tmp_path: Path, old: str, new: str, key: str | None) -> None:
    study = tmp_path / "study.toml"
    text = f'schema = 1\nname = "x"\ndevice = "d.toml"\n[channels]{CHANNELS["mcap"]}[[logs]]\npath = "log.mcap"\n'
    assert old in text
    study.write_text(text.replace(old, new))
    if key is None:
        assert read_study(study).logs[0].channels.time == "/joint_states@header"
        return
    with pytest.raises(errors.StudyFileError) as raised:
        read_study(study)
    assert key in str(raised.value)


def test_survey_of_messages(tmp_path: Path) -> None:
    """Rates, joints, empty fields and offsets of stamps as they were written; currents are not called torques."""
    stamps, q, tau = recorders.arm(600, 200.0, 2)
    sent = []
    for k, stamp in enumerate(stamps):
        at = recorders.START + int(stamp)
        state = recorders.joint_state(at, JOINTS, np.rad2deg(q[k]) * 5, np.full(2, np.nan) if k % 2 else ())
        sent.append(("/arm/joint_states", at + 1_500_000, KIND, state))
        sent.append(("/motor_currents", at + 2_000_000, KIND, recorders.joint_state(0, JOINTS[::-1], [], 900 * tau[k])))
    found = survey(recorders.ros2(tmp_path / "run", sent))
    arm, currents = found.topics
    assert (arm.name, arm.count, arm.joints) == ("/arm/joint_states", 600, JOINTS)
    assert arm.rate_hz == pytest.approx(200)
    assert arm.late_ms == pytest.approx(1.5)
    assert arm.empty == {"velocity": 600, "effort": 300}
    assert currents.header == ""
    assert {channel.unit for channel in currents.channels} == {"mA"}
    effort = next(channel for channel in arm.channels if channel.name == "effort[arm/upper]")
    assert (effort.count, effort.missing) == (0, 600)
    assert 'stamp = "receive"' in found.table
    assert 'field = "position", joints = ["arm/upper", "arm/lower"], unit = "deg"' in found.table
    assert (
        'topic = "/motor_currents", field = "effort", joints = ["arm/upper", "arm/lower"], unit = "mA"' in found.table
    )
    assert np.isnan(found.to_json()["topics"][1]["late_ms"])


@pytest.mark.parametrize(
    ("header", "scale", "unit", "why"),
    [
        ("time_ms,q0,q1,i0,i1", 1e3, "ms", "by its name"),
        ("stamp,q0,q1,i0,i1", 1e6, "us", "usual step"),
        ("Time [s],q0 [deg],q1 [deg],i0 [mA],i1 [mA]", 1.0, "s", "the file states s"),
    ],
)
def test_survey_of_a_table(tmp_path: Path, header: str, scale: float, unit: str, why: str) -> None:
    stamps, q, tau = recorders.arm(300, 1000.0, 2)
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([stamps * 1e-9 * scale, q, tau]), delimiter=",", header=header, comments="")
    found = survey(path)
    time = found.topics[0].channels[0]
    assert (time.quantity, time.unit) == ("time", unit)
    assert why in time.reason
    assert found.topics[0].rate_hz == pytest.approx(1000)
    units = [channel.unit for channel in found.topics[0].channels[1:]]
    assert units == (["deg", "deg", "mA", "mA"] if "deg" in header else ["rad", "rad", "A", "A"])
    assert f"unit = {json.dumps(units[0])}" in found.table


@pytest.mark.parametrize("header", ["Theta_1,D_Theta_1,DD_Theta_1,tau", "theta,theta_dot,theta_ddot,tau"])
def test_rates_by_the_names_of_positions(tmp_path: Path, header: str) -> None:
    t = np.arange(0, 3, 0.01)
    columns = [t, np.sin(t), np.cos(t), -np.sin(t), 0.1 * np.cos(t)]
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=f"t,{header}", comments="")
    quantities = [channel.quantity for channel in survey(path).topics[0].channels]
    assert quantities == ["time", "position", "velocity", "other", "torque"]


def test_channels_of_what_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"\x89MCAP0\r\n")
    for path in (tmp_path / "log.mcap", tmp_path):
        result = CliRunner().invoke(app, ["channels", str(path)])
        assert result.exit_code == 2


def test_a_study_is_drafted_for_the_joints_of_a_device(tmp_path: Path) -> None:
    """Channels are chosen and ordered by names and aliases of the joints; further logs validate."""
    (tmp_path / "arm.toml").write_text(
        'schema = 1\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\nconvention = "modified-dh"\n'
        '[[joints]]\nname = "elbow"\n[[joints]]\nname = "wrist_1"\nalias = "wrist 1"\nd = 0.2\n'
    )
    rng = np.random.default_rng(3)
    states = [rng.uniform(-90, 90, (50, 3)).astype(np.float32) for _ in range(2)]
    frames = [{"observation.state": x, "observation.current": x / 100} for x in states]
    named = {key: [f"{x}.{end}" for x in ("gripper", "wrist 1", "elbow")] for key, end in SIGNALS.items()}
    recorders.lerobot(tmp_path / "moves", frames, named, 50.0)
    device = read_device(tmp_path / "arm.toml")
    text, _ = draft_study([tmp_path / "moves", tmp_path / "more"], device, str(tmp_path / "arm.toml"), tmp_path)
    made = tomllib.loads(text)
    assert made["device"] == "arm.toml"
    assert made["channels"]["position"]["joints"] == ["elbow.pos", "wrist 1.pos"]
    assert made["channels"]["torque"]["joints"] == ["elbow.current", "wrist 1.current"]
    assert (made["channels"]["torque"]["unit"], made["channels"]["torque"]["side"]) == ("A", "motor")
    assert [log.get("role") for log in made["logs"]] == [None, "validate"]
    (tmp_path / "study.toml").write_text(text)
    assert len(read_study(tmp_path / "study.toml").logs) == 2


def test_files_that_call_their_variable_as_the_run_have_channels_of_their_own(tmp_path: Path) -> None:
    """`run1.q` of `run1.mat` is `run2.q` of `run2.mat`: a study of both reads both."""
    small_study.write_study(tmp_path)
    for seed, run in enumerate(("run1", "run2"), start=1):
        savemat(tmp_path / f"{run}.mat", {run: dict(small_study.columns(seed))})
    device = tmp_path / tomllib.loads(small_study.STUDY)["device"]
    logs = [tmp_path / "run1.mat", tmp_path / "run2.mat"]
    text, _ = draft_study(logs, read_device(device), str(device), tmp_path)
    plan = tomllib.loads(text)
    assert "channels" not in plan["logs"][0]
    assert plan["logs"][1]["role"] == "validate"
    for channels, run in ((plan["channels"], "run1"), (plan["logs"][1]["channels"], "run2")):
        assert {name.partition(".")[0] for name in channels["position"]["channels"]} == {run}
    (tmp_path / "study.toml").write_text(text)
    assert not check_study(tmp_path / "study.toml").problems


def test_parts_of_a_recording_in_several_files_are_named(tmp_path: Path) -> None:
    small_study.write_study(tmp_path)
    log = small_study.columns(1)
    torques = {key for key in log if key.startswith("tau")}
    for name, keys in (("first", log.keys() - torques), ("second", torques)):
        own = {key: log[key] for key in sorted(keys)}
        header, data = ",".join(own), np.column_stack([*own.values()])
        np.savetxt(tmp_path / f"{name}.csv", data, delimiter=",", header=header, comments="")
    device = tmp_path / tomllib.loads(small_study.STUDY)["device"]
    _, found = draft_study(
        [tmp_path / "first.csv", tmp_path / "second.csv"], read_device(device), str(device), tmp_path
    )
    assert found.lacking == ("torque",)
    assert any(note.startswith("second.csv has torques, which first.csv lacks") for note in found.notes)
    _, found = draft_study([tmp_path / "first.csv"], read_device(device), str(device), tmp_path)
    assert not any("lacks" in note for note in found.notes)


def test_joints_that_stand_still_are_drafted_and_named(tmp_path: Path) -> None:
    """A log that moves one joint of two: the draft permits its constant channel, and the error says what to hold."""
    small_study.write_study(tmp_path)
    log = small_study.columns(1)
    log["q2"] = np.full_like(log["q2"], 0.3)
    header, data = ",".join(log), np.column_stack([*log.values()])
    np.savetxt(tmp_path / "one.csv", data, delimiter=",", header=header, comments="")
    device = tmp_path / tomllib.loads(small_study.STUDY)["device"]
    text, _ = draft_study([tmp_path / "one.csv"], read_device(device), str(device), tmp_path)
    assert tomllib.loads(text)["channels"]["position"]["constant_ok"] is True
    assert "without a change, is it connected?: q2" in text
    (tmp_path / "drafted.toml").write_text(text)
    with pytest.raises(errors.IdentifiabilityError, match="no log moves") as raised:
        identify(read_study(tmp_path / "drafted.toml"))
    assert raised.value.where == (read_device(device).joints[1].name,)
    assert "=0.3`" in str(raised.value)


def test_joints_that_tremble_while_others_move_are_refused_and_named(tmp_path: Path) -> None:
    """A joint that is held, and whose encoder flickers, set the filters: 117 Hz for a motion below 3 Hz."""
    small_study.write_study(tmp_path)
    log = small_study.columns(1)
    log["q2"] = 0.3 + 5e-4 * np.rint(np.random.default_rng(3).standard_normal(log["q2"].size))
    header, data = ",".join(log), np.column_stack([*log.values()])
    np.savetxt(tmp_path / "one.csv", data, delimiter=",", header=header, comments="")
    device = tmp_path / tomllib.loads(small_study.STUDY)["device"]
    text, _ = draft_study([tmp_path / "one.csv"], read_device(device), str(device), tmp_path)
    assert "q2 hardly move" in text
    (tmp_path / "drafted.toml").write_text(text)
    with pytest.raises(errors.IdentifiabilityError, match=r"no log moves .* others by") as raised:
        identify(read_study(tmp_path / "drafted.toml"))
    assert raised.value.where == (read_device(device).joints[1].name,)
    assert "no log moves" in check_study(tmp_path / "drafted.toml").problems[0]


def test_channels_that_move_are_those_of_a_device_with_fewer_joints(tmp_path: Path) -> None:
    """Of an arm's seven joints two move, and the device has two: the draft takes these, with torques and velocities."""
    small_study.write_study(tmp_path)
    log, rng = small_study.columns(1), np.random.default_rng(4)
    own = {1: "1", 3: "2"}
    made = {"t": log["t"]}
    for what, size in (("pos", 1e-4), ("vel", 1e-2), ("effort", 0.2)):
        for k in range(5):
            source = {"pos": "q", "vel": "q", "effort": "tau"}[what]
            moved = log[source + own[k]] if k in own else size * rng.standard_normal(log["t"].size)
            made[f"{what}[{k}]"] = np.gradient(moved, log["t"]) if what == "vel" and k in own else moved
    header, data = ",".join(made), np.column_stack([*made.values()])
    np.savetxt(tmp_path / "arm.csv", data, delimiter=",", header=header, comments="")
    device = tmp_path / "arm.toml"  # names that are no numbers of channels
    device.write_text(small_study.DEVICE.replace('name = "1"', 'name = "a"').replace('name = "2"', 'name = "b"'))
    text, _ = draft_study([tmp_path / "arm.csv"], read_device(device), str(device), tmp_path)
    channels = tomllib.loads(text)["channels"]
    assert [channels[key]["joints"] for key in ("position", "torque", "velocity")] == [[1, 3]] * 3
