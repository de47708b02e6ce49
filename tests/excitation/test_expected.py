"""Treatment and noise that are expected of a log before there is one, against logs of the bench."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_sequential import SERIES, WITHIN
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.experiment import bench
from haptid.experiment.excitation import FourierSeries, Limits, Search, design_excitation
from haptid.experiment.excitation.expected import expected_information, expected_log, expected_motions, expected_noise
from haptid.treatment_choice import with_treatment_uncertainty
from json_outputs import valid
from small_study import FRICTION, KD, KP, two_links
from true_parameters import true_parameters

SEARCH = Search(tries=60, seed=1)
PHANTOM = Path(__file__).parents[2] / "examples" / "phantom" / "experiment.toml"
ROOMY = ("--centre", "0,0.2,0.3", "--stroke", "0.6,0.4,0.4", "--speed", "3", "--max-evaluations", "60")


def small(counts=4000.0, noise=0.05, **controller):
    model = two_links()
    return bench.Setup(
        model,
        true_parameters(model, **FRICTION),
        bench.Controller(KP, KD, rate_hz=250.0, **controller),
        bench.Encoders(None if counts is None else (counts,)),
        bench.Amplifiers(noise=(noise,)),
        physics=bench.Physics(5e-4),
    )


def phantom():
    return bench.read_experiment(PHANTOM).setup(haptid.DynamicModel(haptid.read_device("phantom_premium_15")))


def designed(setup, family, within):
    beta = setup.model.base.of(setup.chi)
    return design_excitation(setup.model, family, within, beta=beta, search=SEARCH)


@pytest.fixture(scope="module")
def motion():
    return designed(small(), SERIES, WITHIN)


def recorded(setup, planned, seed):
    """The log that the bench makes of a motion, with the channels of the expected one."""
    made = bench.simulate(setup, planned.trajectory(setup.dt), np.random.default_rng(seed))
    return replace(expected_log(setup, planned), t=made.t, position=made.position, torque=made.command)


@pytest.mark.parametrize(
    ("make", "family", "within"),
    [
        (small, SERIES, WITHIN),
        (phantom, FourierSeries(8.0, 0.2, 8), Limits(((-0.6, 0.6), (-0.2, 0.6), (-0.1, 0.7)), (3.0,))),
    ],
)
def test_predicted_intervals_come_true_on_the_bench(make, family, within):
    """Of both devices within a factor of 1.6 in the median, and of a parameter within 3."""
    setup = make()
    planned = designed(setup, family, within)
    predicted = expected_information(setup, expected_noise(setup, planned)).of_motion(planned)
    found = []
    for seed in (1, 2, 3):
        log = recorded(setup, planned, seed)
        made = haptid.propose(setup.model, log)
        plain = haptid.estimate(haptid.observe(setup.model, haptid.treat(log, made.treatment)), haptid.WLS())
        found.append(with_treatment_uncertainty(plain, made.delays, made.effects, made.rounding).se)
    ratio = np.log(np.sqrt(np.diag(np.linalg.inv(predicted)) / np.mean(np.square(found), axis=0)))
    assert abs(np.median(ratio)) < np.log(1.6)
    assert np.abs(ratio).max() < np.log(3.0)


def test_coarser_encoders_and_more_torque_noise_widen_the_intervals(motion):
    def widths(setup):
        noise = expected_noise(setup, motion, {"decimation": 5, "cutoff_hz": 20.0})
        return expected_motions(setup, noise, [motion]).after

    fine = widths(small())
    assert np.median(widths(small(noise=0.1)) / fine) == pytest.approx(2.0, rel=0.2)
    assert np.median(widths(small(counts=250.0)) / fine) > 1.1


def test_what_the_treatment_leaves_uncertain_is_in_the_covariance(motion):
    setup = small()
    noise = expected_noise(setup, motion)
    with_it, without = (
        np.linalg.inv(one.information(setup.model, motion.trajectory)) for one in (noise, replace(noise, shifts=None))
    )
    assert len(noise.shifts) > 0
    np.testing.assert_allclose(with_it, without + noise.shifts.T @ noise.shifts, atol=1e-6 * np.abs(with_it).max())
    silent = replace(noise, variances=(np.inf,) * 2)  # of a motion without information there stays none
    assert not silent.information(setup.model, motion.trajectory).any()


def test_a_given_treatment_stays_and_the_rest_is_proposed(motion):
    given = expected_noise(small(), motion, {"decimation": 7}).treatment
    proposed = expected_noise(small(), motion).treatment
    assert given.decimation == 7 != proposed.decimation
    assert given.reversal_speed == proposed.reversal_speed


def test_commands_stand_for_the_mean_of_the_periods_that_are_not_logged(motion):
    one, ten = (expected_log(small(log_every=every), motion) for every in (1, 10))
    exact = expected_log(small(noise=0.0), motion)
    assert ten.dt == pytest.approx(10 * one.dt)
    scatter = np.std(np.asarray(one.torque) - np.asarray(exact.torque))
    assert scatter == pytest.approx(0.05, rel=0.05)
    few = np.std(np.asarray(ten.torque) - np.asarray(exact.torque)[::10])
    assert few == pytest.approx(0.05 / np.sqrt(10), rel=0.15)
    jumps = np.diff(np.asarray(one.position), axis=0) / (2 * np.pi / 4000)
    np.testing.assert_allclose(jumps, np.rint(jumps), atol=1e-9)


def test_of_exact_instruments_nothing_is_expected(motion):
    assert expected_noise(small(counts=None, noise=0.0), motion) is None


def test_the_command_predicts_behind_the_treatment_of_a_study(tmp_path):
    (tmp_path / "study.toml").write_text(
        'schema = 1\ndevice = "phantom_premium_15"\n[treatment]\ndecimation = 50\ncutoff_hz = 15\n'
        '[channels]\ntime = "t"\nposition = { channels = ["a", "b", "c"], unit = "rad" }\n'
        'torque = { channels = ["d", "e", "f"], unit = "N m" }\n[[logs]]\npath = "later.csv"\n'
    )
    common = ("excite", "phantom_premium_15", *ROOMY, "--like", str(PHANTOM), "--out", str(tmp_path / "x.toml"))
    done = CliRunner().invoke(app, [*common, "--study", str(tmp_path / "study.toml"), "--accuracy", "1", "--json"])
    assert done.exit_code == 0, done.output
    found = valid("excite", done.stdout)
    assert found["condition"]["scaled"] > 1
    assert "filtered at 15 Hz, 20 rows a second" in found["sentences"][0]
    assert all(one["before_percent"] is None and one["after_percent"] > 0 for one in found["intervals"])
    assert found["seconds_needed"] > 0
    several = CliRunner().invoke(app, [*common, "--motions", "2", "--seconds", "6", "--json"])
    assert several.exit_code == 0, several.output
    made = json.loads(several.stdout)
    assert len(made["motions"]) == 2
    assert "rows a second" in made["sentences"][0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--study", "none.toml"), "without --like"),
        (("--study", "none.toml", "--like", str(PHANTOM), "--after", "none"), "with --after"),
        (("--accuracy", "5"), "--after or --like too"),
    ],
)
def test_options_that_do_not_fit(options, words, tmp_path):
    done = CliRunner().invoke(
        app, ["excite", "phantom_premium_15", *options, *ROOMY, "--out", str(tmp_path / "x.toml")]
    )
    assert done.exit_code == 2
    assert words in done.stderr
