"""Home offsets and the direction of gravity: recovered inside their intervals, and their doubt in the parameters'."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import haptid
from haptid.errors import SettingError, StudyFileError
from haptid.observation.geometry_slopes import horizontal_axes
from haptid.results import Result
from haptid.study.identify import identify
from haptid.study.read import read_study
from haptid.treatment_choice import CalibrationPrior, find_calibration
from motions import multisine
from small_study import DEVICE, HEAD, two_links
from true_parameters import true_parameters

DT = 5e-3
TREATMENT = haptid.Treatment(cutoff_hz=None, decimation=4, parallel_cutoff_hz=12, reversal_speed=0.05)


@pytest.fixture(scope="module")
def model():
    return two_links()


def chi_of(model):
    return true_parameters(model, FV=0.05, FC=0.2)


def recorded(model, offsets, rotation, seed, side="joint"):
    """A log whose positions lack the offsets (true less logged), of a device that stands turned."""
    towards = sum(angle * axis for angle, (_, axis) in zip(rotation, horizontal_axes(model), strict=True))
    turned = model.with_gravity(model.device.gravity + np.linalg.norm(model.device.gravity) * towards)
    q, qd, qdd = multisine(2, 8.0, DT, seed, size=0.35)
    tau = haptid.inverse_dynamics(turned, turned.base.of(chi_of(model)), q, qd, qdd)
    tau += 0.02 * np.random.default_rng(seed).standard_normal(q.shape)
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2"), "rad", side=side), haptid.Signal(("u1", "u2"), "N m"), time="t"
    )
    position = (q - np.reshape(offsets, (2, 1))).T
    return haptid.Log(Path("made"), f"log {seed}", DT * np.arange(q.shape[1]), position, tau.T, channels)


def fitted(model, found, logs):
    motions = [haptid.treat(found.corrected(model, log, TREATMENT, k), TREATMENT) for k, log in enumerate(logs)]
    plain = haptid.estimate(haptid.observe(model, *motions), haptid.WLS())
    return plain, found.with_uncertainty(plain)


@pytest.mark.parametrize("each", [False, True], ids=["of all logs", "of each log"])
def test_offsets_and_gravity_come_back_inside_their_intervals(model, each):
    """Drawn from the prior: their own intervals hold, and so do those of the parameters, which without would not."""
    prior = CalibrationPrior(0.02, each, 0.0 if each else 0.005)
    rng, runs, truth = np.random.default_rng(0), 16, model.base.of(chi_of(model))
    held, inside, without = [], [], []
    for run in range(runs):
        offsets = rng.normal(0, 0.02, (2, 2)) if each else np.tile(rng.normal(0, 0.02, 2), (2, 1))
        rotation = rng.normal(0, prior.gravity_direction_std, 2)
        logs = [recorded(model, own, rotation, 2 * run + k) for k, own in enumerate(offsets)]
        found = find_calibration(model, logs, TREATMENT, prior)
        low, high = found.quantities.conf_int().T
        true = offsets.ravel() if each else np.append(offsets[0], rotation)
        held.append((low <= true) & (true <= high))
        for made, into in zip(fitted(model, found, logs), (without, inside), strict=True):
            low, high = made.conf_int().T
            into.append((low <= truth) & (truth <= high))
    for shares in (np.sum(held, axis=0), np.sum(inside, axis=0)):
        assert stats.binom.cdf(shares.min(), runs, 0.95) > 1e-3 / len(shares)
    assert np.mean(inside) > 0.9
    assert np.mean(without) < 0.8


def test_an_offset_that_gravity_shows_is_found_and_one_that_no_torque_shows_keeps_its_prior(model):
    """The first joint turns against gravity; the last one's offset only rotates its own link's frame."""
    found = find_calibration(model, [recorded(model, (0.015, 0.0), (0.0, 0.0), 1)], TREATMENT, CalibrationPrior(0.02))
    first, last = found.quantities.se / found.prior_std
    assert found.quantities.values[0] == pytest.approx(0.015, abs=4 * found.quantities.se[0])
    assert first < 0.2
    assert last == pytest.approx(1.0, abs=0.05)
    (_, undetermined) = found.sentences(model)
    assert "do not distinguish home offset of joint 2" in undetermined


def test_the_doubt_moves_the_parameters_as_a_fit_at_other_offsets_does(model):
    """The slope of the parameters, against fits of positions shifted by hand."""
    log = recorded(model, (0.0, 0.0), (0.0, 0.0), 3)
    found = find_calibration(model, [log], TREATMENT, CalibrationPrior(0.02))
    still = replace(found, quantities=replace(found.quantities, values=np.zeros(2), covariance=np.diag([1e-6, 0.0])))
    plain, wide = fitted(model, still, [log])
    (shift,) = (row for row in wide.nuisances["home offsets and direction of gravity"] if row.any())
    ends = []
    for sign in (1, -1):
        moved = replace(log, position=log.position + sign * np.array([1e-3, 0.0]))
        rows = haptid.observe(model, haptid.treat(moved, TREATMENT))
        ends.append(haptid.estimate(rows, haptid.WLS()).beta)
    expected = 0.5 * (ends[0] - ends[1])
    np.testing.assert_allclose(
        np.abs(shift / plain.se), np.abs(expected / plain.se), atol=0.1 * np.abs(shift / plain.se).max()
    )


def test_gravity_is_subtracted_from_the_torque_exactly(model):
    """With the true parameters and rotation the corrected torque is that of the device file's gravity."""
    log = recorded(model, (0.0, 0.0), (0.02, 0.0), 4)
    found = find_calibration(model, [log], TREATMENT, CalibrationPrior(gravity_direction_std=0.02))
    beta = model.base.of(chi_of(model))
    exact = replace(found, quantities=replace(found.quantities, values=np.array([0.02, 0.0])), beta=beta)
    corrected = exact.corrected(model, log, TREATMENT, 0)
    plain = recorded(model, (0.0, 0.0), (0.0, 0.0), 4)
    np.testing.assert_allclose(corrected.torque[50:-50], plain.torque[50:-50], atol=1e-9)
    turned = exact.gravity(model)
    assert np.linalg.norm(turned) == pytest.approx(9.81)
    assert turned[0] == pytest.approx(9.81 * np.sin(np.arctan(0.02)))


def test_motor_side_positions_are_corrected_at_the_shaft(model):
    """A gear multiplies the offset of the joint."""
    device = replace(model.device, drives=tuple(replace(d, gear_ratio=5.0) for d in model.device.drives))
    geared = haptid.DynamicModel(device)
    log = recorded(model, (0.0, 0.0), (0.0, 0.0), 5)
    found = find_calibration(model, [log], TREATMENT, CalibrationPrior(0.02))
    shaft = recorded(model, (0.0, 0.0), (0.0, 0.0), 5, side="motor")
    moved = found.corrected(geared, shaft, TREATMENT, 0).position - shaft.position
    np.testing.assert_allclose(moved, np.tile(5 * found.quantities.values, (len(moved), 1)), atol=1e-12)


def test_a_study_is_calibrated_and_says_so(tmp_path):
    """Table [calibration]; result file and notes."""
    model = two_links()
    log = recorded(model, (0.02, 0.0), (0.0, 0.0), 7)
    (tmp_path / "device.toml").write_text(DEVICE)
    table = np.column_stack([log.t, log.position, log.torque])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    study = f"{HEAD}[[logs]]\npath = 'log.csv'\n[treatment]\ncutoff_hz = 30\ndecimation = 2\n"
    (tmp_path / "study.toml").write_text(f"{study}[calibration]\nhome_offset_std = [0.02, 0.0]\n")
    found = identify(read_study(tmp_path / "study.toml"))
    made = Result.of(found)
    made.save(tmp_path / "out")
    assert Result.load(tmp_path / "out").to_dict() == made.to_dict()
    (offset,) = made.estimate.calibration
    assert offset.name == "home offset of joint 1"
    assert offset.value == pytest.approx(0.02, abs=4 * offset.se)
    assert offset.conf_int[0] > 0
    assert any("corrected for home offset of joint 1" in note for note in made.notes)
    for table, what in (
        ("home_offset_std = [0.1, 0.1, 0.1]", "3 values"),
        ("home_offset_std = 0.0", "not all of them 0"),
    ):
        (tmp_path / "study.toml").write_text(f"{study}[calibration]\n{table}\n")
        with pytest.raises((StudyFileError, SettingError), match=what):
            identify(read_study(tmp_path / "study.toml"))
