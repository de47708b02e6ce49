"""A log with a locked joint adds to one with all joints moving; the locked motor's rows are left out."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from motions import multisine, truth
from small_study import two_links, write_study

SLOW = 0.05


def locked_columns(seed, noise=0.02, seconds=6.0):
    """A log with joint 2 clamped at 0.4 rad: its motor is off, whatever the joint bears."""
    model = two_links()
    q, qd, qdd = multisine(2, seconds, 2e-3, seed)
    q[1], qd[1], qdd[1] = 0.4, 0.0, 0.0
    tau = haptid.inverse_dynamics(model, truth(model) + 0.1, q, qd, qdd)
    tau += noise * np.random.default_rng(seed).standard_normal(tau.shape)
    return {"t": 2e-3 * np.arange(q.shape[1]), "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": 0.0 * tau[1]}


@pytest.fixture
def study(tmp_path):
    """The small study with a log of the locked joint added."""
    path = write_study(tmp_path)
    pyarrow.csv.write_csv(pa.table(locked_columns(5)), tmp_path / "locked.csv")
    entry = """
[[logs]]
path = "locked.csv"
[logs.channels]
time = "t"
position = { channels = ["q1", "q2"], unit = "rad", constant_ok = true }
torque = { channels = ["tau1", "tau2"], unit = "N m", constant_ok = true }
[treatment]
reversal_speed = 0.05"""
    path.write_text(path.read_text().replace("[treatment]", entry))
    return path


def test_a_locked_joint_adds_what_the_others_tell(study, tmp_path):
    done = CliRunner().invoke(app, ["identify", str(study), "--out", str(tmp_path / "out"), "--no-report"])
    assert done.exit_code == 0, done.output
    found = haptid.Result.load(tmp_path / "out")
    wanted = truth(found.model) + 0.1
    low, high = found.conf_int().T
    assert ((low < wanted) & (wanted < high)).mean() >= 0.8
    values = json.loads((tmp_path / "out" / "result.json").read_text())
    ours = [entry for entry in values["validation"] if entry["log"] == "locked.csv"]
    (held,) = (entry for entry in ours if entry["motor"] == "2")
    assert held["count"] == 0
    assert held["relative_error_percent"] is None
    assert [entry["relative_error_percent"] < 5 for entry in ours if entry is not held] == [True] * 2
    assert any("'q2' is 0.4 in every sample, as allowed" in note for note in values["notes"])


def test_the_sum_is_least_squares_of_all_rows_that_count():
    """By the normal equations of both observations, written out."""
    model, made = two_links(), []
    for seed, locked in ((1, False), (5, True)):
        q, qd, qdd = multisine(2, 4.0, 2e-3, seed)
        if locked:
            q[1], qd[1], qdd[1] = 0.4, 0.0, 0.0
        tau = haptid.inverse_dynamics(model, truth(model) + 0.1, q, qd, qdd)
        tau += 0.02 * np.random.default_rng(seed).standard_normal(tau.shape)
        treatment = haptid.Treatment(cutoff_hz=None, reversal_speed=SLOW)
        motion = haptid.Motion(2e-3, q.T, tau.T, treatment, rates=(qd.T, qdd.T))
        made.append(haptid.observe(model, motion))
    free, clamped = made
    assert [motor.rows.sum() > 0 for motor in clamped.motors] == [True, False]
    both = haptid.estimate(free + clamped, haptid.OLS())
    p = len(model.base)
    A, b = np.zeros((p, p)), np.zeros(p)
    for observation in made:
        for motor in observation.motors:
            R, z = motor.whole[:, :-1], motor.whole[:, -1]
            A[np.ix_(motor.columns, motor.columns)] += R.T @ R
            b[motor.columns] += R.T @ z
    np.testing.assert_allclose(both.beta, np.linalg.solve(A, b), rtol=1e-8)
    assert both.classical_covariance.trace() < haptid.estimate(free, haptid.OLS()).classical_covariance.trace()
    for method in (haptid.WLS(), haptid.GLS(), haptid.IRLS()):
        assert np.abs(haptid.estimate(free + clamped, method).beta - both.beta).max() < 0.1


def test_a_locked_joint_alone_does_not_tell_the_device():
    model = two_links()
    q, qd, qdd = multisine(2, 4.0, 2e-3, 5)
    q[1], qd[1], qdd[1] = 0.4, 0.0, 0.0
    tau = haptid.inverse_dynamics(model, truth(model), q, qd, qdd)
    motion = haptid.Motion(2e-3, q.T, tau.T, haptid.Treatment(cutoff_hz=None, reversal_speed=SLOW), rates=(qd.T, qdd.T))
    with pytest.raises(errors.IdentifiabilityError):
        haptid.estimate(haptid.observe(model, motion), haptid.WLS())


def test_all_joints_locked_are_no_rows():
    model = two_links()
    still = np.full((500, 2), 0.4)
    motion = haptid.Motion(
        2e-3, still, still, haptid.Treatment(cutoff_hz=None, reversal_speed=SLOW), rates=(0 * still,) * 2
    )
    with pytest.raises(errors.NoRowsError):
        haptid.observe(model, motion)
