"""What a user meets before any result: help, completion, `haptid check`, names that are misspelt."""

import io
import json
import os
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from haptid.cli import app
from haptid.cli.common import unwrapped
from haptid.errors import UnknownNameError, index_of
from haptid.report.tables import table
from json_outputs import valid
from small_study import columns, write_study

COMMANDS = tuple(typer.main.get_command(app).commands)


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "80", "TERMINAL_WIDTH": "80"})


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_at_most_80_wide_and_has_no_torn_paragraph(command):
    lines = call(command, "--help").stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert command in lines[1]


def test_a_paragraph_is_one_line_and_items_stay_apart():
    assert unwrapped("One\ntwo.\n\n- a: b\n  c\n- d\n") == "One two.\n\n- a: b c\n- d"


@pytest.mark.parametrize("name", [*sorted(set(COMMANDS) - {"friction"}), "friction study", "friction log"])
def test_every_command_can_print_json(name):
    assert "--json" in call(*name.split(), "--help").stdout


def test_lists_as_json():
    made = valid("completion", call("completion", "fish", "--json").stdout)
    assert made == {"shell": "fish", "script": call("completion", "fish").stdout}
    assert valid("schema", call("schema", "study", "--json").stdout) == json.loads(call("schema", "study").stdout)
    assert {entry["name"] for entry in valid("devices", call("devices", "--json").stdout)} >= {
        "phantom_premium_15",
        "emps",
    }
    assert [entry["name"] for entry in valid("demo", call("demo", "--json").stdout)] == ["medical", "phantom"]


def completed(words: str, shell: str = "bash") -> list[str]:
    """What a shell is offered after these words, the last of them begun."""
    asked = {"_HAPTID_COMPLETE": f"complete_{shell}", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    asked |= {"_TYPER_COMPLETE_ARGS": words, "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    program = [sys.executable, "-c", "from haptid.cli import main; main()"]
    return subprocess.run(
        program, env={**os.environ, **asked}, capture_output=True, text=True, check=True
    ).stdout.split()


def test_shells_complete_commands_devices_and_formats():
    assert completed("haptid ident") == ["identify"]
    assert completed("haptid model emp", "fish") == ["emps"]
    assert {"c", "mjcf"} <= set(completed("haptid export folder --to "))
    for shell in ("bash", "zsh", "fish"):
        assert "_HAPTID_COMPLETE" in call("completion", shell).stdout
    assert call("completion", "tcsh").exit_code == 2


@pytest.mark.parametrize(
    ("words", "meant"),
    [(("identfy",), "identify"), (("schema", "stuyd"), "study"), (("model", "staubli_tx4"), "staubli_tx40")],
)
def test_a_misspelt_name_brings_the_one_meant(words, meant):
    done = call(*words)
    assert done.exit_code == 2
    assert f"Did you mean {meant!r}" in done.stderr.replace('"', "'")


def test_a_value_looked_up_by_a_wrong_name_says_which_there_are():
    with pytest.raises(UnknownNameError, match=r"no target 'mas'\. Did you mean .mass."):
        index_of("mas", ("mass", "length"), "target")


def test_check_reads_all_and_says_what_would_be_done(tmp_path):
    path = write_study(tmp_path)
    done = call("check", path, "--json")
    assert done.exit_code == 0, done.output
    found = valid("check", done.stdout)
    assert [log["role"] for log in found["logs"]] == ["identify", "validate"]
    assert found["problems"] == []
    assert "10 base parameters" in found["steps"][0]
    assert "check.csv" in found["steps"][1]
    assert not any("Time blocks" in step for step in found["steps"])
    path.write_text(path.read_text().replace("decimation = 5", "decimation = 5\nblock_s = 17"))
    assert "s long and not 17 s" in call("check", path, "--json").stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["check.csv", "device.toml", "log.csv", "study.toml"]


def test_check_names_every_problem_not_the_first_alone(tmp_path):
    path = write_study(tmp_path)
    broken = columns(1)
    broken["tau2"][7] = np.nan
    pyarrow.csv.write_csv(pa.table(broken), tmp_path / "log.csv")
    (tmp_path / "check.csv").unlink()
    done = call("check", path)
    assert done.exit_code == 2
    assert "tau2" in done.stdout
    assert "check.csv" in done.stdout.partition("To be changed first")[2]
    (tmp_path / "device.toml").write_text("name = 'x'\n")
    assert "device.toml" in call("check", path).stdout


def test_a_narrow_terminal_breaks_cells_and_keeps_every_column():
    cells = ["ZZ1R_of_a_long_link", "0.123456", "0.123456 .. 0.234567", "12.5", "3.4", "N m s^2/rad^2"]
    made = table("", ("", "value", "95 % interval", "std err %", "classical %", "unit"), [(cells, False)], ("unit",))
    printed = io.StringIO()
    Console(width=60, file=printed).print(made)
    assert {"unit", "12.5", "3.4"} <= set(printed.getvalue().split())
    assert "s^2" in printed.getvalue()
