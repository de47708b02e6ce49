"""What may be exported, what the files say of it, and what is left behind when it may not."""

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.export import EXPORTERS, CCode, export_c, export_model
from haptid.export.formats.c_source import comment, wrapped
from haptid.export.output import default_name
from small_study import DEVICE, write_study


@pytest.fixture(scope="module")
def identification(tmp_path_factory):
    """A device of two links from two logs of noisy torque."""
    return haptid.identify(haptid.read_study(write_study(tmp_path_factory.mktemp("study"))))


def header(folder, name="two_links"):
    return (folder / f"{name}.h").read_text()


def test_header_says_what_the_model_is_and_how_it_was_validated(tmp_path, identification):
    made = export_c(identification, tmp_path / "out", largest_error=50.0)
    text = header(made.folder)
    error = identification.unseen[0].comparable.relative
    assert f"Error {error:.2f} % of the torque on unseen motion; criterion 50.00 %: met." in text
    assert made.verdict in text
    assert identification.runs[0].motion.log.sha256 in text
    assert identification.runs[1].motion.log.sha256 not in text  # it validated, and identified nothing
    assert "q[0] motor 1, rad, N m; from -2 to 2 rad; command = torque\n" in text
    for parameter in identification.estimate.parameters:
        assert f"{parameter.name}: {parameter.value:.6g} {parameter.unit}" in text
    assert made.verdict in (made.folder / "README.md").read_text()


def test_a_failed_validation_is_rejected_with_a_reason(tmp_path, identification):
    out = tmp_path / "out"
    with pytest.raises(errors.UnvalidatedModelError) as raised:
        export_c(identification, out, largest_error=1e-6)
    assert raised.value.found > raised.value.limit == 1e-6
    assert not out.exists()
    export_c(identification, out, largest_error=1e-6, anyway=True)
    assert "VALIDATION FAILED" in header(out)


def test_a_criterion_requires_a_validation(tmp_path, identification):
    estimate = identification.estimate
    with pytest.raises(errors.UnvalidatedModelError) as raised:
        export_c(estimate, tmp_path / "out", largest_error=5.0)
    assert raised.value.limit == 5.0
    export_c(estimate, tmp_path / "out", largest_error=5.0, anyway=True)
    assert "NOT VALIDATED" in header(tmp_path / "out")
    export_c(estimate, tmp_path / "out", validation=haptid.fit_errors(estimate))
    assert "rows of its own fit; no criterion was set" in header(tmp_path / "out")


def test_parameters_from_elsewhere(tmp_path, identification):
    model = identification.model
    made = export_c((model, np.ones(len(model.base))), tmp_path / "out")
    assert "NOT VALIDATED" in made.verdict
    assert "none: parameters of other origin" in header(made.folder)
    with pytest.raises(errors.ShapeError):
        export_c((model, np.ones(1 + len(model.base))), tmp_path / "out")


def test_what_was_there_stays_where_the_export_fails(tmp_path, identification):
    (tmp_path / "two_links.h").write_text("mine")
    (tmp_path / "two_links.c").mkdir()
    with pytest.raises(errors.OutputFolderError):
        export_c(identification, tmp_path)
    assert header(tmp_path) == "mine"


@pytest.mark.parametrize("name", ["Arm", "9arm", "arm-7", "", "a" * 25, "int main"])
def test_names_that_are_none_in_c(name):
    with pytest.raises(errors.SettingError) as raised:
        CCode(name=name)
    assert raised.value.found == name


@pytest.mark.parametrize("setting", [{"precision": "half"}, {"reversal_speed": 0.0}, {"reversal_speed": np.nan}])
def test_settings_that_mean_nothing(setting):
    with pytest.raises(errors.SettingError) as raised:
        CCode(**setting)
    assert raised.value.where == next(iter(setting))


def test_a_column_that_reads_accelerations(tmp_path):
    text = DEVICE + '[[terms]]\nkind = "custom"\njoints = ["2"]\nname = "K"\nunit = "N m"\nexpression = "a_1"\n'
    (tmp_path / "device.toml").write_text(text)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    with pytest.raises(errors.ExportError, match="depends on accelerations"):
        export_c((model, np.ones(len(model.base))), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_parameters_that_no_body_has(tmp_path, identification):
    model = identification.model
    with pytest.raises(errors.PhysicalConsistencyError, match='constraints = "physical"'):
        export_model((model, -np.ones(len(model.base))), tmp_path / "out", ["json", "mjcf"])
    assert not (tmp_path / "out").exists()  # nothing, where not all can be written


def test_a_format_that_is_none(tmp_path, identification):
    with pytest.raises(errors.UnknownNameError) as raised:
        export_model(identification, tmp_path / "out", ["c", "fortran"])
    assert raised.value.limit == EXPORTERS


@pytest.mark.parametrize(
    "name", [name for name in EXPORTERS if name not in ("chai3d", "dvrk")]
)  # those two need a handle or one arm: test_control_packages
def test_every_format_says_how_the_model_was_validated(tmp_path, identification, name):
    """From the result folder as from the identification; and what fails is written only when it is told."""
    (tmp_path / "result").mkdir()
    haptid.Result.of(identification).save(tmp_path / "result")
    read = haptid.Result.load(tmp_path / "result")
    for source in (identification, read):
        made = export_model(source, tmp_path / "out", [name])[name]
        assert (
            made.verdict
            == f"Error {identification.unseen[0].comparable.relative:.2f} % of the torque on unseen motion; "
            + ("no criterion was set.")
        )
        said = "".join((made.folder / file).read_text() for file in made.files).replace("\\%", "%")
        assert made.verdict in said
        assert identification.runs[0].motion.log.sha256 in said
    criteria = read.criteria.model_copy(update={"relative_error_percent": 1e-6})
    strict = read.model_copy(update={"criteria": criteria})
    with pytest.raises(errors.UnvalidatedModelError):
        export_model(strict, tmp_path / "strict", [name])
    assert not (tmp_path / "strict").exists()
    assert "VALIDATION FAILED" in export_model(strict, tmp_path / "strict", [name], anyway=True)[name].verdict


def test_comments_cannot_be_left():
    assert "*/" not in comment("a */ b")
    assert "\n" not in comment("a\n b")
    assert len(comment("a" * 500)) < 120


def test_long_declarations_are_wrapped():
    lines = wrapped([f"const double argument_{k}[3]" for k in range(9)], "void function(").splitlines()
    assert max(map(len, lines)) <= 116
    assert len(lines) > 2


@pytest.mark.parametrize(
    ("device_name", "name"),
    [
        ("PHANToM Premium 1.5", "phantom_premium_1_5"),
        ("7R", "device_7r"),
        ("A" * 40, "a" * 24),
        ("arm (left)", "arm_left"),
    ],
)
def test_names_after_devices(device_name, name):
    assert default_name(device_name) == name
    CCode(name=default_name(device_name))
