"""Searched constants together with friction by load: both are estimated in every fit, and results have both."""

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import haptid
from haptid import errors
from haptid import estimation as e
from haptid.advice.eliminate import with_reduced
from haptid.estimation.nonlinear.load_friction import fit_load_friction, fit_nonlinear_constants
from haptid.inference.elimination import refit_without
from haptid.results.result import Result
from haptid.validation.cross_validation import alternate, each_log
from motions import motion
from small_study import DEVICE, HEAD
from true_parameters import true_parameters

LOAD = """
[[terms]]
kind = "load-friction"
motors = "all"
"""
STRIBECK = """
[[terms]]
kind = "stribeck"
joints = ["2"]
velocity = { start = 0.05, low = 0.02, high = 5 }
"""
STUDY = f"""{HEAD}
[[logs]]
path = "a.parquet"
[[logs]]
path = "b.parquet"
[validation]
cross_validation = "leave-one-log-out"
[treatment]
cutoff_hz = 30
parallel_cutoff_hz = 20
decimation = 5
torque_delay_s = 0
reversal_speed = 0.0
"""
SIZES = {"FV": 0.4, "FC": 0.3, "FS": 0.8, "FLM": 0.08}
VELOCITY = 0.4


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("device") / "device.toml"
    path.write_text(DEVICE + STRIBECK + LOAD)
    return haptid.DynamicModel(haptid.read_device(path))


def truth(model):
    return model.base.of(true_parameters(model, **SIZES))


def moved(model, seed=1, noise=0.03):
    beta = truth(model)
    return motion(model.at_constants((VELOCITY,)).loaded(beta), beta, seconds=8.0, dt=4e-3, seed=seed, noise=noise)


@pytest.fixture(scope="module")
def found(model, tmp_path_factory):
    """A study of two logs, walked to its end."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "device.toml").write_text(DEVICE + STRIBECK + LOAD)
    (folder / "study.toml").write_text(STUDY)
    for seed, name in ((1, "a"), (2, "b")):
        made = moved(model, seed)
        columns = {"t": made.dt * np.arange(len(made))}
        columns |= {f"q{k + 1}": made.q[:, k] for k in (0, 1)} | {f"tau{k + 1}": made.tau[:, k] for k in (0, 1)}
        pq.write_table(pa.table(columns), folder / f"{name}.parquet")
    return haptid.identify(haptid.read_study(folder / "study.toml"))


def test_without_noise_constant_and_load_come_back(model):
    made = moved(model, noise=0.0)
    here, projection = fit_nonlinear_constants(model, [made], haptid.OLS())
    assert projection.model is here
    assert projection["FS2.velocity"].value == pytest.approx(VELOCITY, rel=1e-3)
    beta = haptid.estimate(haptid.observe(here, made), haptid.OLS()).beta
    np.testing.assert_allclose(beta, truth(model), rtol=1e-3, atol=1e-5)


def test_loads_are_fitted_with_the_constants_that_were_found(found, model):
    motions = [run.motion for run in found.runs]
    velocity = found.projection["FS2.velocity"].value
    assert velocity == pytest.approx(VELOCITY, rel=0.3)
    wanted, early = (fit_load_friction(d, motions).load for d in (model.at_constants((velocity,)), model))
    left = np.abs(found.model.load - wanted).max()
    assert left < 1e-6
    assert np.abs(early - wanted).max() > 100 * left
    assert found.projection.model is found.model is found.estimate.model


def test_rows_held_out_have_seen_neither_constant_nor_load(found, model):
    motions = [run.motion for run in found.runs]
    for one, other, run in zip(motions, motions[::-1], found.runs, strict=True):
        here, _ = fit_nonlinear_constants(model, [other], haptid.WLS())
        own = haptid.validate(haptid.estimate(haptid.observe(here, other), haptid.WLS()), haptid.observe(here, one))
        assert run.unseen[0].relative == pytest.approx(own.relative, rel=1e-9)


def test_loads_alone_are_fitted_by_every_fold(tmp_path):
    """The other log is of a device that carries twice as much: whoever had seen it would come nearer."""
    (tmp_path / "device.toml").write_text(DEVICE + LOAD)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    light = truth(model)
    heavy = np.where([name.startswith("F") for name in model.base.names], light, 2.0 * light)
    near, far = (motion(model.loaded(b), b, seconds=8.0, dt=4e-3, seed=s) for s, b in ((1, light), (2, heavy)))
    fold = each_log(model, far, [near], haptid.WLS())
    here = fit_load_friction(model, [near])
    own = haptid.validate(haptid.estimate(haptid.observe(here, near), haptid.WLS()), haptid.observe(here, far))
    assert fold.relative == pytest.approx(own.relative, rel=1e-9)
    assert alternate(model, [near], [], haptid.WLS())[0].relative < 0.1


def test_the_reduced_estimate_is_held_out_as_the_full_one(found, model):
    smaller = refit_without(found.estimate, ("FV1",))
    made = with_reduced(found, smaller)
    motions = [run.motion for run in found.runs]
    for one, other, run in zip(motions, motions[::-1], made.runs, strict=True):
        wanted = each_log(model, one, [other], smaller.method)
        assert run.unseen[0].relative == pytest.approx(wanted.relative, rel=1e-9)


def test_the_result_keeps_the_bodies_of_the_loads(found, tmp_path):
    """Those that the friction was made of, not those of the estimate that is held or reduced."""
    smaller = with_reduced(found, refit_without(found.estimate, ("FV1", "FLM2")))
    held = replace(found, estimate=haptid.estimate(found.estimate.observation, haptid.PhysicallyConsistent()))
    for k, made in enumerate((found, smaller, held)):
        folder = tmp_path / str(k)
        folder.mkdir()
        Result.of(made).save(folder)
        np.testing.assert_array_equal(Result.load(folder).model.load, found.model.load)


def test_a_result_without_the_bodies_is_rejected(found, tmp_path):
    Result.of(found).save(tmp_path)
    (tmp_path / "haptid-files.json").unlink()
    path = tmp_path / "result.json"
    for change in ('"load_friction_parameters": null', '"load_friction_parameters": [1.0]'):
        text = path.read_text()
        before, after = text.split('"load_friction_parameters": [', 1)
        path.write_text(before + change + after.split("]", 1)[1])
        with pytest.raises(errors.ResultFileError, match=r"estimate\.load_friction_parameters"):
            Result.load(tmp_path)
        path.write_text(text)


@pytest.mark.parametrize(
    "method",
    [e.TLS(), e.ErrorsInVariables(1e-4), e.Ridge(), e.EKF(), e.EqualityConstraints({"FC1 - FC2": 0.0}, e.OLS())],
)
def test_loads_are_fitted_with_any_method(tmp_path, method):
    """Of a method that does more than weigh rows, what is around; of one that is no weighting at all, WLS."""
    (tmp_path / "device.toml").write_text(DEVICE + LOAD)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    made = motion(model.loaded(truth(model)), truth(model), seconds=8.0, dt=4e-3, noise=0.03)
    wanted = fit_load_friction(model, [made], getattr(method, "weighting", haptid.WLS()))
    np.testing.assert_array_equal(fit_load_friction(model, [made], method).load, wanted.load)
