"""A result folder is read back: the same device, figures and errors as the identification had."""

import dataclasses
import json
import runpy

import numpy as np
import pytest

import haptid
from haptid.device.toml.reader import device_of
from haptid.device.toml.tables import checked
from haptid.end_effector.characterisation.model import dof, trusted
from haptid.errors import ResultDeviceError, ResultFileError
from haptid.results.read import read_result
from haptid.results.write import device_file, finite, result, write_result
from haptid.study import read_study
from haptid.study.identify import identify


@pytest.fixture(scope="module")
def made(tmp_path_factory, request):
    """The example's identification, and the folder it was written to."""
    examples, folder = request.config.rootpath / "examples" / "phantom", tmp_path_factory.mktemp("result")
    runpy.run_path(str(examples / "make_logs.py"))["main"](folder)
    found = identify(read_study(examples / "study.toml"), folder)
    write_result(found, folder)
    return found, folder


def changed(folder, tmp_path, change):
    """A copy of the result file with something changed in it."""
    values = json.loads((folder / "result.json").read_text())
    change(values)
    (tmp_path / "result.json").write_text(json.dumps(values))
    return tmp_path


def test_the_figures_come_back_to_the_last_bit(made):
    found, folder = made
    read, estimate = read_result(folder), found.estimate
    assert read.names == estimate.base.names
    for name in ("beta", "covariance", "freedom", "sd", "interval95"):
        np.testing.assert_array_equal(getattr(read, name), getattr(estimate, name))
    np.testing.assert_array_equal(read.free, estimate.beta)
    assert (read.method, read.possible, read.status, read.notes[:-1]) == ("WLS", False, "ok", estimate.notes)
    assert read.single_block == estimate.single_block == ()
    assert (read.study, read.version, read.folder) == (found.study.name, haptid.__version__, folder)


def test_logs_treatment_and_verdict_come_back(made):
    found, folder = made
    read = read_result(folder / "result.json")
    assert [(log.path, log.role) for log in read.logs] == [("sweep.parquet", "identify"), ("check.parquet", "validate")]
    assert [log.sha256 for log in read.logs] == [run.motion.log.sha256 for run in found.runs]
    assert dict(read.treatment) == finite(result(found))["treatment"]
    assert read.unseen == found.unseen
    assert read.direct == (found.runs[0].direct,)
    assert (read.largest_error, read.meets_criteria) == (5.0, True)


def test_figures_at_the_handle_come_from_the_folder_alone(made):
    found, folder = made
    pose = np.array([[0.0], [0.2], [0.3]])
    ours, theirs = (haptid.apparent_mass(m, pose).mass for m in (read_result(folder).model, found.estimate))
    np.testing.assert_allclose(ours.value, theirs.value, rtol=1e-12)
    np.testing.assert_allclose(ours.se, theirs.se, rtol=1e-6)
    assert ours.dof == found.estimate.dof.min()


@pytest.mark.parametrize("name", haptid.shipped_devices())
def test_every_device_comes_back_from_its_own_tables(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    again = device_of(*checked(json.loads(json.dumps(device_file(model))), "here"))
    assert again.base.names == model.base.names
    np.testing.assert_allclose(again.base.regrouping, model.base.regrouping, atol=1e-12)
    np.testing.assert_array_equal(again.gravity, model.device.gravity)
    assert again.prior == model.device.prior
    assert again.tables.joints == model.device.tables.joints


def test_gravity_comes_back_as_it_was_mounted():
    model = haptid.DynamicModel(haptid.read_device("five_bar")).with_gravity([1.0, -2.0, 3.0])
    again = device_of(*checked(device_file(model), "here"))
    np.testing.assert_array_equal(again.gravity, [1.0, -2.0, 3.0])


def test_an_infinite_interval_comes_back(made, tmp_path):
    _, folder = made

    def lone(values):
        values["estimate"]["parameters"][2] |= {"interval95": [None, None], "sd": None}
        values["estimate"]["freedom"][3] = None

    read = read_result(changed(folder, tmp_path, lone))
    assert read.single_block == (2,)
    assert np.isinf(read.se[2])
    assert np.isinf(read.dof[3])
    assert np.isinf(trusted(read.model, np.ones(3))).all()
    assert dof(read.model, np.eye(14)) == read.dof.min()


def test_what_is_no_result_is_refused_in_words(made, tmp_path):
    _, folder = made
    with pytest.raises(ResultFileError, match="no such file"):
        read_result(tmp_path)
    for change, words in [
        (lambda v: v.pop("device_file"), "key `device_file` is missing"),
        (lambda v: v.update(schema=2), "key `schema` is wrong"),
        (lambda v: v["estimate"].update(dof="many"), "key `estimate.freedom` is wrong"),
    ]:
        with pytest.raises(ResultFileError, match=words):
            read_result(changed(folder, tmp_path, change))
    for text in ("[]", "{", "1"):
        (tmp_path / "result.json").write_text(text)
        with pytest.raises(ResultFileError):
            read_result(tmp_path)


def test_parameters_that_are_not_the_devices_are_refused(made, tmp_path):
    _, folder = made
    path = changed(folder, tmp_path, lambda v: v["estimate"]["parameters"][0].update(name="ZZ99"))
    with pytest.raises(ResultDeviceError, match="ZZ99"):
        read_result(path)


def test_a_recorded_result_cannot_be_written_to(made):
    read = read_result(made[1])
    with pytest.raises(ValueError, match="read-only"):
        read.beta[0] = 1.0
    with pytest.raises(TypeError):
        read.values["schema"] = 2
    with pytest.raises(dataclasses.FrozenInstanceError):
        read.beta = None
