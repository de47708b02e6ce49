"""The [controller] table of a study, through the command line."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import haptid
from haptid import estimation
from haptid.cli import app
from haptid.errors import StudyFileError
from small_study import DEVICE, FRICTION, between, driven, log_of, two_links
from true_parameters import true_parameters

STUDY = """
schema = 1
name = "two links"
device = "device.toml"
[channels]
time = "t"
position = { channels = ["q1", "q2"], unit = "rad" }
torque = { channels = ["command1", "command2"], unit = "N m", side = "motor" }
[[logs]]
path = "log.parquet"
[validation]
cross_validation = "blocks"
[treatment]
cutoff_hz = 30
decimation = 5
torque_delay_s = 1e-3
"""
CONTROLLER = """
[controller]
kp = [60.0, 30.0]
kd = [4.0, 2.0]
velocity_cutoff_hz = 100
reference = { channels = ["target1", "target2"], unit = "rad" }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Device and a log of the bench, with what was planned."""
    path = tmp_path_factory.mktemp("loop")
    (path / "device.toml").write_text(DEVICE)
    made = driven(1, 6.0, rate_hz=500.0)
    log, target = log_of(made), made.target[between(made)]
    columns = {"t": log.t}
    for name, values in (("q", log.position), ("command", log.torque), ("target", target)):
        columns |= {f"{name}{k + 1}": values[:, k] for k in (0, 1)}
    pq.write_table(pa.table(columns), path / "log.parquet")
    return path


def written(folder, text):
    path = folder / "study.toml"
    path.write_text(STUDY + text)
    return path


def method(name):
    return f'[estimate]\nmethod = "{name}"\n'


@pytest.mark.parametrize("name", ["iv", "output-error"])
def test_the_command_identifies_with_it(folder, tmp_path, name):
    path = written(folder, CONTROLLER + method(name))
    ran = CliRunner().invoke(app, ["identify", str(path), "--out", str(tmp_path / "out"), "--quiet", "--no-report"])
    assert ran.exit_code == 0, ran.output
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    assert found["estimate"]["method"] == name
    beta = two_links().base.of(true_parameters(two_links(), **FRICTION))
    value = np.array([p["value"] for p in found["estimate"]["parameters"]])
    se = np.array([p["se"] for p in found["estimate"]["parameters"]])
    assert (np.abs(value - beta) < 5 * se).all()


def test_every_key_reaches_the_controller(folder):
    more = "ki = 1.0\nrate_hz = 1000\nsaturation = [5.0, 3.0]\n"
    study = haptid.read_study(written(folder, CONTROLLER + more + method("didim")))
    law = study.controller
    assert isinstance(study.method, estimation.DIDIM)
    assert study.method.controller is law
    assert (law.kp, law.kd, law.ki, law.rate_hz, law.saturation) == ((60.0, 30.0), (4.0, 2.0), 1.0, 1000.0, (5.0, 3.0))
    assert law.velocity_cutoff_hz == 100.0
    assert law.reference.channels == ("target1", "target2")
    held = haptid.read_study(written(folder, CONTROLLER + method("iv") + 'constraints = "physical"\n'))
    assert isinstance(held.method, haptid.PhysicallyConsistent)


def test_every_method_has_a_name(folder):
    for name in ("iv", "didim", "clie", "cloe", "output-error", "ekf", "ukf"):
        kind = getattr(estimation, {"output-error": "OutputErrorMethod"}.get(name, name.upper()))
        assert isinstance(haptid.read_study(written(folder, CONTROLLER + method(name))).method, kind)


def test_without_it_the_study_says_so(folder):
    for name in ("iv", "didim", "clie", "cloe"):
        with pytest.raises(StudyFileError, match=rf"{name} simulates .* \[controller\]"):
            haptid.read_study(written(folder, method(name)))
    ran = CliRunner().invoke(app, ["identify", str(written(folder, method("iv"))), "--out", str(folder / "out")])
    assert ran.exit_code == 2
    assert haptid.read_study(written(folder, method("output-error"))).controller is None


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("[controller]\nkp = 1.0\n", "controller.kd"),
        (CONTROLLER + "gain = 1.0\n", "controller.gain"),
        (CONTROLLER.replace('"target2"]', '"target2"], gain = [1.0]'), r"controller\.reference\.gain"),
        (CONTROLLER.replace("100", "-1"), r"controller\.velocity_cutoff_hz"),
    ],
)
def test_a_wrong_key_is_named(folder, text, where):
    with pytest.raises(StudyFileError, match=where):
        haptid.read_study(written(folder, text + method("iv")))
