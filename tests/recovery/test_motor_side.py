"""Elastic motors from the motors alone: the simulation of the links against a closed form, recovery, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import haptid
from elastic_motors import DT, FVM, STEP, TERMS, TRUTH, K, arm, assert_within, axis, recorded, treated
from haptid.errors import IdentifiabilityError, SimulationError
from haptid.estimation import MotorSide
from haptid.estimation.methods.motor_noise import _rounded, with_noise_uncertainty
from haptid.estimation.methods.motor_side import noise_of_rows
from haptid.estimation.methods.simulation_based import base_columns
from haptid.estimation.torque_uncertainty import other_motion
from haptid.experiment import bench
from haptid.simulation import smooth
from haptid.simulation.driven import DrivenCourse, DrivenJoints
from haptid.simulation.driven_noise import MotionNoise
from haptid.treatment_choice.elasticity import noise_of_stiffness
from haptid.treatment_choice.hidden_joints import (
    _followed,
    _proposed,
    _shared,
    complete_logs,
    lacks_links,
)
from haptid.treatment_choice.motion_filters import MotionFilters
from haptid.treatment_choice.motor_delays import motor_delays, with_motor_delays
from motions import motion

# Two links in a vertical plane, each with a motor of its own.
GRAVITY, JOINTS = [0.0, -9.81, 0.0], [{"name": "1"}, {"name": "2", "d": 0.3}]
MOTORS = [{"name": "a", "drives": {"1": 1.0}}, {"name": "b", "drives": {"2": 1.0}}]
# Of a motion that begins at rest, Hz.
TONES = (0.9, 2.3, 4.1, 6.7)


def test_driven_joints_follow_the_closed_form_with_exact_slopes():
    model, log = axis(), recorded(seconds=1.4)
    motion = treated(log)
    smoothed, base = smooth(model, [motion], 1e-3), base_columns(model)
    beta = np.array([TRUTH[name] for name in model.base.names])
    inner = slice(1000, -200)  # the start's transient has decayed

    def course(at: np.ndarray) -> DrivenCourse:
        return DrivenJoints(smoothed, motion, len(motion), base).course(at)

    made = course(beta)
    assert np.abs(made.c[1, inner] - motion.q[inner, 0]).max() < 20 * STEP
    for name in ("ZZ1", "KE1", "DE1"):
        k = model.base.names.index(name)
        step = 1e-4 * beta * (np.arange(len(beta)) == k)
        numeric = (course(beta + step).torque - course(beta - step).torque)[0, inner] / (2 * step[k])
        trapezoidal = (2 * np.pi * 12.3 * DT) ** 2  # relative error near the resonance
        np.testing.assert_allclose(made.slope[0, k, inner], numeric, atol=trapezoidal * np.abs(numeric).max())


def test_segments_meet_as_one_with_its_slopes():
    """Two joints with gravity: a fifth of a second is shorter than the memory of a link on its spring."""
    model, rng = arm(), np.random.default_rng(4)
    values = dict.fromkeys(model.device.parameters.names, 0.02)
    values |= {"KEa": 400.0, "KEb": 300.0, "DEa": 0.4, "DEb": 0.4, "ZZ1": 0.3, "ZZ2": 0.2, "M2": 1.0, "MX2": 0.2}
    beta = model.base.of(np.array([values[name] for name in model.device.parameters.names]))
    t = DT * np.arange(1200)
    waves = [sum(a * np.sin(2 * np.pi * f * t) for a, f in zip(rng.normal(size=4), TONES, strict=True)) for _ in "ab"]
    theta = 0.2 * np.minimum(t / 0.3, 1.0) ** 3 * np.array(waves)
    log = haptid.Log(
        Path("made"),
        "",
        t,
        np.ascontiguousarray(np.concatenate([theta, theta]).T),
        np.zeros((len(t), 2)),
        haptid.Channels(
            haptid.Signal(("q1", "q2", "a", "b"), "rad"), haptid.Signal(("u", "w"), "N m", side="motor"), "t"
        ),
    )
    smoothed, base = smooth(model, [treated(log)], 1e-3), base_columns(model)
    torque = DrivenJoints(smoothed, treated(log), len(t), base).apart(beta).torque[:2]
    made = treated(replace(log, torque=np.ascontiguousarray(torque.T / [1.0, 20.0])))
    alone, many = (DrivenJoints(smoothed, made, length, base) for length in (len(t), 200))
    apart = [np.abs(many.course(beta).torque[:2] - torque).max() / np.abs(torque).max() for _ in range(4)]
    course, one = many.course(beta), alone.course(beta)
    assert apart[0] > 1e-4
    assert apart[-1] < 1e-7
    np.testing.assert_allclose(course.torque, one.torque, atol=1e-7 * np.abs(one.torque).max())
    size = np.abs(one.slope).max(axis=(0, 2), keepdims=True)
    np.testing.assert_allclose(course.slope / size, one.slope / size, atol=1e-6)
    # Another step of the parameters: states that segments begin at move with it.
    other = beta * (1 + 0.02 * rng.standard_normal(len(beta)))
    moved = alone.course(other).torque
    assert np.abs(many.course(other).torque - moved).max() < 0.2 * np.abs(one.torque - moved).max()


def test_positions_of_the_motors_alone_give_stiffness():
    """The log begins in the middle of a motion, whose state is found with the parameters."""
    model = axis()
    start = {name: 1.1 * value for name, value in TRUTH.items()}
    found = haptid.estimate(haptid.observe(model, treated(recorded())), MotorSide(initial=start))
    assert_within(found)
    assert abs(found["KE1"].value / K - 1) < 0.01
    assert found["KE1"].relative_se < 0.25  # 0.38 where the state is a guess
    delay = next(finding for finding in haptid.diagnose(found).findings if finding.name == "time delay")
    assert delay.status == "ok"
    assert "not tested" in delay.sentence


def test_segments_that_do_not_meet_are_no_convergence():
    """Parameters that hardly move while segments are apart, two standard errors or more from the least squares."""
    model, log = axis(), recorded(seconds=6.0)
    seen = np.ascontiguousarray(log.position[:, [1, 1]])  # links follow their motors
    observation = haptid.observe(model, treated(replace(log, position=seen)))
    smoothed = smooth(model, observation.motions, MotorSide().friction)
    beta = np.array([TRUTH[name] for name in model.base.names])
    for _ in range(6):  # of the first pass only
        first = haptid.estimate(MotorSide().linearised_rows(observation, smoothed, beta), haptid.WLS())
        moved, beta = np.abs(first.beta - beta) / first.se, first.beta
    assert moved.max() < 1
    best = haptid.estimate(observation, MotorSide(initial=TRUTH, tolerance=0.01))
    start = dict(zip(model.base.names, beta.tolist(), strict=True))
    found = haptid.estimate(observation, MotorSide(initial=start, tolerance=1.0))
    assert (np.abs(first.beta - best.beta) / first.se).max() > 2
    assert (np.abs(found.beta - best.beta) / best.se).max() < 1


def test_logs_without_links_are_told():
    model, log = axis(), recorded()
    assert not lacks_links(model, log)


def test_stiffness_is_found_from_motor_positions_without_initial_values():
    model, both = axis(), recorded(seconds=6.0)
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), both.channels.torque, "t")
    log = haptid.Log(Path("made"), "", both.t, both.position[:, 1:], both.torque, channels)
    assert lacks_links(model, log)
    (made,), found = complete_logs(model, [log], [True], torque_delay_s=0.0)
    assert_within(with_noise_uncertainty(found), times=4.5)  # converged to one standard error
    assert np.array_equal(made.position[:, 1], log.position[:, 0])


def behind_encoder(bits: int) -> haptid.Log:
    """The motor's side of the axis, 6 s."""
    both, coarse = recorded(seconds=6.0), 2 * np.pi / 2**bits
    seen = coarse * np.round(both.position[:, 1:] / coarse)
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), both.channels.torque, "t")
    return haptid.Log(Path("made"), "", both.t, seen, both.torque, channels)


def test_noise_above_the_motion_stays_out_of_the_rows():
    """Encoders of 10 bits: behind filters that pass three times the motion their noise hides the stiffness."""
    _, found = complete_logs(axis(), [behind_encoder(10)], [True], torque_delay_s=0.0)
    found = with_noise_uncertainty(found)
    assert_within(found)
    assert abs(found["KE1"].value / K - 1) < 0.1


@pytest.mark.parametrize("bits", [8, 9])
def test_filters_are_narrowed_until_noise_is_a_small_part_of_the_stiffness(bits):
    """Behind 1.5 times the motion's bandwidth half of what tells stiffness, or more, is noise."""
    _, found = complete_logs(axis(), [behind_encoder(bits)], [True], torque_delay_s=0.0)
    assert_within(with_noise_uncertainty(found))
    assert abs(found["KE1"].value / K - 1) < 0.1
    assert noise_of_stiffness(found) < 0.1


def test_stiffness_that_noise_of_the_motors_hides_is_refused():
    """Encoders of 8 bits, of which the largest torsion is two and a half steps, behind a filter that is given."""
    with pytest.raises(IdentifiabilityError) as caught:
        complete_logs(axis(), [behind_encoder(8)], [True], torque_delay_s=0.0, parallel_cutoff_hz=12.0)
    assert "noise of the encoders" in str(caught.value)
    assert "times as fine" in caught.value.advice


def test_noise_of_the_encoders_does_not_soften_the_spring():
    """Least squares chooses a model that amplifies less of the noise: one motion on lattices that lie elsewhere."""
    model, log, step = axis(), recorded(seconds=6.0), 2 * np.pi / 2**10
    plain, corrected = [], []
    for place in np.arange(6) / 6:
        seen = np.ascontiguousarray(step * (np.round(log.position[:, [1, 1]] / step - place) + place))
        observation = haptid.observe(model, treated(replace(log, position=seen), parallel_cutoff_hz=14.0))
        method = MotorSide(initial=TRUTH)
        corrected.append(haptid.estimate(observation, method)["KE1"].value)
        plain.append(haptid.estimate(method.rows(observation), haptid.WLS())["KE1"].value)
    scatter = np.std(corrected, ddof=1) / np.sqrt(len(corrected))
    assert abs(np.mean(corrected) - K) < 4 * scatter
    assert K - np.mean(plain) > 4 * scatter


def test_a_position_filter_near_the_motion_leaves_no_bias():
    """Cut-off at 1.2 times the highest frequency: the torque passes the same filter."""
    model, log = axis(), recorded()
    motion = treated(log, cutoff_hz=13.0, parallel_cutoff_hz=5.0)
    found = haptid.estimate(haptid.observe(model, motion), MotorSide(initial=TRUTH))
    assert_within(found)
    assert abs(found["KE1"].value / K - 1) < 0.02


def two_joints(
    terms: list[dict[str, str]] = TERMS, friction: float = 0.0, noise: float = 0.02, seed: int = 0, highest: float = 7.0
) -> tuple[haptid.DynamicModel, haptid.Log, dict[str, float]]:
    """Two coupled links on the bench, 8 s: the model, motors' positions and commands, and the true parameters."""
    model = axis(gravity=GRAVITY, joints=JOINTS, motors=MOTORS, terms=terms)
    values = dict.fromkeys(("XX1", "XX2"), 0.03) | dict.fromkeys(("YY1", "YY2", "ZZ1", "ZZ2"), 0.06)
    values |= {"MX1": 0.15, "MX2": 0.15, "M1": 1.0, "M2": 1.0}
    for motor, stiffness in (("a", 400.0), ("b", 150.0)):
        values |= {f"KE{motor}": stiffness, f"DE{motor}": 0.3, f"IAM{motor}": 0.02, f"FVM{motor}": 0.05}
        values |= {f"FCM{motor}": friction}
    chi = np.array([values.get(name, 0.0) for name in model.device.parameters.names])
    setup = bench.Setup(
        model,
        chi,
        bench.Controller((40.0,), (1.5,), gravity=True),
        bench.Encoders((80_000.0,)),
        bench.Amplifiers(noise=(noise,)),
    )
    kind, planned = bench.Multisine(8.0, (0.0,), (0.5,), frequencies_hz=(0.3, highest), count=8), bench.plan
    motion = planned(kind, model, setup.dt, np.random.default_rng(seed))
    made = bench.simulate(setup, motion, np.random.default_rng(1))
    signals = haptid.Signal(("a", "b"), "rad"), haptid.Signal(("u", "w"), "N m", side="motor")
    seen, command = np.ascontiguousarray(made.position[:, 2:]), np.ascontiguousarray(made.command)
    return model, haptid.Log(Path("made"), "", made.t, seen, command, haptid.Channels(*signals, "t")), values


def test_links_that_inertia_couples_are_found_from_their_motors_alone():
    """Two joints on the bench: nothing but the motors' positions and commands is given."""
    pytest.importorskip("mujoco")
    model, log, values = two_joints()
    assert lacks_links(model, log)
    _, found = complete_logs(model, [log], [True])
    found = with_noise_uncertainty(with_motor_delays(found))
    for name, value, se in zip(found.names, found.beta, found.se, strict=True):
        if name in values:  # the others have regroupings
            assert abs(value - values[name]) < 4.5 * se, (name, value, se)
    for motor, stiffness in (("a", 400.0), ("b", 150.0)):
        assert abs(found[f"KE{motor}"].value / stiffness - 1) < 0.02
        assert abs(found[f"DE{motor}"].value / 0.3 - 1) < 0.1


def test_the_delay_of_the_torque_is_found_beside_the_spring():
    """A torque that is read late, by samples and a part of one: nothing but motors' positions and commands is given."""
    both, late = recorded(seconds=6.0), 2.3 * DT
    torque = np.interp(both.t + late, both.t, both.torque[:, 0])[:-4, None]  # its noise is as white as between samples
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), both.channels.torque, "t")
    log = haptid.Log(Path("made"), "", both.t[:-4], both.position[:-4, 1:], np.ascontiguousarray(torque), channels)
    _, conditional = complete_logs(axis(), [log], [True])
    found = with_noise_uncertainty(with_motor_delays(conditional))
    delays = motor_delays(conditional)
    (se,) = np.sqrt(np.diag(delays.covariance))
    assert delays.still
    assert abs(delays.seconds[0] - late) < 3.5 * se
    assert se < 0.5 * DT  # less than what a hold leaves open
    assert_within(found)
    known = complete_logs(axis(), [log], [True], torque_delay_s=late)[1]
    assert found["FVM1"].se > 1.02 * known["FVM1"].se
    wrong = complete_logs(axis(), [log], [True], torque_delay_s=0.5 * DT)[1]
    assert abs(wrong["FVM1"].value - FVM) > 10 * wrong["FVM1"].se


def test_the_rounding_of_positions_is_not_that_of_a_later_motion():
    """Positions are evaluated later by the delay once: 3 ms of this motion are some hundred steps."""
    late = haptid.Treatment(cutoff_hz=80.0, decimation=10, parallel_cutoff_hz=25.0, torque_delay_s=3 * DT)
    made = haptid.treat(recorded(seconds=2.0), late)
    low, high = made.usable
    for moved in _rounded(made):
        assert np.abs(moved.q[low:high] - made.q[low:high]).max() < 2 * STEP


def test_noise_at_reversals_counts_as_elsewhere():
    """The motion rests at every pose that the noise is taken at; smoothed dry friction has a slope there."""
    terms = [*TERMS, {"kind": "coulomb", "motors": "all", "prefix": "FCM"}]
    model, log = axis(terms=terms), recorded(seconds=4.0)
    still = replace(log, position=np.ascontiguousarray(np.repeat(log.position[2000:2001], len(log.t), axis=0)))
    rows = haptid.observe(model, treated(still))
    beta = np.array([{**TRUTH, "FCM1": 0.3}[name] for name in model.base.names])
    source = MotionNoise(np.array([1.0, 400.0]), np.full((2, 2), STEP**2 * DT))
    (noise, _), _ = noise_of_rows(rows, beta, np.ones(2), [source])
    k, own = model.base.names.index("FCM1"), noise.sum(axis=0)
    assert own[model.base.names.index("FVM1"), model.base.names.index("FVM1")] > 0
    assert not own[k].any()


def test_windows_with_a_reversal_make_rotors_too_heavy():
    """Two joints on the bench, dry friction of the motors alone, no noise of the torque."""
    pytest.importorskip("mujoco")
    terms = [*TERMS[:2], TERMS[3], {"kind": "coulomb", "motors": "all", "prefix": "FCM"}]
    model, log, values = two_joints(terms=terms, friction=0.2, noise=0.0, seed=1, highest=8.0)
    rigid = axis(gravity=GRAVITY, joints=JOINTS, motors=MOTORS, terms=terms[1:])
    proposed = replace(_shared(_proposed(rigid, [log], {}).treatment), reversal_guard_s=0.0107)
    filters = MotionFilters.of(rigid, (log,), {})
    treatment = filters.clear(proposed)
    assert treatment.reversal_guard_s is None
    narrow = replace(proposed, parallel_cutoff_hz=2.0, reversal_guard_s=None)  # hardly a window is without a reversal
    assert filters.clear(narrow).reversal_guard_s == pytest.approx(0.3 * 0.4 / 2.0, rel=0.05)
    start = model.base.of(np.array([values.get(name, 0.0) for name in model.device.parameters.names]))
    method = MotorSide(initial=dict(zip(model.base.names, start.tolist(), strict=True)))
    off = []
    for guard in (None, 0.0107):
        motion = haptid.treat(_followed(model, log), replace(treatment, reversal_guard_s=guard))
        off.append(haptid.estimate(haptid.observe(model, motion), method)["IAMb"].value / values["IAMb"] - 1)
    assert abs(off[0]) < 0.5 * off[1]


def test_the_torque_of_other_motion_is_that_of_the_rows_of_the_fit():
    """Fits from the motor side have rows of motors alone, and not of joints that springs move."""
    model = arm()
    whole = haptid.observe(model, motion(model, np.ones(len(model.base)), seconds=3.0))
    motors = replace(whole, motors=tuple(m for m in whole.motors if not m.name.startswith("link_")))
    assert len(motors.motors) == len(model.device.motors) < len(whole.motors)
    kept = np.array([drive.motorised for drive in model.device.drives])
    every, some = other_motion(whole), other_motion(motors)
    states = len(every) // len(kept)
    np.testing.assert_array_equal(some, every.reshape(len(kept), states, -1)[kept].reshape(len(some), -1))


def test_segments_that_are_all_near_a_reversal_are_simulated_in_small_steps():
    model, log = axis(terms=[*TERMS, {"kind": "coulomb", "joints": "all"}]), recorded(seconds=1.4)
    motion = treated(log)
    truth = {**TRUTH, "FC1": 1.0}
    beta = np.array([truth[name] for name in model.base.names])
    smoothed, base = smooth(model, [motion], 1e-5), base_columns(model)
    alone = DrivenJoints(smoothed, motion, len(motion), base).course(beta)
    assert np.isfinite(alone.torque).all()
    with pytest.raises(SimulationError, match="dry friction"):
        DrivenJoints(smoothed, motion, len(motion), base, most_parts=3).course(beta)
    frictionless = DrivenJoints(smoothed, motion, len(motion), base).course(
        np.where(np.array(model.base.names) == "FC1", 0.0, beta)
    )
    assert np.abs(alone.torque - frictionless.torque).max() > 0.1


def of_the_motor(log: haptid.Log) -> haptid.Log:
    """The log without the link's position."""
    position = replace(log.channels.position, channels=("theta",), gain=(), offset=())
    return replace(
        log, position=np.ascontiguousarray(log.position[:, 1:]), channels=replace(log.channels, position=position)
    )


def test_a_begin_that_ran_away_is_an_error_of_the_simulation():
    model, log = axis(), recorded(seconds=1.4)
    motion = treated(log)
    joints = DrivenJoints(smooth(model, [motion], 1e-3), motion, 200, base_columns(model))
    beta = np.array([TRUTH[name] for name in model.base.names])
    begin = np.full((len(joints.begins), 2), np.nan)
    with pytest.raises(SimulationError, match="diverge"):
        joints.apart(beta, begin)


def test_terms_on_motorised_joints_are_on_rotors_and_initial_values_are_found():
    model = axis(terms=[*TERMS, {"kind": "offset", "joints": "motorised"}])
    alone = of_the_motor(recorded(3))
    _, found = complete_logs(model, [alone], [True])
    stiffness = dict(zip(found.names, found.beta, strict=True))["KE1"]
    assert stiffness == pytest.approx(K, rel=0.05)


def test_a_trial_of_springs_ends_where_they_leave_most_of_the_error(monkeypatch: pytest.MonkeyPatch):
    alone = of_the_motor(recorded(3))
    _, found = complete_logs(axis(), [alone], [True], trial=True)
    assert dict(zip(found.names, found.beta, strict=True))["KE1"] == pytest.approx(K, rel=0.05)
    monkeypatch.setattr("haptid.treatment_choice.hidden_joints._TRIED_LEFT", 1e-9)
    with pytest.raises(IdentifiabilityError, match="springs leave"):
        complete_logs(axis(), [alone], [True], trial=True)
