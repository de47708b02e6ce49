"""The command line, as a user types it."""

import json
import runpy
import shutil

import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.results.tables import treatment
from haptid.uncertainty.figures import relative_se_cell, with_digits


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def phantom(tmp_path_factory, request):
    """The example's logs and its result folder, made by the commands that the README gives."""
    examples = request.config.rootpath / "examples" / "phantom"
    folder = tmp_path_factory.mktemp("phantom")
    runpy.run_path(str(examples / "make_logs.py"))["main"](folder / "logs")
    done = call("identify", examples / "study.toml", "--data", folder / "logs", "--out", folder / "result")
    assert done.exit_code == 0, done.output
    return folder, done


def test_help_says_what_goes_in_and_what_comes_out():
    text = call("identify", "--help").stdout
    for part in ("STUDY", "--data", "--out", "result.json", "Exit status", "Example"):
        assert part in text
    assert "identify" in call("--help").stdout


def test_version():
    assert call("--version").stdout.strip() == f"haptid {haptid.__version__}"


def test_devices_are_listed_and_each_can_be_printed():
    listed = [line.split()[0] for line in call("devices").stdout.splitlines()]
    assert listed == list(haptid.shipped_devices())
    for name in listed:
        done = call("model", name)
        assert done.exit_code == 0
        assert "base parameters" in done.stdout


def test_model_shows_tree_loop_motors_and_regroupings():
    text = call("model", "sr400").stdout
    assert "q3 = pi/2 - q2 + q7" in text
    assert "q8 = q2 - q7" in text
    assert "42 base parameters" in text
    assert "Without effect" in text
    rows = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert "+ IA1" in rows["ZZ1R"]


def test_model_as_json_has_the_groupings_as_data():
    values = json.loads(call("model", "phantom_premium_15", "--json").stdout)
    groups = {p["name"]: p["grouping"] for p in values["base_parameters"]}
    assert groups["ZZbeR"]["Ma"] == pytest.approx(0.215**2)
    assert values["closure_error"] < 1e-12


@pytest.mark.parametrize("kind", ["device", "study", "experiment"])
def test_schemas_are_json_schemas(kind):
    schema = json.loads(call("schema", kind).stdout)
    assert "$defs" in schema or "properties" in schema


def test_unknown_schema_and_unknown_device():
    assert call("schema", "log").exit_code == 2
    done = call("model", "phantom")
    assert done.exit_code == 2
    assert "phantom_premium_15" in done.stderr


def test_tables_show_parameters_errors_and_verdict(phantom):
    _, done = phantom
    for part in ("95 % interval", "ZZbaR", "FC3", "unseen", "condition", "met", "symmetry"):
        assert part in done.stdout


def test_result_file_keeps_its_contract(phantom):
    folder, _ = phantom
    found = json.loads((folder / "result" / "result.json").read_text())
    assert found["schema"] == 2
    assert found["haptid"] == haptid.__version__
    for log, role in zip(found["logs"], ("identify", "validate"), strict=True):
        assert log["role"] == role
        assert len(log["sha256"]) == 64
    observation = found["observation"]
    assert observation["rank"] == len(found["estimate"]["parameters"]) == 14
    assert observation["parameters"] > observation["rank"]
    assert 1 < observation["condition"]["scaled"] < observation["condition"]["raw"]
    assert found["estimate"]["method"] == "wls"
    assert found["estimate"]["status"] == "ok"
    for p in found["estimate"]["parameters"]:
        assert set(p) >= {
            "name", "value", "se", "conf_int", "relative_se_percent", "unit", "grouping", "eliminated", "prior",
        }  # fmt: skip
        assert p["conf_int"][0] < p["value"] < p["conf_int"][1]
        assert p["se"] > 0
    for v in found["validation"]:
        assert set(v) >= {"log", "motor", "relative_error_percent", "rmse", "unit"}
    assert {v["rows"] for v in found["validation"]} == {"fit", "unseen", "reference"}
    assert all(isinstance(note, str) for note in found["notes"])


def test_result_file_says_that_an_estimate_is_held(phantom, request, tmp_path):
    folder, _ = phantom
    text = (request.config.rootpath / "examples" / "phantom" / "study.toml").read_text()
    assert "[estimate]" not in text
    study = tmp_path / "study.toml"
    study.write_text(f"{text}\n[estimate]\nconstraints = 'physical'\n")
    done = call("identify", study, "--data", folder / "logs", "--out", tmp_path / "held", "--quiet", "--no-report")
    assert done.exit_code == 0, done.output
    free, held = (json.loads((f / "result.json").read_text()) for f in (folder / "result", tmp_path / "held"))
    for found, possible in ((free, False), (held, True)):
        assert found["estimate"]["method"] == "wls"
        assert (found["estimate"]["constraints"] is not None) is possible
        assert ("cut at 0" in found["estimate"]["intervals_description"]) is possible
    assert all(p["unconstrained"] == p["value"] for p in free["estimate"]["parameters"])


def test_treatment_has_the_settings_of_a_study():
    assert treatment(haptid.Treatment(cutoff_hz=None))["cutoff_hz"] == "none"
    assert treatment(haptid.Treatment(cutoff_hz=30.0))["cutoff_hz"] == 30.0


def test_truth_is_inside_its_interval(phantom):
    folder, _ = phantom
    truth = json.loads((folder / "logs" / "truth.json").read_text())
    found = json.loads((folder / "result" / "result.json").read_text())
    inside = [p["conf_int"][0] <= truth[p["name"]] <= p["conf_int"][1] for p in found["estimate"]["parameters"]]
    assert sum(inside) >= 13  # of 14 at 95 %


def test_the_same_study_gives_the_same_result_bit_for_bit_and_json_alone_on_standard_output(phantom, request):
    folder, _ = phantom
    study = request.config.rootpath / "examples" / "phantom" / "study.toml"
    done = call("identify", study, "--data", folder / "logs", "--out", folder / "again", "--json")
    first, second = (json.loads((folder / name / "result.json").read_text()) for name in ("result", "again"))
    assert json.loads(done.stdout) == second == first


def test_without_a_report_the_numbers_are_the_same_and_no_earlier_report_is_left(phantom, request):
    folder, _ = phantom
    study = request.config.rootpath / "examples" / "phantom" / "study.toml"
    shutil.copytree(folder / "result", folder / "bare")
    shown = call("identify", study, "--data", folder / "logs", "--out", folder / "bare", "--no-report").stdout
    assert "without diagnosis, advice and report" in shown
    assert "report.html" not in shown
    whole, bare = (json.loads((folder / name / "result.json").read_text()) for name in ("result", "bare"))
    assert whole["verdict"]
    assert whole["advice"] is not None
    assert bare == whole | {"verdict": [], "advice": None}
    assert not [path.name for path in (folder / "bare").iterdir() if path.suffix in (".html", ".svg")]


@pytest.mark.parametrize(
    ("value", "se", "shown"),
    [
        (1.23456, 0.012, "1.235"),
        (203.48, 7.4, "203.5"),
        (1e-7, 3e-10, "1e-07"),
        (0.0, 0.0, "0"),
        (-0.00226491, 2e-6, "-0.0022649"),
        (-1e-6, 0.01, "0.000"),
    ],
)
def test_digits_follow_the_deviation(value, se, shown):
    assert with_digits(value, se) == shown


@pytest.mark.parametrize(("se", "value", "shown"), [(1, 200, "0.50"), (1, 3, "33"), (2, 1, "> 100"), (1, 0, "> 1000")])
def test_percentages_are_short(se, value, shown):
    assert relative_se_cell(se, value) == shown
