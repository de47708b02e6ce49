"""`haptid excite`, `haptid friction` and `haptid eliminate`, as a user types them."""

import csv
import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.experiment import bench
from json_outputs import valid
from motions import truth

DEVICE = "phantom_premium_15"
EXAMPLE = Path("examples") / "phantom" / "experiment.toml"
WITHIN = ("--centre", "0,0.2,0.3", "--stroke", "0.6,0.4,0.4", "--speed", "3")


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.mark.parametrize("command", ["excite", "friction", "eliminate"])
def test_help_says_what_goes_in_and_what_comes_out(command):
    text = call(command, "--help").stdout
    for part in ("--out", "Exit status", "Example"):
        assert part in text


def test_the_experiment_is_one_that_the_bench_takes(tmp_path):
    out = tmp_path / "excite.toml"
    done = call("excite", DEVICE, *WITHIN, "--max-evaluations", 12, "--out", out, "--rate-hz", 100)
    assert done.exit_code == 0, done.output
    assert "with unit columns" in done.stdout
    model, experiment = haptid.DynamicModel(haptid.read_device(DEVICE)), bench.read_experiment(out)
    setup = experiment.setup(model)
    assert min(setup.controller.kp) > 0
    with out.with_suffix(".csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["t", *(f"{prefix}{name}" for prefix in ("q", "qd", "qdd") for name in ("ba", "be", "df"))]
    values = np.array(rows[1:], dtype=float)
    assert values[1, 0] == pytest.approx(0.01)
    assert (np.abs(values[:, 1:4] - [0.0, 0.2, 0.3]) <= np.array([0.6, 0.4, 0.4]) * (1 + 1e-9)).all()
    np.testing.assert_allclose(np.gradient(values[:, 1], 0.01)[1:-1], values[1:-1, 4], atol=2e-2)


def test_motions_from_a_pose_are_written_for_controllers(tmp_path):
    out, header = tmp_path / "excite.toml", tmp_path / "motion.h"
    options = ("--start", "0,0.2,0.3", "--rehearsal", 0.2, "--samples", header, "--torque", 1, "--rate-hz", 50)
    done = call("excite", DEVICE, *WITHIN, *options, "--max-evaluations", 12, "--out", out)
    assert done.exit_code == 0, done.output
    tables = (tmp_path / name for name in ("excite.csv", "excite-rehearsal.csv"))
    plan, slow = (np.loadtxt(table, delimiter=",", skiprows=1) for table in tables)
    np.testing.assert_allclose(plan[[0, -1], 1:4], [[0.0, 0.2, 0.3]] * 2, atol=1e-12)
    np.testing.assert_allclose(slow[::5, 1:4], plan[:, 1:4], atol=1e-12)
    assert "static const double motion_q[" in header.read_text()
    wrong = call("excite", DEVICE, *WITHIN, "--samples", tmp_path / "motion.xls", "--out", out)
    assert wrong.exit_code == 2
    assert ".yaml" in wrong.stderr
    both = call("excite", DEVICE, *WITHIN, "--triangles", "--start", "0,0.2,0.3", "--out", out)
    assert both.exit_code == 2
    assert "--triangles" in both.stderr


def test_a_world_without_shapes_on_the_device_is_refused(tmp_path):
    world = tmp_path / "world.toml"
    world.write_text('[[collision]]\nkind = "sphere"\nradius = 0.1\n')
    done = call("excite", DEVICE, *WITHIN, "--world", world, "--out", tmp_path / "excite.toml")
    assert done.exit_code == 2
    assert "has no collision shapes on its links" in done.stderr
    world.write_text('[[collision]]\nkind = "sphere"\n')
    done = call("excite", DEVICE, *WITHIN, "--world", world, "--out", tmp_path / "excite.toml")
    assert done.exit_code == 2
    assert "radius" in done.stderr


def test_an_experiment_like_another_keeps_its_controller(tmp_path, request):
    like, out = request.config.rootpath / EXAMPLE, tmp_path / "excite.toml"
    done = call(
        "excite", DEVICE, "--like", like, *WITHIN, "--triangles", "--seconds", 6, "--max-evaluations", 6, "--out", out
    )
    assert done.exit_code in (0, 2), done.output
    if done.exit_code == 0:
        assert bench.read_experiment(out).table.controller == bench.read_experiment(like).table.controller
    else:  # so few tries may not meet a motion within the limits, and then say so
        assert "within" in done.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--out", "x.txt"), ".toml"),
        (("--out", "x.toml", "--stroke", "1"), "both"),
        (("--out", "x.toml", "--speed", "1,2"), "3 numbers"),
        (("--out", "x.toml", "--parameter", "ZZ99", *WITHIN), "ZZ99"),
    ],
)
def test_what_cannot_be_searched_is_one_line(options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call("excite", DEVICE, *options)
    assert done.exit_code == 2
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A friction test of known friction, as a log with torques at the joints, and the true base parameters."""
    model = haptid.DynamicModel(haptid.read_device(DEVICE))
    beta = truth(model)
    speeds = (0.05, 0.1, 0.2, 0.4, 0.7)
    made = bench.plan(bench.Sweep((0.0, 0.2, 0.3), (0.5, 0.35, 0.35), speeds, ramp=0.3), model, 2e-3, None)
    tau = haptid.inverse_dynamics(model, beta, made.q.T, made.qd.T, made.qdd.T)
    tau = tau + 2e-4 * np.random.default_rng(1).standard_normal(tau.shape)
    folder = tmp_path_factory.mktemp("swept")
    columns = np.column_stack([made.t, made.q, tau.T])
    head = "t,q1,q2,q3,tau1,tau2,tau3"
    np.savetxt(folder / "sweep.csv", columns, delimiter=",", header=head, comments="", fmt="%.12g")
    return folder, dict(zip(model.base.names, beta.tolist(), strict=True))


@pytest.mark.usefixtures("full_pictures")
def test_friction_of_a_log_is_printed_and_drawn(swept, tmp_path):
    folder, true = swept
    done = call("friction", "log", DEVICE, folder / "sweep.csv", "--out", tmp_path / "f")
    assert done.exit_code == 0, done.output
    assert done.stdout.count("are sufficient") == 3
    found = valid("friction", (tmp_path / "f" / "friction.json").read_text())
    assert found["viscous_and_coulomb_are_enough"] is True
    for joint in found["joints"]:
        chosen = next(other_model for other_model in joint["models"] if other_model["model"] == joint["chosen"])
        assert chosen["values"]["FC"] == pytest.approx(true[f"FC{joint['joint'][-1]}"], rel=0.05)
    with (tmp_path / "f" / "friction.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["joint"] for row in rows} == {"motor 1", "motor 2", "motor 3"}
    assert all(float(row["ci_low"]) <= float(row["torque"]) <= float(row["ci_high"]) for row in rows)
    assert (tmp_path / "f" / "friction.png").stat().st_size > 10_000


def test_friction_of_a_study_is_the_same(swept, tmp_path):
    folder, _ = swept
    study = tmp_path / "study.toml"
    study.write_text(
        f'schema = 1\nname = "test"\ndevice = "{DEVICE}"\n[[logs]]\npath = "sweep.csv"\n[channels]\ntime = "t"\n'
        'position = { channels = ["q1", "q2", "q3"], unit = "rad" }\n'
        'torque = { channels = ["tau1", "tau2", "tau3"], unit = "N m", side = "joint" }\n'
    )
    done = call("friction", "study", study, "--data", folder, "--out", tmp_path / "s", "--quiet")
    assert done.exit_code == 0, done.output
    assert done.stdout == ""
    assert json.loads((tmp_path / "s" / "friction.json").read_text())["viscous_and_coulomb_are_enough"]


def test_a_log_without_constant_velocities_is_one_line(tmp_path, request):
    runpy.run_path(str(request.config.rootpath / "examples" / "phantom" / "make_logs.py"))["main"](tmp_path)
    study = request.config.rootpath / "examples" / "phantom" / "study.toml"
    done = call("friction", "study", study, "--data", tmp_path, "--out", tmp_path / "none")
    assert done.exit_code == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "none").exists()
    done = call("eliminate", study, "--data", tmp_path, "--max-relative-std", 20, "--by-motor", "--out", tmp_path / "e")
    assert done.exit_code == 0, done.output
    found = valid("eliminate", (tmp_path / "e" / "elimination.json").read_text())
    assert set(found) == {"all motors", "motor 1", "motor 2", "motor 3"}
    whole = found["all motors"]
    assert len(whole["essential"]) + len(whole["eliminated"]) == whole["parameters"] == 14
    assert set(whole["error_percent"]) == {"fit", "unseen"}
    assert "essential" in done.stdout


def test_a_parameter_that_is_to_be_kept_is():
    plain = valid("model", call("model", "five_bar", "--json").stdout)
    kept = json.loads(call("model", "five_bar", "--keep", "MX4", "--json").stdout)
    assert "MX4R" not in {p["name"] for p in plain["base_parameters"]}
    assert {p["name"] for p in kept["base_parameters"]} & {"MX4", "MX4R"}
    assert len(kept["base_parameters"]) == len(plain["base_parameters"])
    done = call("model", "five_bar", "--keep", "ZZ9")
    assert done.exit_code == 2
    assert "ZZ9" in done.stderr


def test_regroupings_as_latex():
    text = call("model", "five_bar", "--latex").stdout
    assert text.splitlines()[0].startswith("ZZ_{1R} = ZZ_{1}")
    assert r"\frac" in text
