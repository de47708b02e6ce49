"""The model for use: consistent where the log says nothing else, another where held-out rows prefer it."""

import json
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.errors import StudyFileError
from haptid.estimation import GLS, WLS, PhysicallyConsistent, Ridge, feasible_parameters
from haptid.estimation.methods.regularised import ENTROPIC_STRENGTHS, Entropic, EntropicPenalty
from haptid.observation.observation import concatenated
from haptid.results.result import Result
from haptid.study import read_study
from haptid.study.identify import identify
from haptid.validation.model_for_use import model_for_use, se_of_sum
from motions import motion
from small_study import write_study

DEVICE = """
schema = 1
name = "two links"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
BODIES = """
[[prior.bodies]]
link = "1"
mass = 2.0
com = [0.15, 0.0, 0.0]
inertia = [0.01, 0.03, 0.03, 0.0, 0.0, 0.0]
[[prior.bodies]]
link = "2"
mass = 1.0
com = [0.12, 0.0, 0.0]
inertia = [0.005, 0.02, 0.02, 0.0, 0.0, 0.0]
"""


def model_of(folder, text):
    path = folder / "device.toml"
    path.write_text(text)
    return haptid.DynamicModel(haptid.read_device(path))


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return model_of(tmp_path_factory.mktemp("bodies"), DEVICE + BODIES)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    return model_of(tmp_path_factory.mktemp("bare"), DEVICE)


def truth(model, friction=0.3):
    """The prior bodies and friction."""
    chi = dict(zip(("ZZ1", "MX1", "M1", "ZZ2", "MX2", "M2"), (0.075, 0.3, 2.0, 0.034, 0.12, 1.0), strict=True))
    names, kinds = model.device.parameters.names, model.device.parameters.kinds
    pairs = zip(names, kinds, strict=True)
    return model.base.of(np.array([chi.get(n, friction if kind in ("FV", "FC") else 0.0) for n, kind in pairs]))


def observed(model, beta, noise, seed=1, seconds=12.0, dt=1e-2):
    return haptid.observe(model, motion(model, beta, seconds=seconds, dt=dt, seed=seed, noise=noise))


def torque_error(model, beta, true):
    """Relative error of the torque at random states."""
    states = np.random.default_rng(5).uniform(-2, 2, (3, 2, 300))
    exact = haptid.inverse_dynamics(model, true, *states)
    return np.linalg.norm(haptid.inverse_dynamics(model, beta, *states) - exact) / np.linalg.norm(exact)


def test_a_free_fit_of_bodies_is_the_model_for_use(bare):
    made = haptid.estimate(observed(bare, truth(bare), 0.02), WLS())
    use = model_for_use(made)
    assert use.name == "consistent"
    assert not use.candidates
    np.testing.assert_array_equal(use.beta, made.beta)
    assert "free fit is physically consistent" in use.reason


def test_noise_that_makes_bodies_impossible_leaves_the_consistent_fit(bare):
    """Without friction its estimates are negative as often as not: no gain on held-out rows, and no body."""
    beta, gains = truth(bare, friction=0.0), []
    for seed in range(4):
        made = haptid.estimate(observed(bare, beta, 2.0, seed), WLS())
        use = model_for_use(made)
        assert use.name == "consistent"
        assert feasible_parameters(bare, use.beta).ok
        gains.append(torque_error(bare, made.beta, beta) - torque_error(bare, use.beta, beta))
    assert np.mean(gains) > 0


def test_a_fit_of_no_body_is_used_where_held_out_rows_prefer_it(bare):
    """Friction that feeds energy in is real here: the constrained fit predicts worse, by far more than its noise."""
    made = haptid.estimate(observed(bare, truth(bare, friction=-0.5), 0.1), WLS())
    use = model_for_use(made)
    assert use.name == "free"
    free = next(one for one in use.candidates if one.name == "free")
    assert free.excess[0] < -3 * free.excess[1]
    assert f"{free.error:.3g} %" in use.reason
    assert f"{use.candidates[0].error:.3g} %" in use.reason
    assert "No bodies that can exist move as the log says" in use.reason
    assert use.candidates[0].error > 2 * free.error
    assert model_for_use(made, wanted="consistent").name == "consistent"


def test_a_small_clash_of_bodies_and_log_is_not_called_one(bare):
    """Friction slightly below zero: held-out rows prefer the free fit, by less than would say that signs are wrong."""
    made = haptid.estimate(observed(bare, truth(bare, friction=-0.05), 0.1), WLS())
    use = model_for_use(made)
    assert use.name == "free"
    assert "No bodies" not in use.reason


def test_a_right_prior_lowers_the_held_out_error_of_a_poor_log(model):
    """Its strength is the best of those tried; a gain within a fiftieth does not replace the consistent fit."""
    beta = truth(model)
    made = haptid.estimate(observed(model, beta, 2.0, seed=2, dt=0.05), WLS())
    use = model_for_use(made)
    found = {one.name: one for one in use.candidates}
    assert set(found) == {"consistent", "free", "ridge", "entropic"}
    assert found["entropic"].error < found["free"].error
    assert found["entropic"].strength in ENTROPIC_STRENGTHS
    pulled = haptid.estimate(made.observation, Entropic(found["entropic"].strength))
    assert torque_error(model, pulled.beta, beta) < torque_error(model, made.beta, beta)
    for one in use.candidates:
        difference, se = one.excess
        assert one.is_better == (difference < -se and one.error < 0.98 * found["consistent"].error)


def test_strengths_that_are_left_early_are_not_the_best(model, monkeypatch):
    """With a bound that is none every strength is tried in every fold: the same figures, from more fits."""
    made = haptid.estimate(observed(model, 2 * truth(model), 0.1), WLS())  # the prior is wrong by a half
    module, fits = sys.modules["haptid.validation.model_for_use"], []
    minimiser = EntropicPenalty.minimiser
    monkeypatch.setattr(EntropicPenalty, "minimiser", lambda *given: fits.append(given[3]) or minimiser(*given))
    early, few = model_for_use(made).candidates, len(fits)
    monkeypatch.setattr(module, "_least", lambda *_: -np.inf)
    fits.clear()
    assert [vars(one) for one in model_for_use(made).candidates] == [vars(one) for one in early]
    assert few < len(fits) == 5 * len(set(fits))


def test_figures_are_those_of_fits_without_the_fold(bare):
    """The held-out error, fold by fold with the public functions."""
    observation = observed(bare, truth(bare, friction=-0.5), 0.1)
    made = haptid.estimate(observation, WLS())
    found = {one.name: one.error for one in model_for_use(made).candidates}
    blocks = np.arange(len(observation.blocks))
    square = 0.0
    for fold in range(5):
        seen, unseen = observation.pick(blocks[blocks % 5 != fold]), observation.pick(blocks[blocks % 5 == fold])
        T = seen.stack(made.weights)
        beta = np.linalg.lstsq(T[:-1, :-1], T[:-1, -1], rcond=None)[0]
        square += sum(motor.residual(beta) ** 2 for motor in unseen.motors)
    whole = sum(motor.norm**2 for motor in observation.motors)
    assert found["free"] == pytest.approx(100 * np.sqrt(square / whole), rel=1e-9)


def test_other_methods_are_used_as_they_are(model):
    observation = observed(model, truth(model), 0.1)
    for method in (PhysicallyConsistent(), Ridge(strength=1.0)):
        made = haptid.estimate(observation, method)
        assert model_for_use(made).estimate is made
        assert model_for_use(made).name == "given"
    assert model_for_use(haptid.estimate(observation, GLS())).name != "given"


def test_the_eight_blocks_of_a_short_log_are_enough(bare):
    """Friction that feeds energy in is real here too, and four folds of two blocks show it."""
    made = haptid.estimate(observed(bare, truth(bare, friction=-0.5), 0.1, seconds=3.0), WLS())
    assert len(made.observation.blocks) == 8
    assert model_for_use(made).name == "free"


def test_three_blocks_are_not_split(bare):
    observation = observed(bare, truth(bare, friction=-0.5), 0.1).pick(np.arange(3))
    use = model_for_use(haptid.estimate(observation, WLS()))
    assert use.name == "consistent"
    assert "too short" in use.reason


def test_the_error_of_a_sum_counts_serial_correlation():
    rng = np.random.default_rng(0)
    white = rng.normal(size=400)
    assert se_of_sum(white) == pytest.approx(20.0, rel=0.2)
    slow = np.convolve(white, np.ones(4), "valid")
    assert se_of_sum(slow) > 1.4 * np.sqrt(len(slow) * slow.var())


def test_a_result_has_it_and_exports_it(tmp_path):
    """The result file, the printed notes and the written code name the same fit."""
    study = write_study(tmp_path)
    found = identify(read_study(study))
    made = Result.of(found)
    np.testing.assert_array_equal(made.beta_for_use, found.use.beta)
    np.testing.assert_array_equal(made.beta, found.estimate.beta)
    low, high = made.conf_int_for_use().T
    assert ((low <= found.use.beta) & (found.use.beta <= high)).all()
    folder = tmp_path / "result"
    run = CliRunner().invoke(app, ["identify", str(study), "--out", str(folder)])
    assert run.exit_code == 0
    assert "free fit is physically consistent" in " ".join(run.output.split())
    read = Result.load(folder)
    assert read.model_for_use.reason == found.use.reason
    np.testing.assert_array_equal(read.beta_for_use, found.use.beta)
    assert found.use.reason in (folder / "report.html").read_text(encoding="utf-8")
    haptid.export_model(read, tmp_path / "model", ["json"], anyway=True)
    written = json.loads(next((tmp_path / "model" / "json").glob("*.json")).read_text(encoding="utf-8"))
    values = [p["value"] for p in written["parameters"]]
    np.testing.assert_allclose(values, found.use.beta)


def test_a_study_may_name_the_fit(tmp_path):
    study = write_study(tmp_path)
    text = study.read_text(encoding="utf-8")
    table = "" if "[estimate]" in text else "\n[estimate]\n"
    study.write_text(text + table + 'use = "free"\n', encoding="utf-8")
    assert identify(read_study(study)).use.name == "free"
    study.write_text(text + table + 'use = "free"\nconstraints = "physical"\n', encoding="utf-8")
    with pytest.raises(StudyFileError) as raised:
        read_study(study)
    assert raised.value.where == "estimate.use"


def test_reference_rows_are_put_together_only_for_a_comparison(tmp_path, monkeypatch):
    """Of many logs they take more memory than all else, and each run holds its own."""
    together = []

    def noted(observations):
        together.extend(observations := tuple(observations))
        return concatenated(observations)

    monkeypatch.setattr("haptid.study.identify.concatenated", noted)
    found = haptid.identify(haptid.read_study(write_study(tmp_path)))
    assert not found.use.candidates
    assert together
    assert all(run.reference is not None for run in found.runs)
    assert not any(one is run.reference for one in together for run in found.runs)


def test_reference_rows_are_copied_once_for_a_comparison(bare):
    motions = [motion(bare, truth(bare, -0.5), seconds=40.0, dt=1e-2, seed=k, noise=0.1) for k in range(8)]
    rows = haptid.observe(bare, *motions)
    made = haptid.estimate(rows.pick(np.arange(1, len(rows.blocks))), WLS())  # of the first block no row is picked
    fine = [replace(one, treatment=replace(one.treatment, block_s=0.08)) for one in motions]
    names = {one.name: own.name for one, own in zip(fine, motions, strict=True)}
    reference = [
        replace(rows, blocks=tuple(replace(block, log=names[block.log]) for block in rows.blocks))
        for rows in [haptid.observe(bare, one) for one in fine]
    ]
    size = sum(motor.r_factors.nbytes for rows in reference for motor in rows.motors)
    tracemalloc.start()
    try:
        use = model_for_use(made, reference)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert use.candidates
    assert peak < 1.7 * size, peak / size
