"""Extensions of other packages: the example package, as if it were installed."""

import csv
import json
import shutil
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.errors import (
    DeviceFileError,
    LogFileError,
    MissingDependencyError,
    StudyFileError,
    UnknownNameError,
    UnvalidatedModelError,
)
from haptid.export import EXPORTERS, export_c, export_formats, export_model
from small_study import DEVICE, STUDY, columns

EXAMPLE = Path(__file__).parents[2] / "examples" / "extension"
DRAG = '[[terms]]\nkind = "extension"\nname = "fluid-drag"\njoints = "all"\n'


def declare(site: Path, name: str, groups: dict[str, dict[str, str]]) -> None:
    """Metadata of an installed package with entry points."""
    info = site / f"{name.replace('-', '_')}-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1\n")
    lines = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in of.items()) for group, of in groups.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder of installed packages, with nothing in it."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    return folder


@pytest.fixture
def installed(site):
    """The example package, installed."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    shutil.copytree(EXAMPLE / "haptid_extension_example", site / "haptid_extension_example")
    declare(site, project["name"], project["entry-points"])
    yield
    for name in [name for name in sys.modules if name.startswith("haptid_extension_example")]:
        del sys.modules[name]


def write_block(path: Path, made: dict[str, np.ndarray]) -> None:
    head = {"channels": list(made), "units": {"q1": "rad"}}
    path.write_bytes(json.dumps(head).encode() + b"\n" + np.column_stack(list(made.values())).astype("<f8").tobytes())


def study(folder: Path, method: str, drag: bool = True, suffix: str = "blk") -> Path:
    (folder / "device.toml").write_text(DEVICE + DRAG * drag)
    for seed, name in ((1, "log"), (2, "check")):
        made = columns(seed)
        speed = np.gradient(made["q1"], made["t"])
        made["tau1"] = made["tau1"] + 0.03 * speed * np.abs(speed)
        write_block(folder / f"{name}.{suffix}", made)
    text = STUDY.replace(".csv", f".{suffix}") + f"[estimate]\n{method}"
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


@pytest.mark.usefixtures("installed")
def test_one_of_each_kind_from_file_to_export(tmp_path):
    path = study(tmp_path, 'method = "rated-torque"\nsettings = { torques = [2.0, 1.0] }\n')
    found = haptid.identify(haptid.read_study(path))
    assert found.study.method.name == "rated torque"
    low, high = found.estimate["FQ1"].conf_int(0.999)
    assert low < 0.03 < high
    assert found.estimate["FQ1"].unit == "N m s^2/rad^2"
    out = tmp_path / "out"
    export_model(found, out, ["parameters-csv", "json"])
    with (out / "parameters-csv" / "parameters.csv").open() as file:
        rows = {row["name"]: float(row["value"]) for row in csv.DictReader(file)}
    # Whether quoted or for use is the exporter's choice; the JSON export has the same.
    told = json.loads(next((out / "json").glob("*.json")).read_text())
    assert rows == {p["name"]: p["value"] for p in told["parameters"]}
    # A term of an extension is an expression: the C export has it, and its self-test compares it with the model.
    export_c(found, tmp_path / "c")
    assert set(export_formats()) == {*EXPORTERS, "parameters-csv"}


@pytest.mark.usefixtures("installed")
def test_channels_are_drafted_from_a_log_of_an_extension(tmp_path):
    write_block(tmp_path / "log.blk", columns(1))
    result = CliRunner().invoke(app, ["channels", str(tmp_path / "log.blk")])
    assert result.exit_code == 0
    assert "q1" in result.output
    log = haptid.read_log(tmp_path / "log.blk")
    assert np.allclose(log.position[:, 0], columns(1)["q1"])


@pytest.mark.usefixtures("installed")
def test_the_exporter_refuses_a_failed_model(tmp_path):
    path = study(tmp_path, "")
    path.write_text(path.read_text() + "[criteria]\nrelative_error_percent = 1e-6\n")
    with pytest.raises(UnvalidatedModelError):
        export_model(haptid.identify(haptid.read_study(path)), tmp_path / "out", ["parameters-csv"])
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("estimate", "where"),
    [
        ('method = "rated-torq"\n', "estimate.method"),
        ('method = "rated-torque"\n', "estimate.settings"),
        ('method = "rated-torque"\nsettings = { speed = 1 }\n', "estimate.settings"),
        ('method = "wls"\nsettings = { passes = 2 }\n', "estimate.settings"),
        ('method = "rated-torque"\nsettings = { torques = [1.0, 1.0] }\npasses = 2\n', "estimate.passes"),
    ],
)
def test_settings_of_a_method_are_checked(tmp_path, estimate, where):
    with pytest.raises(StudyFileError) as raised:
        haptid.read_study(study(tmp_path, estimate))
    assert raised.value.where == where


def test_what_is_not_installed_is_named_with_what_is(tmp_path):
    with pytest.raises(StudyFileError) as raised:
        haptid.read_study(study(tmp_path, 'method = "rated-torque"\n', drag=False))
    assert "wls" in raised.value.advice
    with pytest.raises(DeviceFileError) as raised:
        haptid.read_device(study(tmp_path, "").parent / "device.toml")
    assert "fluid-drag" in str(raised.value)
    with pytest.raises(LogFileError):
        haptid.read_log(tmp_path / "log.blk")
    with pytest.raises(UnknownNameError):
        export_model(
            (haptid.DynamicModel(haptid.read_device("emps")), np.zeros(4)), tmp_path / "out", ["parameters-csv"]
        )


def test_an_extension_that_cannot_be_imported(tmp_path, site):
    declare(site, "broken", {"haptid.log_formats": {"blk": "no_such_module_anywhere"}})
    write_block(tmp_path / "log.blk", columns(1))
    with pytest.raises(MissingDependencyError, match="package broken cannot be imported"):
        haptid.read_log(tmp_path / "log.blk")


def test_two_packages_of_one_name(tmp_path, site):
    for name in ("one", "two"):
        declare(site, name, {"haptid.log_formats": {"blk": f"module_{name}"}})
    write_block(tmp_path / "log.blk", columns(1))
    with pytest.raises(MissingDependencyError, match="one, two each declare 'blk'"):
        haptid.read_log(tmp_path / "log.blk")


@pytest.mark.usefixtures("installed")
def test_nothing_is_imported_that_is_not_named(tmp_path):
    (tmp_path / "device.toml").write_text(DEVICE)
    haptid.read_device(tmp_path / "device.toml")
    assert not [name for name in sys.modules if name.startswith("haptid_extension_example")]
