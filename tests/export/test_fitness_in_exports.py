"""What the diagnosis calls a model fit for goes with the model: result, files, summary."""

import json

import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.export import EXPORTERS, CCode, export_model
from haptid.inference.diagnosis import diagnose
from small_study import write_study

run = CliRunner().invoke
SENTENCE = "It is not fit for compensation of friction and gravity, because " + "viscous friction differs; " * 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The output folder of `haptid identify`, which diagnoses once."""
    made = tmp_path_factory.mktemp("study")
    study, calls = write_study(made), []

    def counted(*arguments):
        calls.append(arguments)
        return diagnose(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("haptid.inference.diagnosis.diagnose", counted)
        done = run(app, ["identify", str(study), "--out", str(made / "result"), "--quiet"])
    assert done.exit_code == 0, done.output
    assert len(calls) == 1
    return made / "result"


@pytest.fixture(scope="module")
def unfit(folder, tmp_path_factory):
    """The same result with a bad grade."""
    values = json.loads((folder / "result.json").read_text())
    values["verdict"][1] = {"use": "compensation", "grade": "bad", "sentence": SENTENCE.strip()}
    made = tmp_path_factory.mktemp("unfit")
    (made / "result.json").write_text(json.dumps(values))
    return made


def words(text):
    """Text without what begins a line of a comment, and without escapes."""
    return " ".join(word for word in text.replace("\\", "").split() if word not in ("*", "%", "//!"))


def test_the_result_has_the_verdict_of_the_diagnosis(folder):
    identification = haptid.identify(haptid.read_study(folder.parent / "study.toml"))
    said = diagnose(identification.estimate, identification.unseen[0]).verdict
    read = haptid.Result.load(folder)
    assert [use.use for use in read.verdict] == ["predicting", "compensation", "quoting"]
    assert [use.grade for use in read.verdict] == [said.torque, said.compensation, said.parameters]
    assert tuple(use.sentence for use in read.verdict) == said.sentences[:3]
    for use, word in zip(read.verdict, ("predicting", "compensation", "quoting"), strict=True):
        assert word in use.sentence


def test_a_result_without_a_verdict_is_read(folder, tmp_path):
    values = json.loads((folder / "result.json").read_text())
    del values["verdict"]
    (tmp_path / "result.json").write_text(json.dumps(values))
    read = haptid.Result.load(tmp_path)
    assert read.verdict == []
    made = export_model(read, tmp_path / "out", ["c"])["c"]
    assert "WARNING" not in (made.folder / "two_links.h").read_text()


@pytest.mark.parametrize(
    "name", [name for name in EXPORTERS if name not in ("chai3d", "dvrk")]
)  # those two need a handle or one arm: test_control_packages
def test_every_format_says_what_the_model_is_not_fit_for(unfit, tmp_path, name):
    read = haptid.Result.load(unfit)
    made = export_model(read, tmp_path / "out", [name])[name]
    said = words("".join((made.folder / file).read_text() for file in made.files))
    for use in read.verdict:
        assert words(use.sentence) in said
    if name == "json":
        values = json.loads((made.folder / made.files[0]).read_text())
        assert [use["grade"] for use in values["uses"]] == [use.grade for use in read.verdict]
    else:
        assert f"WARNING: {words(SENTENCE)}" in said


def test_readme_and_summary_warn(unfit, folder, tmp_path):
    done = run(app, ["export", str(unfit), "--to", "c", "--out", str(tmp_path / "model")])
    assert done.exit_code == 0
    assert f"WARNING: {words(SENTENCE)}" in words(done.output)
    assert f"WARNING: {words(SENTENCE)}" in words((tmp_path / "model" / "c" / "README.md").read_text())
    graded = [use.grade for use in haptid.Result.load(folder).verdict]
    done = run(app, ["export", str(folder), "--to", "c", "--out", str(tmp_path / "fit")])
    assert done.output.count("WARNING") == graded.count("bad")


def test_name_and_reversal_speed_are_those_of_the_command(folder, tmp_path):
    formats = ["c", "c-single", "matlab", "rust", "json"]
    to = [part for name in formats for part in ("--to", name)]
    out = tmp_path / "model"
    done = run(app, ["export", str(folder), *to, "--name", "arm", "--reversal-speed", "0.25", "--out", str(out)])
    assert done.exit_code == 0, done.output
    for file in ("c/arm.h", "c-single/arm.h", "matlab/arm_terms.m", "rust/src/lib.rs"):
        assert "tanh(v / 0.25)" in (out / file).read_text()
    assert "typedef float arm_real" in (out / "c-single" / "arm.h").read_text()
    assert 'name = "arm"' in (out / "rust" / "Cargo.toml").read_text()
    assert (out / "json" / "two_links.json").is_file()


@pytest.mark.parametrize(("option", "value"), [("--name", "9arm"), ("--reversal-speed", "0")])
def test_settings_that_mean_nothing_end_with_status_2(folder, tmp_path, option, value):
    done = run(app, ["export", str(folder), "--to", "c", option, value, "--out", str(tmp_path / "model")])
    assert done.exit_code == 2
    assert not (tmp_path / "model").exists()


@pytest.mark.parametrize("name", ["a", "a" * 24])
def test_no_line_of_a_header_is_wider_than_120(tmp_path, name):
    for model in ("phantom_premium_15", "cea_medical_branch"):
        described = haptid.DynamicModel(haptid.read_device(model))
        other_model = (described, [0.1] * len(described.base))
        made = export_model(other_model, tmp_path, ["c"], CCode(name))["c"]
        for file in (f"{name}.h", f"{name}_example.c"):
            assert max(map(len, (made.folder / file).read_text().splitlines())) <= 120


def test_a_command_is_torque_by_a_factor_with_its_unit(tmp_path):
    model = haptid.DynamicModel(haptid.read_device("emps"))
    made = export_model((model, [1.0] * len(model.base)), tmp_path, ["c", "matlab"])
    assert "command in V = torque / (35.1506519 N per V)" in (made["c"].folder / "emps.h").read_text()
    matlab = "".join((made["matlab"].folder / file).read_text() for file in made["matlab"].files)
    assert "row by row" not in matlab
