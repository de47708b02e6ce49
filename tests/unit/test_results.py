"""A result folder is read back: the same device, figures and errors as the identification had."""

import json
import re
import runpy

import numpy as np
import pydantic
import pytest

import haptid
from haptid.device.toml.reader import checked_tables, device_of
from haptid.end_effector import apparent_mass
from haptid.end_effector.characterisation.model import dof, trusted
from haptid.errors import ResultFileError
from haptid.results.result import Result, result_schema
from haptid.results.tables import device_file
from haptid.study import read_study
from haptid.study.identify import identify


@pytest.fixture(scope="module")
def made(tmp_path_factory, request):
    """The example's identification, and the folder it was written to."""
    examples, folder = request.config.rootpath / "examples" / "phantom", tmp_path_factory.mktemp("result")
    runpy.run_path(str(examples / "make_logs.py"))["main"](folder)
    found = identify(read_study(examples / "study.toml"), folder)
    Result.of(found).save(folder)
    return found, folder


def changed(folder, tmp_path, change):
    """A copy of the result file with something changed in it."""
    values = json.loads((folder / "result.json").read_text())
    change(values)
    (tmp_path / "result.json").write_text(json.dumps(values))
    return tmp_path


def test_the_figures_come_back_to_the_last_bit(made):
    found, folder = made
    read, estimate = Result.load(folder), found.estimate
    assert read.names == estimate.base.names
    np.testing.assert_array_equal(read.beta, estimate.beta)
    for name in ("values", "covariance", "dof", "se"):
        np.testing.assert_array_equal(getattr(read.unconstrained, name), getattr(estimate.quantities, name))
    np.testing.assert_array_equal(read.conf_int(), estimate.conf_int())
    assert (read.estimate.method, read.estimate.constraints, read.estimate.status) == ("wls", None, "ok")
    assert tuple(read.notes[:-1]) == estimate.notes
    assert read.unconstrained.unbounded == estimate.single_block == ()
    assert (read.study, read.haptid) == (found.study.name, haptid.__version__)
    assert read.to_dict() == Result.of(found).to_dict() == json.loads((folder / "result.json").read_text())


def test_logs_treatment_and_verdict_come_back(made):
    found, folder = made
    read = Result.load(folder / "result.json")
    assert [(log.path, log.role) for log in read.logs] == [("sweep.parquet", "identify"), ("check.parquet", "validate")]
    assert [log.sha256 for log in read.logs] == [run.motion.log.sha256 for run in found.runs]
    assert read.unseen == found.unseen
    assert read.fit_errors == (found.runs[0].fit_errors,)
    assert (read.criteria.relative_error_percent, read.criteria.met) == (5.0, True)


def test_figures_at_the_handle_come_from_the_folder_alone(made):
    found, folder = made
    pose = np.array([[0.0], [0.2], [0.3]])
    ours, theirs = (apparent_mass(m, pose).mass for m in (Result.load(folder).identified, found.estimate))
    np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-12)
    np.testing.assert_allclose(ours.se, theirs.se, rtol=1e-6)
    assert ours.dof == found.estimate.dof.min()


@pytest.mark.parametrize("name", haptid.shipped_devices())
def test_every_device_comes_back_from_its_own_tables(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    device = device_of(*checked_tables(json.loads(json.dumps(device_file(model))), "here"))
    again = haptid.DynamicModel(device)
    assert again.base.names == model.base.names
    np.testing.assert_allclose(again.base.regrouping, model.base.regrouping, atol=1e-12)
    np.testing.assert_array_equal(device.gravity, model.device.gravity)
    assert device.prior == model.device.prior
    assert device.tables.joints == model.device.tables.joints


def test_gravity_comes_back_as_it_was_mounted():
    model = haptid.DynamicModel(haptid.read_device("five_bar")).with_gravity([1.0, -2.0, 3.0])
    again = device_of(*checked_tables(device_file(model), "here"))
    np.testing.assert_array_equal(again.gravity, [1.0, -2.0, 3.0])


def test_an_infinite_interval_comes_back(made, tmp_path):
    _, folder = made

    def lone(values):
        values["estimate"]["parameters"][2] |= {"conf_int": [None, None], "se": None}
        values["estimate"]["parameters"][3]["dof"] = None

    read = Result.load(changed(folder, tmp_path, lone))
    assert read.unconstrained.unbounded == (2,)
    assert np.isinf(read.unconstrained.se[2])
    assert np.isinf(read.unconstrained.dof[3])
    assert np.isinf(trusted(read.identified, np.ones(3))).all()
    assert dof(read.identified, np.eye(14)) == read.unconstrained.dof.min()


def test_what_is_no_result_is_rejected(made, tmp_path):
    _, folder = made
    with pytest.raises(ResultFileError, match="no such file"):
        Result.load(tmp_path)
    for change, where in [
        (lambda v: v.pop("device_file"), "device_file"),
        (lambda v: v.update(schema=3), "schema"),
        (lambda v: v.update(schema="2.0"), "schema"),
        (lambda v: v["estimate"].update(covariance="many"), "estimate.covariance"),
        (lambda v: v["estimate"]["covariance"].pop(), "estimate.covariance"),
    ]:
        with pytest.raises(ResultFileError) as raised:
            Result.load(changed(folder, tmp_path, change))
        assert raised.value.where == where
    for text in ("[]", "{", "1"):
        (tmp_path / "result.json").write_text(text)
        with pytest.raises(ResultFileError):
            Result.load(tmp_path)


def test_parameters_that_are_not_the_devices_are_rejected(made, tmp_path):
    _, folder = made
    path = changed(folder, tmp_path, lambda v: v["estimate"]["parameters"][0].update(name="ZZ99"))
    with pytest.raises(ResultFileError) as raised:
        Result.load(path)
    assert raised.value.where == "estimate.parameters"
    assert raised.value.found[0] == "ZZ99"


def test_a_recorded_result_cannot_be_written_to(made):
    read = Result.load(made[1])
    with pytest.raises(ValueError, match="read-only"):
        read.beta[0] = 1.0
    with pytest.raises(pydantic.ValidationError):
        read.study = "another"
    with pytest.raises(pydantic.ValidationError):
        read.beta = None


def test_a_file_of_schema_1_names_its_version_and_what_to_do(made, tmp_path):
    path = changed(made[1], tmp_path, lambda v: v.update(schema=1, haptid="0.3.1"))
    with pytest.raises(ResultFileError, match=r"written by haptid 0\.3\.1 in schema 1.*identify` again on the study"):
        Result.load(path)


def test_tables_of_a_demo_are_no_result(tmp_path):
    path = tmp_path / "result.json"
    path.write_text('{"schema": 1, "demo": "phantom", "claims": []}', encoding="utf-8")
    with pytest.raises(ResultFileError, match="is no result of haptid identify"):
        Result.load(path)


def test_the_published_schema_has_the_keys_of_the_file_and_of_the_documentation(made, request):
    values, schema = json.loads((made[1] / "result.json").read_text()), result_schema()
    assert values["schema"] == schema["properties"]["schema"]["const"] == 2
    assert values.keys() == schema["properties"].keys()
    tables = {name: table["properties"].keys() for name, table in schema["$defs"].items() if "properties" in table}
    estimate = values["estimate"]
    for found, table in [
        (estimate, "ResultEstimate"),
        (estimate["parameters"][0], "ResultParameter"),
        (values["logs"][0], "ResultLog"),
        (values["observation"], "ObservationTable"),
        (values["validation"][0], "ErrorTable"),
        (values["verdict"][0] if values["verdict"] else dict.fromkeys(tables["ResultUse"]), "ResultUse"),
    ]:
        assert found.keys() == tables[table]
    text = (request.config.rootpath / "docs" / "tutorial.md").read_text()
    page = text[text.index("### result.json") : text.index("## 6. The same from Python")]
    nested = {"estimate": "ResultEstimate", "observation": "ObservationTable"}
    wanted = {f"{key}.{sub}" for key, table in nested.items() for sub in tables[table]}
    wanted |= (values.keys() - nested.keys()) | tables["ResultParameter"] | tables["NonlinearConstant"]
    wanted |= tables["ResultLog"] | tables["ErrorTable"] | tables["PhysicalConstraints"]
    assert wanted <= set(re.findall(r"`([a-z0-9_.]+)`", page))
