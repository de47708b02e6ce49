"""What --json prints is valid by the schema of its command, for every command; `tests/json_outputs.py` holds it there
and in the tests of the commands themselves."""

import json
import re
import sys
from types import SimpleNamespace

import pytest
import typer
from typer.testing import CliRunner

from haptid.cli import app
from haptid.cli.outputs import output_text
from json_outputs import valid
from small_study import write_study

COMMANDS = tuple(typer.main.get_command(app).commands)
HANDLE = '[handle]\nlink = "2"\nxyz = [0.22, 0, 0]\n'


def printed(command, *arguments):
    done = CliRunner().invoke(app, [command, *map(str, arguments), "--json"])
    assert done.exit_code == 0, done.output
    return valid(command, done.stdout)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study with a handle, and its result."""
    made = tmp_path_factory.mktemp("study")
    study = write_study(made)
    with (made / "device.toml").open("a") as file:
        file.write(HANDLE)
    assert printed("identify", study, "--out", made / "result")["study"] == "two links"
    return made


def test_of_a_study(folder):
    assert printed("check", folder / "study.toml")["problems"] == []
    (topic,) = printed("channels", folder / "log.csv")["topics"]
    assert [one["quantity"] for one in topic["channels"]] == ["time", "position", "position", "torque", "torque"]


def test_of_a_result(folder, tmp_path):
    result = folder / "result"
    assert printed("report", result, "--out", tmp_path / "page.html")["pairs"] == []
    (pair,) = printed("report", result, result, "--out", tmp_path / "both.html")["pairs"]
    assert not any(row["differs"] for row in pair["rows"])
    made = printed("export", result, "--to", "json", "--force", "--out", tmp_path / "model")
    assert list(made["formats"]) == ["json"]
    found = printed("characterise", result, "--at", "0.1,1.2", "--out", tmp_path / "handle")
    assert found["poses"] == {"1": [0.1], "2": [1.2]}
    assert all(len(one["values"]) == 1 for one in found["figures"])
    (sheet,) = printed("datasheet", result, "--poses", 9, "--out", tmp_path / "sheet.html").values()
    assert {"group", "value", "conf_int"} <= set(sheet[0])


def test_of_a_device(tmp_path, request):
    new = printed("redesign", "phantom_premium_15", "--poses", 30, "--out", tmp_path / "redesign.html")
    assert new["front"][0]["mass"] < new["present"]["mass"]
    assert printed("model", "emps")["base_parameters"]
    arm = request.config.rootpath / "examples" / "robots" / "arm.urdf"
    assert printed("import", arm, "--out", tmp_path / "arm.toml")["format"] == "urdf"
    planned = printed(
        "excite",
        "emps",
        "--centre",
        0,
        "--stroke",
        0.1,
        "--speed",
        0.4,
        "--max-evaluations",
        4,
        "--out",
        tmp_path / "motion.toml",
    )
    assert planned["condition"]["scaled"] >= 1


def test_the_workbench_prints_where_it_listens(tmp_path, monkeypatch):
    """In place of a server, one that is ready at once."""

    def serve(*given, **_):
        given[2]("http://127.0.0.1:1/?token=x")

    monkeypatch.setitem(sys.modules, "haptid.app.server", SimpleNamespace(serve=serve))
    assert printed("app", tmp_path, "--no-browser")["folder"] == str(tmp_path)


def test_every_command_is_held_to_its_schema_somewhere(request):
    """By its name in a call of `valid`, or of `printed` here."""
    texts = [path.read_text(encoding="utf-8") for path in (request.config.rootpath / "tests").rglob("test_*.py")]
    held = {name for text in texts for name in re.findall(r'\b(?:valid|printed)\("(\w+)"', text)}
    assert held == set(COMMANDS)


def test_an_entry_without_a_schema_is_a_defect():
    with pytest.raises(ValueError, match="more"):
        output_text("completion", {"shell": "fish", "script": "", "more": 1})
    assert json.loads(output_text("characterise", {"device": "a", "poses": {}, "notes": (), "figures": [
        {"name": "b", "unit": "kg", "values": [float("nan")], "conf_int": None}
    ]}))["figures"][0]["values"] == [None]  # fmt: skip
