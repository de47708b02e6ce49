"""Experiments as files, as commands, and the logs and the truth that they leave."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.experiment import bench
from json_outputs import valid

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
DEVICES = {"phantom": "phantom_premium_15", "cea": "cea_medical_branch"}
SHORT = """
schema = 1
name = "short"
seed = 5
[trajectory]
kind = "multisine"
seconds = 1.0
ramp = 0.3
centre = [0.0, 0.2, 0.3]
amplitude = 0.2
[controller]
kp = [40.0, 35.0, 14.0]
kd = [0.5, 0.4, 0.16]
[encoders]
counts_per_turn = 4000.0
gear = [13.3, 11.2, 11.2]
[amplifiers]
noise = 5e-4
delay = 5e-4
[payload]
mass = 0.02
[[hand]]
force = [0.2, 0.0, 0.1]
frequency_hz = 1.0
[sensor]
force_noise = 0.01
moment_noise = 1e-4
[parameters]
FC1 = 0.02
FV1 = 5e-4
"""


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    folder = tmp_path_factory.mktemp("short")
    (folder / "short.toml").write_text(SHORT)
    done = call("bench", "phantom_premium_15", folder / "short.toml", "--out", folder / "log.parquet", "--truth")
    assert done.exit_code == 0, done.output
    return folder, done


def test_help_says_what_goes_in_and_what_comes_out():
    text = call("bench", "--help").stdout
    for part in ("device", "EXPERIMENT", "--out", "--truth", "--seed", "Exit status", "Example", "command1"):
        assert part in text


def test_command_says_where_the_log_is(short):
    folder, done = short
    assert "log.parquet" in done.stdout.replace("\n", "")
    assert sorted(path.name for path in folder.iterdir()) == [
        "log.parquet", "log.truth.json", "log.truth.parquet", "short.toml",
    ]  # fmt: skip


def test_log_has_units_and_everything_that_made_it(short):
    folder, _ = short
    schema = parquet.read_schema(folder / "log.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert units["t"] == "s"
    assert units["q3"] == "rad"
    assert units["command1"] == "N m"
    assert units["velocity2"] == "rad/s"
    assert units["force_x"] == "N"
    assert units["moment_z"] == "N m"
    about = json.loads(schema.metadata[b"haptid"])
    assert about["seed"] == 5
    assert about["device"] == "PHANToM Premium 1.5"
    assert about["experiment"]["payload"]["mass"] == 0.02
    assert {"haptid", "mujoco"} <= set(about)


def test_log_is_read_like_any_other(short):
    folder, _ = short
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2", "q3"), "rad"),
        haptid.Signal(("command1", "command2", "command3"), "N m", side="motor"),
        time="t",
    )
    log = haptid.read_log(folder / "log.parquet", channels)
    assert len(log.t) == 1001
    assert log.rate_hz == pytest.approx(1000)


def test_truth_has_parameters_and_exact_states(short):
    folder, _ = short
    truth = json.loads((folder / "log.truth.json").read_text())
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    assert list(truth["base"]) == list(model.base.names)
    assert truth["standard"]["FC1"] == 0.02
    assert truth["base"]["ZZbaR"] == pytest.approx(0.0043559, rel=1e-4)
    assert truth["widest_gap"] < 1e-9
    states, log = (parquet.read_table(folder / name).to_pydict() for name in ("log.truth.parquet", "log.parquet"))
    step = 2 * np.pi / (4000 * 13.3)
    assert np.abs(np.array(states["q_ba"]) - log["q1"]).max() <= 0.5001 * step
    assert np.abs(np.array(states["q_a"]) - (np.array(states["q_df"]) - states["q_be"])).max() < 1e-8
    assert set(states) >= {"qd_c", "qdd_c", "torque_3", "hand_z"}


def test_one_seed_gives_one_file_and_another_seed_another(short, tmp_path):
    folder, _ = short
    for name, seed in (("same", ()), ("other", ("--seed", "6"))):
        out = tmp_path / f"{name}.parquet"
        done = call("bench", "phantom_premium_15", folder / "short.toml", "--out", out, "--truth", "-q", *seed)
        assert (done.exit_code, done.stdout) == (0, "")
    first = (folder / "log.parquet").read_bytes()
    assert (tmp_path / "same.parquet").read_bytes() == first
    assert (tmp_path / "other.parquet").read_bytes() != first
    assert (tmp_path / "same.truth.parquet").read_bytes() == (folder / "log.truth.parquet").read_bytes()


def test_many_logs_are_those_made_one_by_one(short, tmp_path):
    folder, _ = short
    jobs = [
        bench.Job("phantom_premium_15", folder / "short.toml", tmp_path / f"{seed}.parquet", seed=seed)
        for seed in (5, 6)
    ]
    told = []
    made = bench.make_logs(
        jobs, workers=haptid.executors.SerialExecutor(), progress=lambda path, share: told.append((path, share))
    )
    assert made == (tmp_path / "5.parquet", tmp_path / "6.parquet")
    assert {path for path, _ in told} == set(made)
    assert told[-1][1] == 1.0
    assert made[0].read_bytes() == (folder / "log.parquet").read_bytes()


@pytest.mark.parametrize("name", DEVICES)
def test_shipped_experiments_can_be_planned(name):
    model = haptid.DynamicModel(haptid.read_device(DEVICES[name]))
    experiment = bench.read_experiment(EXAMPLES / name / "experiment.toml")
    setup = experiment.setup(model)
    for seed in range(3):
        trajectory = bench.plan(experiment.kind, model, setup.dt, np.random.default_rng(seed))
        bench.check_trajectory(model, trajectory, setup.chi)
        assert len(bench.mjcf(model, setup.chi)) > 1000


TRAJECTORIES = [
    'kind = "triangles"\nseconds = 4.0\ncentre = 0.1\namplitude = 0.2\nfrequency_hz = 0.3',
    'kind = "triangles"\nseconds = 4.0\ncentre = 0.1\namplitude = 0.2\nfrequency_hz = 0.3\nsines = { amplitude = 0.1 }',
    'kind = "sweep"\ncentre = 0.1\namplitude = 0.2\nspeeds = [0.1, 0.5]',
    'kind = "grid"\ncentre = 0.1\namplitude = 0.2\npoints = 2',
]


@pytest.mark.parametrize("text", TRAJECTORIES)
def test_every_kind_of_motion_can_be_written_down(text, tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(changed(text))
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    trajectory = bench.plan(bench.read_experiment(path).kind, model, 1e-2, np.random.default_rng(0))
    assert np.abs(trajectory.q[0] - 0.1).max() < 0.21


def changed(trajectory):
    head, _, rest = SHORT.partition("[trajectory]")
    return head + "[trajectory]\n" + trajectory + "\n[controller]" + rest.partition("[controller]")[2]


def test_schema_knows_every_table():
    schema = json.loads(call("schema", "experiment").stdout)
    assert schema == bench.experiment_schema()
    assert set(tomllib.loads(SHORT)) <= set(schema["properties"])


@pytest.mark.parametrize(
    ("before", "after", "where"),
    [
        ("kp =", "kq =", "controller.kq.*Keys here: kp, kd"),
        ("seed = 5", "seed = -1", "seed"),
        ("seed = 5", "seeds = 5", "seeds"),
        ("seconds = 1.0", "seconds = 0.0", "trajectory.seconds"),
        ("schema = 1", "schema = 2", "schema"),
        ("ramp = 0.3", "frequencies_hz = [5.0, 1.0]", "trajectory.frequencies_hz.*lowest, 5 Hz, is above"),
        ("ramp = 0.3", "frequencies_hz = [5.0, 480.0]", "not below the Nyquist frequency 500 Hz"),
        ("frequency_hz = 1.0", "start = 2.0\nstop = 1.0", "hand.0.stop.*not after start"),
        ('kind = "multisine"', "", 'trajectory.kind`: this key is missing; write one of "multisine"'),
        ('"multisine"', '"sine"', "trajectory.kind`: there is no kind 'sine'; write one of"),
        ("schema = 1", "schema = ", "Invalid value"),
    ],
)
def test_keys_that_are_wrong_are_named(before, after, where, tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(SHORT.replace(before, after))
    with pytest.raises(errors.ExperimentFileError, match=where):
        bench.read_experiment(path)
    with pytest.raises(errors.ExperimentFileError, match="no such file"):
        bench.read_experiment(tmp_path / "absent.toml")


@pytest.mark.parametrize(
    "more",
    [
        "\nFD1 = 0.1",
        '\n[[bodies]]\nlink = "a"\nmass = 1.0\ncom = [0.0, 0.1, 0.0]\ninertia = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]',
    ],
)
def test_true_parameters_that_the_device_does_not_have_are_rejected(more, tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(SHORT + more)
    with pytest.raises(errors.UnknownNameError, match="no free parameter"):
        bench.read_experiment(path).setup(haptid.DynamicModel(haptid.read_device("phantom_premium_15")))


@pytest.mark.parametrize("table", ["bodies", "weights"])
def test_masses_on_links_that_the_device_does_not_have_are_rejected(table, tmp_path):
    path, model = tmp_path / "experiment.toml", haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    inertia = "\ninertia = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]" if table == "bodies" else ""
    for link in ("zz", "base"):
        path.write_text(f'{SHORT}\n[[{table}]]\nlink = "{link}"\nmass = 1.0\ncom = [0.0, 0.0, 0.0]{inertia}')
        with pytest.raises(errors.UnknownNameError, match=rf"\[\[{table}\]\]") as raised:
            bench.read_experiment(path).setup(model)
        assert raised.value.where == link
        assert raised.value.limit == model.device.joint_names


def test_a_run_that_fails_leaves_nothing_and_says_what_to_do(tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(SHORT.replace("amplitude = 0.2", "amplitude = 2.0"))
    done = call("bench", "phantom_premium_15", path, "--out", tmp_path / "log.parquet")
    assert done.exit_code == 2
    assert "lower the amplitude" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["experiment.toml"]
    path.write_text(SHORT)
    done = call("bench", "phantom_premium_15", path, "--out", tmp_path / "log.csv")
    assert done.exit_code == 2
    assert ".parquet" in done.stderr


def test_weights_and_mounting_are_part_of_the_truth(tmp_path):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    mounted = SHORT + '[[weights]]\nlink = "a"\nmass = 0.03\ncom = [0.17, 0.0, 0.0]\n'
    mounted = mounted.replace("[trajectory]", "gravity = [0.0, 9.81, 0.0]\n[trajectory]")
    for name, text in (("plain", SHORT), ("mounted", mounted)):
        (tmp_path / f"{name}.toml").write_text(text)
    plain, other = (bench.read_experiment(tmp_path / f"{n}.toml").setup(model) for n in ("plain", "mounted"))
    added = dict(zip(model.device.parameters.names, other.chi - plain.chi, strict=True))
    wanted = {"Ma": 0.03, "MXa": 0.03 * 0.17, "YYa": 0.03 * 0.17**2, "ZZa": 0.03 * 0.17**2}
    for name, value in added.items():
        assert value == pytest.approx(wanted.get(name, 0.0), abs=1e-15), name
    np.testing.assert_array_equal(other.model.device.gravity, [0.0, 9.81, 0.0])
    (tmp_path / "off.toml").write_text(mounted.replace("[0.17, 0.0, 0.0]", "[0.17, 0.01, 0.0]"))
    with pytest.raises(errors.UnknownNameError) as raised:
        bench.read_experiment(tmp_path / "off.toml").setup(model)
    assert raised.value.where == "XYa"


def test_many_logs_at_a_time_are_those_of_their_seeds(tmp_path):
    (tmp_path / "short.toml").write_text(SHORT)
    out = tmp_path / "log.parquet"
    many = ("--count", 2, "--picture", "--workers", 1, "--json")
    done = call("bench", "phantom_premium_15", tmp_path / "short.toml", "--out", out, *many)
    assert done.exit_code == 0, done.output
    first, second = valid("bench", done.stdout)
    assert (first["log"], second["log"]) == tuple(str(tmp_path / f"log-{k}.parquet") for k in (1, 2))
    made = sorted(path.name for path in tmp_path.glob("*.parquet"))
    assert made == ["log-1.parquet", "log-2.parquet"]
    assert all((tmp_path / f"log-{k}.png").read_bytes().startswith(b"\x89PNG") for k in (1, 2))
    alone = tmp_path / "alone.parquet"
    assert call("bench", "phantom_premium_15", tmp_path / "short.toml", "--out", alone, "--seed", 6).exit_code == 0
    assert alone.read_bytes() == (tmp_path / "log-2.parquet").read_bytes()
