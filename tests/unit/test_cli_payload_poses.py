"""`haptid payload` and `haptid poses`, as a user types them."""

import csv
import json

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.device.priors import PriorBody
from held_poses import held_log, rigid_beta
from json_outputs import valid
from true_parameters import true_parameters

HEAD = """
schema = 1
name = "arm"
device = "arm3"
[channels]
time = "t"
position = { channels = ["q1", "q2", "q3"], unit = "rad" }
torque = { channels = ["tau1", "tau2", "tau3"], unit = "N m" }
[poses]
"""
BARE = '[[logs]]\npath = "bare.csv"\n'
WEIGHT = PriorBody(0.5, np.array([0.2, 0.03, 0.01]), None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Logs of poses without and with the weight."""
    made = tmp_path_factory.mktemp("poses")
    arm = haptid.DynamicModel(haptid.read_device("arm3"))
    beta = rigid_beta(arm, true_parameters(arm, FV=0.05, FC=0.0))
    heavy = beta + haptid.observation.payload_torque(arm, "3", WEIGHT)
    for name, own, seed in (("bare", beta, 1), ("loaded", heavy, 2)):
        log = held_log(arm, own, seed, points=2)
        columns = {"t": log.t} | {f"q{k + 1}": log.position[:, k] for k in range(3)}
        columns |= {f"tau{k + 1}": log.torque[:, k] for k in range(3)}
        pyarrow.csv.write_csv(pa.table(columns), made / f"{name}.csv")
    return made


def call(folder, command, text, *arguments):
    (folder / "study.toml").write_text(text)
    out = folder / "out"
    done = CliRunner().invoke(app, [command, str(folder / "study.toml"), "--out", str(out), *arguments])
    return done, out


def loaded(keys):
    return f'{HEAD}{BARE}[[logs]]\npath = "loaded.csv"\npayload = {{ link = "3", {keys} }}\n'


@pytest.mark.parametrize("command", ["payload", "poses"])
def test_help_says_what_goes_in_and_what_comes_out(command):
    text = CliRunner().invoke(app, [command, "--help"]).stdout
    for part in ("--out", "Exit status", "Example"):
        assert part in text


def test_an_unknown_payload(folder):
    done, out = call(folder, "payload", loaded('name = "weight"'))
    assert done.exit_code == 0, done.output
    (found,) = valid("payload", (out / "payload.json").read_text())["payloads"]
    assert (found["name"], found["link"]) == ("weight", "3")
    mass = found["body"][0]
    assert mass["name"] == "mass"
    assert mass["conf_int"][0] < 0.5 < mass["conf_int"][1]
    assert "do not determine the inertia" in found["left_out"][0]
    assert "Payload weight on link 3" in done.stdout
    with (out / "payload.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["value"]) == mass["value"]


def test_gains_of_a_known_mass_as_json(folder):
    done, _ = call(folder, "payload", loaded("mass = 0.5"), "--gains", "--json")
    assert done.exit_code == 0, done.output
    gains = valid("payload", done.stdout)["gains"]
    assert [one["name"] for one in gains["motors"]] == ["motor 2", "motor 3"]
    assert all(one["conf_int"][0] < one["value"] < one["conf_int"][1] for one in gains["motors"])
    assert "motor 1" in gains["left_out"][0]


def test_poses_and_their_table(folder):
    done, out = call(folder, "poses", HEAD + BARE)
    assert done.exit_code == 0, done.output
    assert "Gravity compensation is worth it" in done.stdout
    first = valid("poses", (out / "static.json").read_text())
    assert {one["motor"]: one["verdict"] for one in first["gravity"]}["motor 2"] == "worth it"
    table = HEAD.replace('time = "t"\n', "") + 'table = true\napproach = ["approach1", "approach2", "approach3"]\n'
    done, out = call(folder, "poses", table + BARE.replace("bare.csv", "out/poses.csv"), "--quiet")
    assert done.exit_code == 0, done.output
    second = json.loads((out / "static.json").read_text())
    for one, other in zip(first["parameters"], second["parameters"], strict=True):
        assert one["name"] == other["name"]
        assert one["value"] == pytest.approx(other["value"], rel=1e-6)


@pytest.mark.parametrize(
    ("command", "text", "sentence"),
    [
        ("payload", HEAD + BARE, "no log has a payload"),
        ("payload", loaded('link = "9"').replace('link = "3", ', ""), "no link '9'"),
        ("payload", loaded("inertia = [0, 0, 1, 0, 0, 0]"), "inertia is given"),
        ("poses", (HEAD + BARE).replace("[poses]\n", ""), "missing"),
        ("poses", HEAD + 'approach = ["x"]\n' + BARE, "only a table"),
        ("poses", HEAD + "table = true\n" + BARE, "neither `time` nor `rate_hz`"),
        ("poses", HEAD + "settle_s = 3.0\n" + BARE, "settle_s"),
        ("identify", HEAD + BARE, "haptid poses"),
        ("identify", loaded("mass = 0.5").replace("[poses]\n", ""), "haptid payload"),
    ],
)
def test_what_cannot_be_is_refused(folder, command, text, sentence):
    done, _ = call(folder, command, text)
    assert done.exit_code == 2, done.output
    assert sentence in done.stderr
