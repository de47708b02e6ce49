"""Elastic motors: a model against a closed form, the bench against the model, recovery from both sides."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import haptid
from elastic_motors import (
    FV,
    FVM,
    IA,
    TERMS,
    TRUTH,
    D,
    J,
    K,
    arm,
    assert_within,
    axis,
    quasi_static,
    recorded,
    treated,
)
from haptid.end_effector import GivenParameters
from haptid.end_effector.datasheet.structure import structural_frequency
from haptid.errors import (
    DeviceFileError,
    ExperimentError,
    IdentifiabilityError,
    LogMismatchError,
    LogTimeError,
    SettingError,
)
from haptid.estimation import MotorSide
from haptid.estimation.nonlinear import variable_projection
from haptid.experiment import bench
from haptid.log.spectrum import spectra
from haptid.treatment_choice.elasticity import expect_elasticity, expect_fast_sampling, noise_shares, with_bounds
from haptid.treatment_choice.hidden_joints import complete_logs
from haptid.treatment_choice.noise_effect import encoder_noise, noise_effect, possible_noise
from haptid.uncertainty.figures import per_cent


def test_inverse_dynamics_of_one_axis_is_the_closed_form():
    model, rng = axis(), np.random.default_rng(0)
    assert model.base.names == ("ZZ1", "KE1", "DE1", "IAM1", "FV1", "FVM1")
    beta = np.array([TRUTH[name] for name in model.base.names])
    (q, th), (qd, thd), (qdd, thdd) = motion = rng.standard_normal((3, 2, 50))
    found = haptid.inverse_dynamics(model, beta, *motion)
    spring = K * (th - q) + D * (thd - qd)
    motor = IA * thdd + FVM * thd + spring
    link = J * qdd + FV * qd - spring
    np.testing.assert_allclose(found, [motor, motor + link], atol=1e-12 * K)


def test_exact_base_parameters_are_the_numeric_ones():
    model = arm()
    exact = model.regroupings
    assert set(exact.names) == set(model.base.names)
    assert {"KEa", "DEa", "KEb", "DEb"} <= set(model.base.names)


def test_forward_dynamics_is_spongs_model():
    """Links and rotors are coupled by springs alone; the rigid model of the links comes from a device of its own."""
    model = arm()
    rigid = axis(gravity=[0.0, -9.81, 0.0], joints=[{"name": "1"}, {"name": "2", "d": 0.3}], terms=[TERMS[2]])
    rng = np.random.default_rng(3)
    values = dict(zip(model.device.parameters.names, rng.uniform(0.5, 1.5, len(model.device.parameters)), strict=True))
    chi = np.array([values[name] for name in model.device.parameters.names])
    links = np.array([values[name] for name in rigid.device.parameters.names])
    q, qd, qdd, th, thd, thdd = rng.standard_normal((6, 2, 20))
    rows = haptid.inverse_dynamics(
        model, model.base.of(chi), *(np.concatenate(x) for x in ((q, th), (qd, thd), (qdd, thdd)))
    )
    N = np.array([[1.0, 0.0], [0.5, 1.0]])
    stiff, damp, inert, viscous = (np.array([[values[f"{x}{m}"]] for m in "ab"]) for x in ("KE", "DE", "IAM", "FVM"))
    spring = stiff * (th - N @ q) + damp * (thd - N @ qd)
    motors = inert * thdd + viscous * thd + spring
    joints = haptid.inverse_dynamics(rigid, rigid.base.of(links), q, qd, qdd) - N.T @ spring
    np.testing.assert_allclose(rows[:2], motors, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(rows[2:], joints + N.T @ motors, rtol=1e-9, atol=1e-9)


def test_structural_frequencies_are_the_closed_form_with_their_intervals():
    """Of one axis: the link on its spring with the motor held, rotor and link against each other with it free."""
    model = axis()
    names = model.base.names
    beta, pose = np.array([TRUTH[name] for name in names]), np.zeros((2, 1))
    covariance = np.diag([(0.01 * TRUTH[name]) ** 2 for name in names])
    known = GivenParameters(model, beta, covariance)
    held, free = (structural_frequency(known, pose, held) for held in (True, False))
    np.testing.assert_allclose(held.values, np.sqrt(K / J) / (2 * np.pi), rtol=1e-9)
    np.testing.assert_allclose(free.values, np.sqrt(K / J + K / IA) / (2 * np.pi), rtol=1e-9)
    # Relative deviations of 1 % of each: half of the root of the sum of squares of their shares.
    np.testing.assert_allclose(held.se, 0.005 * np.sqrt(2) * held.values, rtol=1e-9)
    shares = np.array([1.0, IA / (J + IA), J / (J + IA)])
    np.testing.assert_allclose(free.se, 0.005 * np.linalg.norm(shares) * free.values, rtol=1e-9)


def test_structural_frequencies_of_an_arm_are_those_of_its_linearised_equations():
    """Eigenvalues of the forward dynamics, differentiated numerically, with gravity and damping at zero."""
    joints = [{"name": "1"}, {"name": "2", "d": 0.3}]
    motors = [{"name": "a", "drives": {"1": 1.0}}, {"name": "b", "drives": {"1": 0.5, "2": 1.0}}]
    terms = [{**TERMS[0], "damping": False}, TERMS[1]]
    model = axis(gravity=[0.0, 0.0, 0.0], joints=joints, motors=motors, terms=terms)
    index = model.device.parameters.index
    chi = np.zeros(len(index))
    for name, value in {"ZZ1": 0.06, "ZZ2": 0.06, "MX2": 0.15, "M2": 1.0, "KEa": 400.0, "KEb": 300.0}.items():
        chi[index[name]] = value
    chi[[index["IAMa"], index["IAMb"]]] = 0.02, 0.03
    beta, zero = model.base.of(chi), np.zeros((4, 1))
    pose = np.array([[0.3], [0.7], [0.3], [0.85]])  # no torsion

    def torque(q: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.asarray(haptid.inverse_dynamics(model, beta, q, zero, a))[:, 0]

    M = np.array([torque(pose, unit[:, None]) for unit in np.eye(4)]).T
    moved = [torque(pose + 1e-6 * u[:, None], zero) - torque(pose - 1e-6 * u[:, None], zero) for u in np.eye(4)]
    stiff = np.array(moved).T / 2e-6
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(M, stiff)).real)
    found = structural_frequency(GivenParameters(model, beta), pose, held=False)
    np.testing.assert_allclose(found.values, np.sqrt(squares[2]) / (2 * np.pi), rtol=1e-6)


def test_the_bench_moves_as_the_model_says():
    pytest.importorskip("mujoco")
    model = arm()
    chi = np.zeros(len(model.device.parameters))
    given = {"XX": 0.03, "YY": 0.06, "ZZ": 0.06, "MX": 0.15, "M": 1.0}
    index = model.device.parameters.index
    for name, value in given.items():
        for link in "12":
            chi[index[f"{name}{link}"]] = value
    for motor in "ab":
        for name, value in {"KE": 400.0, "DE": 0.4, "IAM": 0.02, "FVM": 0.05}.items():
            chi[index[f"{name}{motor}"]] = value
    controller = bench.Controller((40.0,), (1.5,), gravity=True)
    setup = bench.Setup(model, chi, controller)
    kind = bench.Multisine(2.5, (0.0,), (0.5,), ramp=0.5)
    made = bench.simulate(setup, bench.plan(kind, model, setup.dt, np.random.default_rng(0)), np.random.default_rng(1))
    rows = haptid.inverse_dynamics(model, model.base.of(chi), made.q.T, made.qd.T, made.qdd.T)
    applied = model.device.row_torque(model.device.row_map @ made.q.T, made.torque.T)
    np.testing.assert_allclose(rows, applied, atol=1e-6 * np.abs(applied).max())
    assert np.abs(made.qd[0]).max() < 1e-12
    assert np.abs(made.qdd[:5]).max() < 0.2


def test_both_sides_give_stiffness_and_damping():
    model = axis()
    found = haptid.estimate(haptid.observe(model, treated(recorded())), haptid.WLS())
    assert_within(found)
    assert found["KE1"].relative_se < 0.5
    assert found["DE1"].relative_se < 2.0


def sensed_axis() -> haptid.DynamicModel:
    return axis(terms=[{**TERMS[0], "sensor": True}, *TERMS[1:]])


def test_rows_of_an_elastic_device_pass_the_motion_alone():
    """Unseen rows prefer three times the motion: they do not show how noise divides inertia of rotor and link."""
    proposal = haptid.propose(axis(), recorded(seconds=6.0))
    assert proposal.treatment.parallel_cutoff_hz <= 1.5 * proposal.bandwidth_hz


def test_a_torque_sensor_gives_stiffness_and_its_own_offset():
    """Rows of rotor, spring and link, each with the torque that acts on it; the link's are free of the motor's."""
    model, log, without = sensed_axis(), recorded(offset=0.7), recorded()
    found = haptid.estimate(haptid.observe(model, treated(log)), haptid.WLS())
    for name, value, se in zip(found.names, found.beta, found.se, strict=True):
        assert abs(value - {**TRUTH, "OS1": 0.7}[name]) < 3.5 * se, (name, value, se)
    both = haptid.estimate(haptid.observe(axis(), treated(without)), haptid.WLS())
    for name in ("KE1", "DE1"):
        assert found[name].se < 0.5 * both[name].se


def test_the_default_path_takes_a_torque_sensor():
    proposal = haptid.propose(sensed_axis(), recorded(offset=0.7))
    assert np.abs(proposal.treatment.torque_delay_s).max() < 5e-5
    assert len(proposal.treatment.torque_delay_s) == 2


def test_positions_of_the_links_are_required_beside_a_torque_sensor():
    model, both = sensed_axis(), recorded(seconds=6.0, offset=0.7)
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), both.channels.torque, "t")
    log = haptid.Log(Path("made"), "", both.t, both.position[:, 1:], both.torque, channels)
    with pytest.raises(LogMismatchError, match="torque sensor") as caught:
        complete_logs(model, [log], [True])
    assert "sensor = false" in caught.value.advice


@cache
def with_play(play: float, seconds: float = 5.0) -> haptid.Log:
    """Both sides of the axis on the bench, with play between them; its torsion counts from 1.5 mrad."""
    pytest.importorskip("mujoco")
    model = axis(terms=[{**TERMS[0], "play": play} if play else TERMS[0], *TERMS[1:]])
    values = {**TRUTH, "XX1": J, "YY1": J, "M1": 1.0}
    chi = np.array([values.get(name, 0.0) for name in model.device.parameters.names])
    amplifiers = bench.Amplifiers(noise=(0.02,))
    setup = bench.Setup(model, chi, bench.Controller((60.0,), (2.0,)), bench.Encoders((320000.0,)), amplifiers)
    kind = bench.Multisine(seconds, (0.0,), (0.6,), frequencies_hz=(0.3, 6.0), count=8)
    made = bench.simulate(setup, bench.plan(kind, model, setup.dt, np.random.default_rng(0)), np.random.default_rng(1))
    seen = np.ascontiguousarray(made.position + np.array([0.0, 0.0015]))
    return haptid.Log(Path("made"), "", made.t, seen, np.ascontiguousarray(made.command), recorded().channels)


def test_play_and_the_zero_of_the_torsion_are_within_their_intervals():
    log, ranges = with_play(0.004), {"play": {"start": 0.001}, "rest": {"start": 0.0, "low": -0.01, "high": 0.01}}
    model = axis(terms=[{**TERMS[0], **ranges}, *TERMS[1:]])
    found = variable_projection(model, [haptid.treat(log, haptid.propose(model, log).treatment)])
    for name, true in (("KE1.play", 0.004), ("KE1.rest", 0.0015)):
        constant = found[name]
        assert constant.unit == "rad"
        assert abs(constant.value - true) < 3.5 * constant.se, constant
        assert constant.se < 0.05 * true


def test_wrong_elastic_terms_are_clear_errors():
    def refused(*terms: dict[str, object]) -> DeviceFileError:
        with pytest.raises(DeviceFileError) as caught:
            axis(terms=list(terms))
        return caught.value

    assert "rotor has no inertia" in str(refused(TERMS[0]))
    assert "acts on motors" in str(refused({"kind": "elastic", "joints": "all"}, TERMS[1]))
    assert "already taken" in str(refused(TERMS[0], TERMS[0], TERMS[1]))
    assert "motor" in str(refused({"kind": "elastic", "motors": ["x"]}, TERMS[1]))


def test_missing_stiffness_and_missing_springs_are_clear_errors():
    rigid = axis(terms=TERMS[2:3])
    motion = haptid.treat(
        haptid.Log(
            Path("made"),
            "",
            recorded().t,
            recorded().position[:, :1],
            recorded().torque,
            haptid.Channels(haptid.Signal(("q",), "rad"), haptid.Signal(("u",), "N m", side="motor"), "t"),
        ),
        haptid.Treatment(cutoff_hz=80.0, decimation=10),
    )
    with pytest.raises(SettingError, match="no elastic motor"):
        haptid.estimate(haptid.observe(rigid, motion), MotorSide())
    model = axis()
    setup = bench.Setup(model, np.zeros(len(model.device.parameters)), bench.Controller((1.0,), (0.1,)))
    with pytest.raises(ExperimentError, match="stiffness KE1 is 0"):
        bench.elastic.balanced_start(model, setup.chi, np.zeros(2))


@cache
def rows_of(motion: haptid.Motion, found: haptid.Estimate) -> np.ndarray:
    """Weighted rows of the axis in closed form, both one below the other, (2 rows, p); the ends have none."""
    weights, end = found.weights, (len(motion) - int(found.observation.motors[0].rows.sum())) // 2
    (q, th), (v, w), (a, b) = (np.asarray(x) for x in motion.kinematics(end, len(motion) - end))
    zero = np.zeros_like(q)
    motor = np.column_stack([zero, th - q, w - v, b, zero, w])
    whole = np.column_stack([a, zero, zero, b, v, w])
    return np.concatenate([weights[0] * motor, weights[1] * whole])


def test_shares_of_noise_are_those_of_rows_in_closed_form():
    """What other columns do not explain of a column, and the added noise in it."""
    settings, log = haptid.Treatment(cutoff_hz=12.0), quasi_static(1.5e-5)
    noisy, clean = (haptid.treat(one, settings) for one in (log, quasi_static(0.0)))
    found = haptid.estimate(haptid.observe(axis(), noisy), haptid.WLS())
    W = rows_of(noisy, found)
    D = W - rows_of(clean, found)
    V = np.linalg.pinv(W.T @ W)
    expected = np.linalg.norm(D @ V, axis=0) ** 2 / np.linalg.norm(W @ V, axis=0) ** 2
    assert 0.02 < expected[1] < 0.5
    shares = noise_shares(found, [log], [log.position - quasi_static(0.0).position])
    np.testing.assert_allclose(shares, expected, rtol=0.01)


def test_noise_of_the_positions_is_no_more_than_the_residual_holds():
    """A spectrum may take motion for noise; what the encoders do have is not reduced."""
    clean, settings = recorded(seconds=10.0), haptid.Treatment(cutoff_hz=40.0, decimation=10, parallel_cutoff_hz=16.0)
    rough = 1e-3 * np.random.default_rng(0).standard_normal(clean.position.shape)
    for log, times, reduced in ((clean, 1e6, True), (replace(clean, position=clean.position + rough), 1.0, False)):
        rows = haptid.observe(axis(), haptid.treat(log, settings))
        found = [replace(one, noise=times * one.noise) for one in spectra(log)]
        made = haptid.estimate(rows, haptid.WLS())
        (noise,) = possible_noise(rows, made.beta, [log], [found])
        share = noise.std(axis=0) / encoder_noise([log], [found])[0].std(axis=0)
        assert (share < 0.1).all() if reduced else (share > 0.7).all()
        effect = noise_effect(made, [log], [found], settings)["encoder noise"]
        # Hundreds of times the encoders' own noise would move damping and friction by a tenth.
        assert (np.abs(effect[0]) < 0.01 * np.abs(made.beta)).all()


@pytest.mark.parametrize("noise", [0.4, 4.0])
def test_stiffness_and_damping_that_are_not_well_known_are_told_with_their_bounds(noise):
    """Torque noise leaves the damping open, which a note says in per cent, above 100 % too."""
    good = haptid.estimate(haptid.observe(axis(), treated(recorded())), haptid.WLS())
    assert with_bounds(good, 11.0).notes == good.notes
    rough = np.random.default_rng(0).standard_normal(recorded().torque.shape)
    noisy = replace(recorded(), torque=recorded().torque + noise * recorded().torque.std() * rough)
    poor = haptid.estimate(haptid.observe(axis(), treated(noisy)), haptid.WLS())
    note, bound = with_bounds(poor, 11.0).notes[len(poor.notes) :]
    assert "At best, by any method" in bound
    low, high = poor["DE1"].conf_int()
    known = 50 * (high - low) / abs(poor["DE1"].value)
    assert (known > 100) == (noise > 1)
    assert f"DE1 within {per_cent(known)}" in note
    assert "e+" not in note
    assert ("KE1" in note) == (noise > 1)


def test_stiffness_that_noise_hides_is_refused_with_the_motion_that_shows_it():
    settings = haptid.Treatment(cutoff_hz=40.0, decimation=10, parallel_cutoff_hz=12.0)
    found = haptid.estimate(haptid.observe(axis(), haptid.treat(quasi_static(2e-4), settings)), haptid.WLS())
    assert found["KE1"].value < 3000.0  # and its standard error says nothing of it
    assert found["KE1"].relative_se < 25.0
    with pytest.raises(IdentifiabilityError, match="is noise of the encoders") as caught:
        expect_elasticity(found, 3.7)
    assert "Excite motor 1 up to" in caught.value.advice
    fine = haptid.estimate(haptid.observe(axis(), haptid.treat(quasi_static(1e-6), settings)), haptid.WLS())
    expect_elasticity(fine, 3.7)


def test_a_torque_of_the_wrong_sign_of_damping_is_refused():
    log = quasi_static(1e-6)
    late = replace(log, torque=np.roll(log.torque, -30, axis=0))
    settings = haptid.Treatment(cutoff_hz=40.0, decimation=10, parallel_cutoff_hz=12.0)
    found = haptid.estimate(haptid.observe(axis(), haptid.treat(late, settings)), haptid.WLS())
    with pytest.raises(IdentifiabilityError, match=r"no stable spring|does not show the stiffness"):
        expect_elasticity(found, 3.7)


def test_sampling_too_slow_for_a_spring_is_refused():
    fast = recorded()
    every = (np.ascontiguousarray(x[::20]) for x in (fast.t, fast.position, fast.torque))
    slow = haptid.Log(Path("made"), "", *every, fast.channels)
    with pytest.raises(LogTimeError, match="too few to see a spring"):
        expect_fast_sampling(axis(), [slow])
    expect_fast_sampling(axis(), [fast])


def test_structural_stiffness_that_no_encoder_sees_is_refused_with_what_shows_it():
    """A mount that gives under a motor: one motor, two joints, and the motor's position alone."""
    terms = [{"kind": "spring", "joints": ["mount"]}, {"kind": "viscous", "joints": "all"}]
    motors = [{"name": "a", "drives": {"1": 1.0}}]
    model = axis(joints=[{"name": "mount"}, {"name": "1", "d": 0.3}], motors=motors, terms=terms)
    both = recorded(seconds=3.0)
    signals = haptid.Signal(("theta",), "rad"), haptid.Signal(("u",), "N m", side="motor")
    log = haptid.Log(Path("made"), "", both.t, both.position[:, 1:], both.torque, haptid.Channels(*signals, "t"))
    with pytest.raises(LogMismatchError, match="position of mount, which a spring holds") as caught:
        haptid.propose(model, log)
    assert "elastic term" in caught.value.advice
    assert "gyroscope" in caught.value.advice
    assert "remove the spring term" in caught.value.advice  # else the log with its position is refused as well
    without = axis(joints=[{"name": "mount"}, {"name": "1", "d": 0.3}], motors=motors, terms=terms[1:])
    with pytest.raises(LogMismatchError, match="1 position channels"):
        haptid.propose(without, log)


def test_a_spring_on_a_measured_joint_without_a_motor_is_refused():
    """No torque that is measured has the spring's: its stiffness was left out without a word."""
    terms = [{"kind": "spring", "joints": ["mount"]}, {"kind": "viscous", "joints": "all"}]
    motors = [{"name": "a", "drives": {"1": 1.0}}]
    joints = [{"name": "mount"}, {"name": "1", "d": 0.3}]
    both = recorded(seconds=3.0)
    signals = haptid.Signal(("mount", "theta"), "rad"), haptid.Signal(("u",), "N m", side="motor")
    log = haptid.Log(Path("made"), "", both.t, both.position, both.torque, haptid.Channels(*signals, "t"))
    with pytest.raises(LogMismatchError, match="a spring holds mount, which no motor moves") as caught:
        haptid.propose(axis(joints=joints, motors=motors, terms=terms), log)
    assert "elastic term" in caught.value.advice
    haptid.propose(axis(joints=joints, motors=motors, terms=terms[1:]), log)


@pytest.mark.parametrize(
    ("sources", "said", "advice"),
    [
        (("a", "shaft b"), "no channel has the position of mount, which a spring holds", "Record its position"),
        (
            ("q_mount", "a"),
            r"the device requires 3: .*a, b[^.]*\. Map one",
            "in this order",
        ),
        (
            ("x", "y"),
            r"requires 3: .* If none of them is the position",
            "If another one is missing",
        ),
    ],
)
def test_what_is_said_to_be_missing_is_what_the_channels_names_show(sources, said, advice):
    """Two motors and a mount that gives; by their count alone, any missing channel was the mount's."""
    terms = [{"kind": "spring", "joints": ["mount"]}, {"kind": "viscous", "joints": "all"}]
    joints = [{"name": "mount"}, {"name": "1", "d": 0.3}, {"name": "2", "d": 0.3}]
    motors = [{"name": "a", "drives": {"1": 1.0}}, {"name": "b", "drives": {"2": 1.0}}]
    model = axis(joints=joints, motors=motors, terms=terms)
    both = recorded(seconds=3.0)
    position = haptid.Signal(sources, "rad", side="motor")
    channels = haptid.Channels(position, haptid.Signal(("u", "v"), "N m", side="motor"), "t")
    log = haptid.Log(Path("made"), "", both.t, both.position, np.repeat(both.torque, 2, axis=1), channels)
    with pytest.raises(LogMismatchError, match=said) as caught:
        haptid.propose(model, log)
    assert advice in caught.value.advice
