"""A study's known loads and intervals: taken off, named in the result, and refused where they mean nothing."""

import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

import haptid
from haptid import estimation as e
from haptid.device.priors import PriorBody
from haptid.errors import StudyFileError, UnknownNameError
from haptid.observation.cache import RFactorCache, fingerprint
from haptid.observation.known_payload import Payload, log_without_payload
from haptid.observation.plan import Plan
from haptid.results.result import Result
from haptid.treatment_choice import with_treatment_uncertainty
from haptid.uncertainty.quantities import correlations
from motions import multisine, truth
from small_study import columns, two_links, write_study

BODY = PriorBody(0.7, np.array([0.25, 0.1, 0.0]), np.diag([0.0, 0.0, 0.003]))
LOAD = "payload = { link = '2', mass = 0.7, com = [0.25, 0.1, 0.0], inertia = [0, 0, 0.003, 0, 0, 0] }"


def loaded_columns(seed, noise=0.02, late=0.0, seconds=6.0):
    """A log of the small study's device with the load; its command acts so many seconds late."""
    model = two_links()
    beta = truth(model) + 0.1 + haptid.observation.payload_torque(model, "2", BODY)
    q, qd, qdd = multisine(2, seconds, 2e-3, seed)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    tau += noise * np.random.default_rng(seed).standard_normal(tau.shape)
    k = round(late / 2e-3)
    tau = np.roll(tau, -k, axis=1)
    t = 2e-3 * np.arange(q.shape[1])
    return {"t": t, "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": tau[1]}


@pytest.fixture
def study(tmp_path):
    """The small study with one more log, of the load; `text` is its entry."""
    path = write_study(tmp_path)
    pyarrow.csv.write_csv(pa.table(loaded_columns(3)), tmp_path / "loaded.csv")
    before = path.read_text()

    def write(text, more=""):
        path.write_text(
            before.replace("[treatment]", f'[[logs]]\npath = "loaded.csv"\n{text}\n[treatment]') + f"\n{more}\n"
        )
        return haptid.read_study(path)

    return write


def test_a_log_with_a_known_load_determines_the_device_without(study):
    made = haptid.identify(study(LOAD))
    alone = haptid.identify(replace(made.study, logs=made.study.logs[:2]))
    wanted = truth(made.model) + 0.1
    low, high = made.estimate.conf_int().T
    assert ((low < wanted) & (wanted < high)).mean() >= 0.8
    assert made.estimate.se.mean() < alone.estimate.se.mean()
    assert made.runs[2].fit_errors.relative < 1.3 * made.runs[0].fit_errors.relative
    ignored = haptid.identify(study(""))
    assert ignored.runs[2].fit_errors.relative > 3 * made.runs[2].fit_errors.relative


def test_the_result_says_what_was_taken_off(study, tmp_path):
    made = haptid.identify(study(LOAD))
    haptid.Result.of(made).save(tmp_path)
    first, _, third = json.loads((tmp_path / "result.json").read_text())["logs"]
    assert first["payload"] is None
    assert third["payload"] == {"link": "2", "mass": 0.7, "com": [0.25, 0.1, 0.0], "inertia": BODY.inertia.tolist()}
    assert "A payload of 0.7 kg on link 2 is subtracted from the torque" in third["notes"][-1]
    assert third["notes"][-1] in made.estimate.notes


@pytest.mark.parametrize("late", [0.0, 4e-3])
def test_a_load_is_taken_off_to_the_last_digits(tmp_path, late):
    """Exact torque of the device alone is left, with the torque's delay too."""
    model, treatment = two_links(), haptid.Treatment(cutoff_hz=None, torque_delay_s=late)
    names = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("tau1", "tau2"), "N m"), "t")
    for name, made in (("loaded", loaded_columns(3, 0.0, late)), ("plain", columns(3))):
        pyarrow.csv.write_csv(pa.table(made), tmp_path / f"{name}.csv")
    log = haptid.read_log(tmp_path / "loaded.csv", names)
    bare = log_without_payload(model, log, treatment, Payload("2", BODY))
    motion = haptid.treat(bare, treatment)
    exact = haptid.inverse_dynamics(model, truth(model) + 0.1, *multisine(2, 6.0, 2e-3, 3))
    low, high = motion.usable
    inside = slice(low + 10, high - 10)
    np.testing.assert_allclose(motion.tau[inside], exact.T[inside], atol=2e-6 * np.abs(exact).max())
    by_motion = haptid.observation.without_payload(model, haptid.treat(log, treatment), "2", BODY)
    np.testing.assert_allclose(motion.tau[inside], by_motion.tau[inside], atol=1e-9)


def test_a_log_on_disk_loses_its_load_piece_by_piece(study, tmp_path):
    study(LOAD)
    model, treatment = two_links(), haptid.Treatment(cutoff_hz=30.0, decimation=5)
    names = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("tau1", "tau2"), "N m"), "t")
    pyarrow.parquet.write_table(pa.table(loaded_columns(3)), tmp_path / "loaded.parquet")
    read, opened = (f(tmp_path / "loaded.parquet", names) for f in (haptid.read_log, haptid.open_log))
    whole, pieces = (log_without_payload(model, log, treatment, Payload("2", BODY)) for log in (read, opened))
    assert not isinstance(pieces.torque, np.ndarray)
    one, other = (haptid.observe(model, haptid.treat(log, treatment)) for log in (whole, pieces))
    np.testing.assert_allclose(
        haptid.estimate(one, haptid.OLS()).beta, haptid.estimate(other, haptid.OLS()).beta, rtol=1e-9
    )
    motion = haptid.treat(opened, treatment)
    lighter = haptid.observation.without_payload(model, motion, "2", BODY)
    assert not isinstance(lighter.tau, np.ndarray)
    third = haptid.observe(model, lighter)
    np.testing.assert_allclose(haptid.estimate(third, haptid.OLS()).beta, haptid.estimate(one, haptid.OLS()).beta)
    assert fingerprint(Plan.of(model, lighter)) != fingerprint(Plan.of(model, motion))


def test_kept_triangles_are_of_one_load(study, tmp_path):
    """A run that goes on does not take triangles that were made with another load."""
    kept = RFactorCache(tmp_path / "kept", least=1)
    with_load = haptid.identify(study(LOAD), cache=kept).estimate.beta
    without = haptid.identify(study(""), cache=kept).estimate.beta
    np.testing.assert_allclose(haptid.identify(study(""), cache=None).estimate.beta, without, rtol=1e-12)
    assert np.abs(with_load - without).max() > 1e-3


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("payload = { link = '2', mass = 0.0, com = [0, 0, 0] }", "logs.2.payload.mass"),
        ("payload = { link = '2', mass = 1.0, com = [0, 0] }", "logs.2.payload.com"),
        ("payload = { link = '2', mass = 1.0, com = [0, 0, 0], inertia = [1.0] }", "logs.2.payload.inertia"),
        ("payload = { mass = 1.0, com = [0, 0, 0] }", "logs.2.payload.link"),
    ],
)
def test_a_load_that_is_none_is_rejected(study, text, where):
    with pytest.raises(StudyFileError, match=where):
        study(text)


def test_a_load_on_no_link_is_rejected(study):
    with pytest.raises(UnknownNameError):
        haptid.identify(study("payload = { link = '9', mass = 1.0, com = [0, 0, 0] }"))


@pytest.mark.parametrize(
    ("text", "intervals"),
    [
        ("", e.ClusterRobust()),
        ('intervals = "cluster-robust"', e.ClusterRobust()),
        ('intervals = "block-jackknife"', e.BlockJackknife()),
        ('intervals = "classical"', e.Classical()),
        ('intervals = "sandwich"', e.Sandwich()),
        ('intervals = "fixed-b"', e.FixedB()),
        ('intervals = "block-bootstrap"', e.Bootstrap()),
        ('intervals = "profile-likelihood"', e.Profile()),
    ],
)
def test_intervals_of_a_study_reach_its_estimate(study, text, intervals):
    read = study(LOAD, f"[estimate]\n{text}")
    assert read.intervals == intervals
    made = haptid.identify(read)
    assert Result.of(made).estimate.intervals_description == intervals.name
    again = haptid.estimate(made.estimate.observation, haptid.WLS(), intervals)
    again = with_treatment_uncertainty(again, made.proposal.delays, made.proposal.effects)
    np.testing.assert_allclose(made.estimate.covariance, again.covariance)


def test_entropic_of_a_study(study):
    read = study(LOAD, '[estimate]\nmethod = "entropic"\nstrength = 2.0')
    assert read.method == haptid.estimation.Entropic(2.0)
    with pytest.raises(StudyFileError, match=r"estimate\.passes"):
        study(LOAD, '[estimate]\nmethod = "entropic"\npasses = 2')


def test_correlations_are_in_the_folder(study, tmp_path):
    made = haptid.identify(study(LOAD))
    haptid.Result.of(made).save(tmp_path)
    found = pyarrow.csv.read_csv(tmp_path / "correlation.csv").to_pydict()
    names = made.estimate.base.names
    assert tuple(found.pop("name")) == names == tuple(found)
    R = np.array([found[name] for name in names])
    np.testing.assert_array_equal(R, made.estimate.correlation)
    np.testing.assert_allclose(np.diag(R), 1.0)
    se = made.estimate.se
    np.testing.assert_allclose(R * np.outer(se, se), made.estimate.covariance, rtol=1e-12)
    assert np.linalg.eigvalsh(R).min() > -1e-9


def test_what_has_no_deviation_has_no_correlation():
    R = correlations(np.diag([4.0, 0.0]))
    np.testing.assert_array_equal(R, [[1.0, np.nan], [np.nan, 1.0]])
