"""Held poses: found in a log, read from a table, and the gravity that they determine."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import haptid
from haptid import errors
from haptid.device.priors import PriorBody
from held_poses import FRICTION, SCATTER, channels, held_log, rigid_beta
from motions import motion
from true_parameters import true_parameters


@pytest.fixture(scope="module")
def arm():
    return haptid.DynamicModel(haptid.read_device("arm3"))


@pytest.fixture(scope="module")
def chi(arm):
    return true_parameters(arm, FV=0.05, FC=0.0)


@pytest.fixture(scope="module")
def log(arm, chi):
    return held_log(arm, rigid_beta(arm, chi), 1)


@pytest.fixture(scope="module")
def poses(arm, log):
    return haptid.motion.find_poses(arm.device, log)


def test_every_hold_is_found_with_its_approach(poses):
    """27 configurations from below and from above, and the rest at the end."""
    assert len(poses) == 55
    assert poses.configurations in (27, 28)
    np.testing.assert_array_equal(poses.approach[:54], np.tile([[1.0] * 3, [-1.0] * 3], (27, 1)))
    assert (np.bincount(poses.configuration)[:26] >= 2).all()
    assert (poses.samples >= 0.5 * 50 * 0.5).all()


def test_the_noise_of_a_mean_is_that_of_its_samples(poses):
    expected = 0.02 / np.sqrt(poses.samples)
    ratio = np.sqrt(np.mean((poses.se / expected[:, None]) ** 2))
    # Standard deviation of the root mean square of 165 estimates with 7 degrees of freedom: 2.1 %.
    assert ratio == pytest.approx(1.0, abs=5 * 0.021)


def test_a_joint_that_rests_while_others_move_has_no_row(arm, chi):
    """Without an approach from both sides one joint moves at a time; friction would carry the others' change."""
    poses = haptid.motion.find_poses(arm.device, held_log(arm, rigid_beta(arm, chi), 1, approach=None))
    moved = np.isfinite(poses.approach)
    assert (moved[1:-1].sum(axis=1) == 1).all()
    rows = haptid.observation.observe_poses(haptid.dynamics.static_model(arm), poses)
    np.testing.assert_array_equal([motor.rows.sum() for motor in rows.motors], moved.sum(axis=0))
    assert any("has not moved" in note for note in rows.notes)


def test_static_rows_are_the_inverse_dynamics_at_rest(arm, chi):
    model, rng = haptid.dynamics.static_model(arm), np.random.default_rng(2)
    q = rng.uniform(-1, 1, (3, 20))
    still = np.zeros_like(q)
    truth = haptid.inverse_dynamics(arm, arm.base.of(chi), q, still, still)
    np.testing.assert_allclose(model.torque(model.base.of(chi), q), truth, atol=1e-12)
    side = rng.choice([-1.0, 1.0], q.shape)
    with_friction = chi + [FRICTION if kind == "FC" else 0.0 for kind in arm.device.parameters.kinds]
    np.testing.assert_allclose(model.torque(model.base.of(with_friction), q, side), truth + FRICTION * side, atol=1e-12)


def test_static_base_parameters_are_found_by_themselves(arm):
    """Of 45 standard parameters gravity has four groups, as closed forms have them, and friction three."""
    base = haptid.dynamics.static_model(arm).base
    assert base.names == ("MX2R", "MY2", "MX3", "MY3", "FC1", "FC2", "FC3")
    assert base.groupings[0] == "MX2 + 0.22 M3"
    assert {"ZZ3", "IA1", "FV2", "MX1"} <= set(base.no_effect)


def test_gravity_and_friction_come_back_inside_their_intervals(arm, chi):
    """Six recordings; hits are binomial at 95 %."""
    inside = []
    truth = chi + [FRICTION * (1 - SCATTER) if kind == "FC" else 0.0 for kind in arm.device.parameters.kinds]
    for seed in range(6):
        found = haptid.identify_poses(
            arm, haptid.motion.find_poses(arm.device, held_log(arm, rigid_beta(arm, chi), seed))
        )
        low, high = found.estimate.conf_int().T
        inside.append((low <= found.model.base.of(truth)) & (found.model.base.of(truth) <= high))
    assert np.sum(inside) >= stats.binom.ppf(1e-4, np.size(inside), 0.95)


def test_friction_at_rest_is_a_range_and_no_interval_of_coulomb_friction(arm, chi):
    """Holds keep 0.6 to 1 of the Coulomb friction: the interval of the mean misses it, the range reaches to it."""
    log = held_log(arm, rigid_beta(arm, chi), 3, scatter=0.2)
    found = haptid.identify_poses(arm, haptid.motion.find_poses(arm.device, log))
    assert [name for name in found.estimate.base.names if name.startswith("FC")] == ["FC1", "FC2", "FC3"]
    assert not any(one["name"].startswith("FC") for one in found.to_json()["parameters"])
    assert "FC1" not in found.summary()
    assert "ranges, not intervals" in found.summary()
    intervals = dict(zip(found.estimate.base.names, found.estimate.conf_int(), strict=True))
    for one, name in zip(found.friction, ("FC1", "FC2", "FC3"), strict=True):
        assert intervals[name][1] < FRICTION
        # Both sides of a configuration are averaged; gravity errors and noise are a tenth of the friction.
        assert 0.6 * FRICTION - 0.1 * FRICTION < one.least < one.mean < one.greatest < 1.1 * FRICTION
        assert one.mean == pytest.approx(0.8 * FRICTION, rel=0.1)
        assert one.greatest - one.least > 0.15 * FRICTION


def test_a_pose_of_a_configuration_is_not_predicted_by_the_other(arm, poses):
    observation = haptid.observation.observe_poses(haptid.dynamics.static_model(arm), poses)
    assert len(observation.blocks) == poses.configurations
    even, odd = observation.alternate()
    found = haptid.estimate(even, haptid.WLS())
    assert haptid.validate(found, odd).relative < 10.0
    with pytest.raises(errors.SharedRowsError):
        haptid.validate(found, even)


def test_gravity_compensation_is_judged_by_unseen_poses(arm, chi, poses):
    first, second, third = haptid.identify_poses(arm, poses).verdicts
    assert first.verdict == "not needed"
    assert (second.verdict, third.verdict) == ("worth it", "worth it")
    assert second.explained > 99
    assert second.left < 0.1 * second.friction
    assert second.friction == pytest.approx(FRICTION * (1 - SCATTER), rel=0.1)
    assert "worth it" in second.sentence
    sticky = held_log(arm, rigid_beta(arm, chi), 3, friction=5.0, scatter=0.0)
    assert [v.verdict for v in haptid.identify_poses(arm, haptid.motion.find_poses(arm.device, sticky)).verdicts] == [
        "not needed"
    ] * 3
    rng = np.random.default_rng(4)
    noise = replace(poses, tau=poses.approach * 0.01 + rng.normal(size=poses.tau.shape))
    assert [v.verdict for v in haptid.identify_poses(arm, noise).verdicts[1:]] == ["unproven"] * 2


def test_what_poses_do_not_determine_is_left_out_with_a_sentence(arm, chi):
    """The elbow stays, so its moments are told from the upper arm's by no pose."""
    log = held_log(arm, rigid_beta(arm, chi), 1, amplitude=(0.8, 0.6, 0.0), points=3, approach=None)
    found = haptid.identify_poses(arm, haptid.motion.find_poses(arm.device, log))
    assert {"MX3", "MY3"} & set(" ".join(found.left_out).replace(",", "").split())
    assert len(found.estimate.beta) < 7
    assert np.isfinite(found.estimate.beta).all()
    assert "record motion" in found.left_out[0]


def test_mass_and_moments_of_a_payload_come_from_poses_and_no_inertia(arm, chi, poses):
    body = PriorBody(0.5, np.array([0.2, 0.03, 0.01]), None)
    heavy = held_log(arm, rigid_beta(arm, chi) + haptid.observation.payload_torque(arm, "3", body), 2)
    loaded = haptid.motion.find_poses(arm.device, heavy)
    found = haptid.identify_payloads(arm, poses, [(haptid.inference.AttachedBody("weight", "3"), loaded)])["weight"]
    assert found.parameters.names == ("MX3", "MY3", "M3")
    assert found.body.names == ("mass", "com x", "com y")
    assert found["mass"] == pytest.approx(0.5, rel=0.02)
    assert found["com x"] == pytest.approx(0.2, abs=0.005)
    assert "do not determine the inertia" in found.left_out[0]
    known = haptid.inference.AttachedBody("weight", "3", mass=0.5)
    gains = haptid.identify_payloads(arm, poses, [(known, loaded)], gains=True).gains
    assert gains.quantities.names == ("motor 2", "motor 3")
    assert "motor 1 is left out" in gains.left_out[0]
    np.testing.assert_allclose(gains.values, 1.0, atol=0.05)
    with pytest.raises(errors.SettingError, match="mixed"):
        haptid.identify_payloads(arm, motion(arm, rigid_beta(arm, chi), seconds=2.0), [(known, loaded)])


def test_a_table_with_one_row_a_pose_is_the_same(arm, poses, tmp_path):
    head, rows = poses.table()
    with (tmp_path / "poses.csv").open("w", newline="") as file:
        csv.writer(file).writerows([head, *[["" if x != x else x for x in row] for row in rows]])
    names = ("approach1", "approach2", "approach3")
    timeless = replace(channels(3), time=None, rate_hz=1.0)
    read = haptid.motion.read_poses(tmp_path / "poses.csv", arm.device, timeless, names)
    np.testing.assert_allclose(read.tau, poses.tau)
    np.testing.assert_array_equal(read.approach, poses.approach)
    one, other = (haptid.identify_poses(arm, p).estimate.beta for p in (poses, read))
    np.testing.assert_allclose(one, other, rtol=1e-9)
    with pytest.raises(errors.LogChannelError):
        haptid.motion.read_poses(tmp_path / "poses.csv", arm.device, timeless, ("approach1", "approach2", "approach9"))


def test_two_recordings_of_poses_are_one(arm, chi, poses):
    other = haptid.motion.find_poses(arm.device, held_log(arm, rigid_beta(arm, chi), 5))
    both = haptid.motion.join_poses(poses, other)
    assert len(both) == len(poses) + len(other)
    assert both.configurations == poses.configurations + other.configurations
    assert haptid.identify_poses(arm, both).estimate.se[0] < haptid.identify_poses(arm, poses).estimate.se[0]


@pytest.mark.parametrize("settings", [{"hold_s": 0.0}, {"settle_s": 0.3}, {"still": (0.0,)}])
def test_a_hold_that_is_none_is_refused(settings):
    with pytest.raises(errors.TreatmentError):
        haptid.motion.HoldDetection(**settings)


def test_a_log_without_holds_is_refused(arm, log):
    with pytest.raises(errors.NoRowsError, match="rests"):
        haptid.motion.find_poses(arm.device, log, haptid.motion.HoldDetection(hold_s=5.0))
