"""The friction test recovers the simulated friction, with the smallest model that describes it."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.experiment import bench
from haptid.experiment.friction_test.choice import choose_friction
from haptid.experiment.friction_test.curve import ConstantVelocity, FrictionCurve, JointFriction, friction_curve
from motions import motion as multisine
from motions import truth
from sampling import of_share
from true_parameters import true_parameters

DEVICE = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
SPEEDS = (0.05, 0.1, 0.15, 0.25, 0.4, 0.7, 1.1, 1.8)
SWEEP = bench.Sweep((0.0, 0.2, 0.3), (0.5, 0.35, 0.35), SPEEDS, ramp=0.3)
BETA = truth(DEVICE)
FC, FV = ({k: BETA[DEVICE.base.names.index(f"{kind}{k}")] for k in "123"} for kind in ("FC", "FV"))


def swept(kind=SWEEP, beta=BETA, noise=2e-4, FS=0.0, VS=1.0, back=0.0):
    """A sweep with exact rates; Stribeck friction, and viscous friction that is larger backwards, on every row."""
    made = bench.plan(kind, DEVICE, 2e-3, np.random.default_rng(0))
    tau = haptid.inverse_dynamics(DEVICE, beta, made.q.T, made.qd.T, made.qdd.T).T
    tau = tau + FS * np.exp(-((made.qd / VS) ** 2)) * np.sign(made.qd) + back * np.minimum(made.qd, 0)
    tau = tau + noise * np.random.default_rng(1).standard_normal(tau.shape)
    return haptid.Motion(made.dt, made.q, tau, haptid.Treatment(cutoff_hz=None), rates=(made.qd, made.qdd))


@pytest.fixture(scope="module")
def curve():
    return friction_curve(DEVICE, swept())


def test_curve_is_the_friction_that_was_put_in(curve):
    assert [joint.name for joint in curve.joints] == ["1", "2", "3"]
    inside = []
    for joint in curve.joints:
        wanted = FC[joint.name] * np.sign(joint.velocity) + FV[joint.name] * joint.velocity
        speeds = SPEEDS if joint.name == "1" else SPEEDS[:-1]  # the others' stroke is too short for the fastest
        np.testing.assert_allclose(joint.velocity, [*(-v for v in speeds[::-1]), *speeds], rtol=1e-3)
        np.testing.assert_allclose(joint.torque, wanted, atol=2e-4)
        low, high = joint.conf_int().T
        inside += list((low <= wanted) & (wanted <= high))
    assert np.mean(inside) > 0.85


def test_what_depends_on_the_pose_alone_does_not_show(curve):
    """Law of the pairs: any torque of the position, the same in both directions, leaves the curve."""
    made = swept()
    bumpy = 0.1 * np.sin(9 * made.q) + 0.05 * made.q[:, [1, 2, 0]] + 0.2
    found = friction_curve(DEVICE, replace(made, tau=made.tau + bumpy))
    for one, other in zip(found.joints, curve.joints, strict=True):
        np.testing.assert_allclose(one.torque, other.torque, atol=5e-4)


def test_coulomb_and_viscous_are_enough_where_there_is_no_more(curve):
    chosen = choose_friction(curve)
    assert chosen.enough
    for joint in chosen.joints:
        assert joint.chosen.friction_model == "Coulomb and viscous"
        assert "are sufficient" in joint.sentence
        for name, true in (("FC", FC), ("FV", FV)):
            low, high = joint.chosen.conf_int()[name]
            assert low <= true[joint.label[-1]] <= high
    assert chosen.summary().count("\n") == 2
    assert curve.summary().count("\n") == 16 + 2 * 14 + 2


def test_stribeck_friction_is_found():
    chosen = choose_friction(friction_curve(DEVICE, swept(FS=0.01, VS=0.3)))
    assert not chosen.enough
    for joint in chosen.joints:
        assert joint.chosen.friction_model == "Stribeck"
        assert "not sufficient" in joint.sentence
        assert joint.chosen.values["FS"] == pytest.approx(0.01, rel=0.1)
        assert joint.chosen.values["VS"] == pytest.approx(0.3, rel=0.1)
        assert joint.chosen.error < 1


def test_friction_by_direction_is_found():
    chosen = choose_friction(friction_curve(DEVICE, swept(back=2e-3)))
    for joint in chosen.joints:
        assert joint.chosen.friction_model == "different by direction"
        assert joint.chosen.values["FV-"] - joint.chosen.values["FV+"] == pytest.approx(2e-3, rel=0.15)


def test_joints_with_no_such_friction_get_none_by_chance():
    """By AICc alone 10 of these 150 tests of three joints had one that is different by direction, or Stribeck."""
    rng, v = np.random.default_rng(5), np.array([-0.8, -0.4, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.4, 0.8])
    size = np.full(len(v), 0.01)

    def joint(name, more):
        torque = np.sign(v) + 0.5 * v + more * np.minimum(v, 0) + size * rng.normal(size=len(v))
        torque -= 0.5 * (torque[v > 0].mean() + torque[v < 0].mean())  # as of a curve
        return JointFriction(name, f"motor {name}", "N", v, torque, size, np.full(len(v), 20.0))

    def enough(more):
        return choose_friction(FrictionCurve(DEVICE, tuple(joint(name, more) for name in "123"), ())).enough

    assert np.mean([not enough(0.0) for _ in range(150)]) < 0.01 + of_share(0.01, 150)
    assert not any(enough(0.3) for _ in range(20))


def test_models_with_too_few_points_do_not_count_among_the_tests():
    """They counted with p = 1, and hid real friction: one model of one joint was tested at 0.01 over 14."""
    v = np.array([-0.8, -0.4, -0.2, 0.1, 0.2, 0.4, 0.8])

    def joint(name, v):
        torque = np.sign(v) + 0.5 * v + 0.3 * np.minimum(v, 0)
        return JointFriction(name, f"motor {name}", "N", v, torque, np.full(len(v), 0.01), np.full(len(v), 20.0))

    first, *others = joint("1", v), *(joint(name, v[[0, 1, 5, 6]]) for name in "234567")
    alone = choose_friction(FrictionCurve(DEVICE, (first,), ())).joints[0]
    chosen = choose_friction(FrictionCurve(DEVICE, (first, *others), ())).joints
    assert alone.p[:2] == (None, None)
    assert alone.p[3] is None  # of eight points or more
    assert 0.01 / 14 < alone.p[2] < 0.01
    assert chosen[0].p == alone.p
    assert chosen[0].chosen.friction_model == "different by direction"
    assert "Stribeck +inf, p = -;" in chosen[0].sentence
    assert all(one.p == (None,) * 4 and "too few velocities" in one.sentence for one in chosen[1:])


def test_coulomb_alone_is_reported_to_be():
    beta = BETA.copy()
    beta[[DEVICE.base.names.index(f"FV{k}") for k in "123"]] = 0.0
    chosen = choose_friction(friction_curve(DEVICE, swept(beta=beta)))
    assert sum(joint.chosen.friction_model == "Coulomb" for joint in chosen.joints) >= 2
    assert "Coulomb friction alone is." in chosen.summary()


def test_few_velocities_are_said_to_be_few():
    slow = replace(SWEEP, speeds=(0.4, 1.1))
    chosen = choose_friction(friction_curve(DEVICE, swept(slow)))
    assert "too few velocities" in chosen.joints[0].sentence


def test_with_a_model_all_joints_may_move(curve):
    estimate = haptid.estimate(haptid.observe(DEVICE, multisine(DEVICE, BETA, seconds=15.0, dt=4e-3)), haptid.OLS())
    slow, fast = (
        bench.Triangles(20.0, (0.0, 0.2, 0.3), (0.5, 0.35, 0.35), frequency) for frequency in ((0.1,), (0.4, 0.5, 0.6))
    )
    for kind in (slow, fast):
        found = friction_curve(DEVICE, swept(kind), estimate)
        for joint in found.joints:
            wanted = FC[joint.name] * np.sign(joint.velocity) + FV[joint.name] * joint.velocity
            np.testing.assert_allclose(joint.torque, wanted, atol=5e-4)
    alone = friction_curve(DEVICE, swept(), estimate)
    for one, other in zip(alone.joints, curve.joints, strict=True):
        np.testing.assert_allclose(one.torque, other.torque, atol=3e-4)


def test_joints_that_were_not_tested_are_named():
    made = bench.plan(SWEEP, DEVICE, 2e-3, np.random.default_rng(0))
    first = np.abs(made.qd[:, 1:]).max(axis=1) == 0
    whole = swept()
    rates = (made.qd[first], made.qdd[first])
    found = friction_curve(DEVICE, haptid.Motion(2e-3, whole.q[first], whole.tau[first], whole.treatment, rates=rates))
    assert [joint.name for joint in found.joints] == ["1"]
    assert "motor 2, motor 3" in found.notes[0]


def test_bench_sweep_gives_the_true_friction():
    """On the virtual bench, through encoders and the controller's command: as a user would have it."""
    chi = true_parameters(DEVICE)
    true = {"FC1": 0.026, "FC2": 0.0092, "FC3": 0.0091, "FV1": 7e-4, "FV2": 5e-4, "FV3": 4e-4}
    for name, value in true.items():
        chi[DEVICE.device.parameters.index[name]] = value
    controller = bench.Controller((40.0, 35.0, 14.0), (0.5, 0.4, 0.16))
    encoders = bench.Encoders((4000.0,), (13.3, 11.2, 11.2))
    setup = bench.Setup(DEVICE, chi, controller, encoders=encoders, physics=bench.Physics(5e-4))
    sweep = bench.Sweep((0.0, 0.2, 0.3), (0.3, 0.25, 0.25), (0.3, 0.7, 1.5), ramp=0.2)
    made = bench.simulate(
        setup, bench.plan(sweep, DEVICE, setup.dt, np.random.default_rng(0)), np.random.default_rng(1)
    )
    motion = haptid.Motion(made.dt, made.position, made.command * gains(), haptid.Treatment(cutoff_hz=40.0))
    chosen = choose_friction(friction_curve(DEVICE, motion))
    for joint in chosen.joints:
        plain = next(fit for fit in joint.fits if fit.friction_model == "Coulomb and viscous")
        assert plain.values["FC"] == pytest.approx(true[f"FC{joint.label[-1]}"], rel=0.03)
        low, high = plain.conf_int()["FV"]
        assert low <= true[f"FV{joint.label[-1]}"] <= high


def gains():
    return np.array([drive.gear_ratio * drive.torque_constant for drive in DEVICE.device.drives])


def test_motions_without_a_constant_velocity():
    with pytest.raises(errors.NoRowsError) as raised:
        friction_curve(DEVICE, multisine(DEVICE, BETA, seconds=4.0, dt=4e-3), constant=ConstantVelocity(tolerance=1e-3))
    assert raised.value.limit == 1e-3
    with pytest.raises(errors.SettingError) as raised:
        ConstantVelocity(shortest=0.0)
    assert raised.value.where == "shortest"
