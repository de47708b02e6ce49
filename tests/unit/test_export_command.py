"""`haptid export`: folders by format, rejected models, and messages."""

import json

import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from small_study import write_study

run = CliRunner().invoke


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """The output folder of an identification that met no criterion, as none was set."""
    folder = tmp_path_factory.mktemp("study")
    identification = haptid.identify(haptid.read_study(write_study(folder)))
    (folder / "result").mkdir()
    haptid.Result.of(identification).save(folder / "result")
    return folder / "result"


def test_each_format_gets_a_folder_of_its_own(result, tmp_path):
    out = tmp_path / "model"
    done = run(app, ["export", str(result), "--to", "c", "--to", "json", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert {path.name for path in out.iterdir()} == {"c", "json"}
    assert (out / "c" / "two_links.h").is_file()
    assert "of the torque on unseen motion" in done.output
    assert json.loads((out / "json" / "two_links.json").read_text())["device"] == "two links"


def test_quiet_says_nothing(result, tmp_path):
    done = run(app, ["export", str(result), "--to", "latex", "--out", str(tmp_path / "model"), "--quiet"])
    assert (done.exit_code, done.output) == (0, "")


def test_what_fails_is_written_only_on_request(result, tmp_path):
    values = json.loads((result / "result.json").read_text())
    values["criteria"] = {"relative_error_percent": 1e-6, "met": False}
    (tmp_path / "result.json").write_text(json.dumps(values))
    arguments = ["export", str(tmp_path), "--to", "matlab", "--out", str(tmp_path / "model")]
    refused = run(app, arguments)
    assert refused.exit_code == 2
    assert "export it anyway" in " ".join(refused.output.split())
    assert not (tmp_path / "model").exists()
    assert run(app, [*arguments, "--force"]).exit_code == 0
    assert "VALIDATION FAILED" in (tmp_path / "model" / "matlab" / "two_links_parameters.m").read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--to", "fortran"], "no export format 'fortran'"), ([], "--to"), (["--to", "c"], "result.json")],
)
def test_wrong_calls_end_with_status_2(result, tmp_path, arguments, said):
    where = tmp_path if said == "result.json" else result
    done = run(app, ["export", str(where), *arguments, "--out", str(tmp_path / "model")])
    assert done.exit_code == 2
    assert said in done.output.replace("\n", "")
