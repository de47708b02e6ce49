"""Limits of motors along exciting motions: slopes, what they mean by another road, and what cannot be met."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.cli import app
from haptid.dynamics.kinematics import handle_motion
from haptid.dynamics.regressor import rows
from haptid.experiment.excitation import (
    FourierSeries,
    Gradients,
    Limits,
    MotionBounds,
    ScaledCondition,
    Search,
    design_excitation,
)
from motions import truth

PHANTOM = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
BETA = truth(PHANTOM)
COVARIANCE = np.diag((0.3 * BETA) ** 2)
WITHIN = Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,))
NOISE = np.array([0.001, 0.002, 0.004])
LIMITS = {
    "jerk": {"jerk": (60.0,)},
    "rms torque": {"rms_torque": (0.03, 0.04, 0.05)},
    "power": {"power": (0.05,)},
    "force at the handle": {"handle_force": 0.3},
    "confidence": {"torque": (0.1,), "torque_confidence": 0.95},
}


def bounds_of(**more):
    return MotionBounds.of(PHANTOM, replace(WITHIN, **more), BETA, COVARIANCE)


def random_states(seed, count=60):
    """Away from rest: friction jumps there."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(-1, 1, (3, 3, count)) * np.array([0.4, 2.0, 8.0])[:, None, None]
    states[1] += 0.05 * np.sign(states[1])
    return states


@pytest.mark.parametrize("name", LIMITS)
def test_slopes_are_those_of_the_violations(name):
    gradients = Gradients.of(bounds_of(**LIMITS[name]), ScaledCondition(), tuple(range(len(BETA))), NOISE, dt=0.02)
    states, way, step = random_states(1), random_states(2), 1e-6
    penalty = lambda t: gradients.at(states + t * way).penalties(10.0)[0]  # noqa: E731
    slope = (penalty(step) - penalty(-step)) / (2 * step)
    assert np.sum(gradients.at(states).penalties(10.0)[1] * way) == pytest.approx(slope, rel=1e-4)
    assert any(name.split()[-1] in what for _, what in gradients.at(states).excesses)


def test_violations_by_another_road():
    states = random_states(3)
    q, qd, qdd = states
    tau = haptid.inverse_dynamics(PHANTOM, BETA, q, qd, qdd)
    made = {what: x for x, what in bounds_of(**LIMITS["power"], handle_force=0.3).by_sample(states)}
    np.testing.assert_allclose(made["the power of motor 2"], np.abs(tau[1] * qd[1]) / 0.05 - 1, rtol=1e-9)
    J = handle_motion(PHANTOM, q).jacobian[:, :3]
    force = np.linalg.solve(J.transpose(0, 2, 1), tau.T[:, :, None])[..., 0]
    expected = np.linalg.norm(force, axis=1) / 0.3 - 1
    np.testing.assert_allclose(made["the force at the handle"], expected, rtol=1e-6)
    (rms,) = [x for x, what in bounds_of(**LIMITS["rms torque"]).over_time(states, 0.02) if "motor 3" in what]
    assert rms[0] == pytest.approx(np.sqrt(np.mean(tau[2] ** 2)) / 0.05 - 1)


def test_confidence_is_the_share_of_devices_that_keep_the_torque():
    """Parameters drawn from their covariance: where the limit is just met, 95 of 100 devices keep it."""
    states = random_states(4, 40)
    made = [x for x, what in bounds_of(**LIMITS["confidence"]).by_sample(states) if "95 % confidence" in what]
    drawn = np.random.default_rng(0).multivariate_normal(BETA, COVARIANCE, 4000)
    W = rows(PHANTOM, *(np.ascontiguousarray(x) for x in states))
    W = np.einsum("apk,pb->akb", W, PHANTOM.device.parameters.S[:, list(PHANTOM.base.independent_columns)])
    for row in range(3):
        tau, planned = W[row] @ drawn.T, W[row] @ BETA
        limit = 0.1 * (1 + made[row])
        share = (tau * np.sign(planned)[:, None] <= limit[:, None]).mean(axis=1)
        spread = np.sqrt(0.95 * 0.05 / 4000)
        assert np.abs(share - 0.95).max() < stats.norm.ppf(1 - 0.001 / 240) * spread


def test_the_motion_found_keeps_every_limit():
    wanted = replace(
        WITHIN,
        acceleration=(25.0,),
        jerk=(300.0,),
        torque=(0.3,),
        torque_confidence=0.99,
        rms_torque=(0.1,),
        power=(0.25,),
        handle_force=1.0,
    )
    found = design_excitation(
        PHANTOM, FourierSeries(8.0, 0.2, 4), wanted, beta=BETA, covariance=COVARIANCE, search=Search(tries=200, seed=2)
    )
    made = found.trajectory(1e-3)
    tau = haptid.inverse_dynamics(PHANTOM, BETA, made.q.T, made.qd.T, made.qdd.T)
    assert np.abs(np.diff(made.qdd, axis=0)).max() / 1e-3 <= 300.0
    assert np.abs(made.qdd).max() <= 25.0
    assert np.sqrt((tau**2).mean(axis=1)).max() <= 0.1
    assert np.abs(tau * made.qd.T).max() <= 0.25
    J = handle_motion(PHANTOM, made.q.T).jacobian[:, :3]
    assert np.linalg.norm(np.linalg.solve(J.transpose(0, 2, 1), tau.T[:, :, None])[..., 0], axis=1).max() <= 1.0
    rng = np.random.default_rng(1)
    for beta in rng.multivariate_normal(BETA, COVARIANCE, 50):
        other = haptid.inverse_dynamics(PHANTOM, beta, made.q.T, made.qd.T, made.qdd.T)
        assert (np.abs(other) <= 0.3).mean() > 0.99


def test_what_no_motion_keeps_is_named_with_its_figure():
    with pytest.raises(errors.TrajectoryError) as raised:
        design_excitation(
            PHANTOM,
            FourierSeries(8.0, 0.2, 4),
            replace(WITHIN, rms_torque=(1e-3,), power=(1e-5,)),
            beta=BETA,
            search=Search(tries=40),
        )
    text = str(raised.value)
    assert "the rms torque of motor 1 by" in text
    assert "the power of motor 3 by" in text
    assert raised.value.found > 0


def test_limits_without_a_meaning():
    with pytest.raises(errors.SettingError, match="probability"):
        Limits(torque_confidence=95.0)
    with pytest.raises(errors.SettingError, match="needs a maximum torque"):
        bounds_of(torque_confidence=0.9)
    with pytest.raises(errors.SettingError, match="power has to be above 0"):
        bounds_of(power=(0.1, -1.0, 0.1))
    plain = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    ranges = Limits(((-1.0, 1.0),) * 3, (1.0,), torque=(1.0,), torque_confidence=0.9)
    with pytest.raises(errors.SettingError, match="no prior has a standard deviation"):
        MotionBounds.of(plain, ranges, np.ones(len(plain.base)))


def test_limits_of_the_command(tmp_path):
    common = ("excite", "phantom_premium_15", "--centre", "0,0.2,0.3", "--stroke", "0.6,0.4,0.4", "--speed", "3")
    limits = ("--jerk", "600", "--rms-torque", "0.5", "--power", "1,1,2", "--handle-force", "5", "--torque", "1")
    out = tmp_path / "x.toml"
    done = CliRunner().invoke(app, [*common, *limits, "--max-evaluations", "30", "--out", str(out)])
    assert done.exit_code == 0, done.output
    done = CliRunner().invoke(app, [*common, "--rms-torque", "1e-6", "--max-evaluations", "10", "--out", str(out)])
    assert done.exit_code == 2
    assert "the rms torque of motor" in done.stderr
    done = CliRunner().invoke(app, [*common, "--power", "1,2", "--out", str(out)])
    assert done.exit_code == 2
    assert "3 numbers" in done.stderr
