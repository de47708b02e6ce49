"""The hand's force on the bench: encoders with steps, noisy torque, a push that goes on while joints turn back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import haptid
from haptid.device.toml.reader import device_of
from haptid.device.toml.terms import ElasticTerm
from haptid.dynamics.inverse import core_torque, raw_parameters
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.force import estimate_force
from haptid.end_effector.momentum_observer import MomentumObserver, observe_force
from haptid.experiment import bench
from haptid.observation.reversals import smoothed_friction
from motions import motion
from true_parameters import true_parameters

# A command is held for a period of 1 ms: it acts half of that late.
TREATMENT = haptid.Treatment(cutoff_hz=40.0, decimation=10, torque_delay_s=5e-4)
PUSHES_FROM, SECONDS = 3.0, 8.0


def rms(error):
    """Of a vector's length, error (samples, 3)."""
    return float(np.sqrt((error**2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def bench_run():
    """The device under control; the hand pushes with a sine from 3 s on."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    kind = bench.Multisine(SECONDS, (0.0, 0.2, 0.3), (0.6, 0.35, 0.4), speed=(2.4,))
    setup = bench.Setup(
        model,
        true_parameters(model),
        bench.Controller((40.0, 35.0, 14.0), (0.5, 0.4, 0.16)),
        bench.Encoders((4000.0,), gear=(13.3, 11.2, 11.2)),
        bench.Amplifiers(noise=(2e-3,)),
        hand=(bench.Push((0.6, 0.4, -0.5), frequency_hz=1.3, start=PUSHES_FROM, stop=7.0),),
    )
    trajectory = bench.plan(kind, model, setup.dt, np.random.default_rng(1))
    return setup, bench.simulate(setup, trajectory, np.random.default_rng(2))


@pytest.fixture(scope="module")
def log(bench_run):
    """What an instrument has of it."""
    _, found = bench_run
    names = ("1", "2", "3")
    channels = haptid.Channels(
        haptid.Signal(tuple(f"q{k}" for k in names), "rad"),
        haptid.Signal(tuple(f"command{k}" for k in names), "N m", side="motor"),
        time="t",
    )
    return haptid.Log("bench.parquet", "", found.t, found.position, found.command, channels)


@pytest.fixture(scope="module")
def estimate(bench_run):
    """The true parameters, as an estimate with a covariance."""
    setup, _ = bench_run
    beta = setup.model.base.of(setup.chi)
    made = motion(setup.model, beta, seconds=20.0, noise=0.02)
    found = haptid.estimate(haptid.observe(setup.model, made), haptid.WLS())
    return replace(found, quantities=replace(found.quantities, values=beta))


@pytest.fixture(scope="module")
def validation(log, estimate):
    """On the stretch before the hand pushes."""
    alone = log.between(0, round((PUSHES_FROM - 0.2) * log.rate_hz))
    return haptid.validate(estimate, haptid.treat(alone, TREATMENT))


@pytest.fixture(scope="module")
def push(bench_run):
    """Stretch that is compared: the hand pushes, filters have settled, joints turn back several times."""
    _, found = bench_run
    turns = np.abs(np.diff(np.sign(found.qd[:, :3]), axis=0)) > 0
    during = (found.t[1:] > PUSHES_FROM) & (found.t[1:] < 7.0)
    assert (turns[during].sum(axis=0) >= 4).all()
    return lambda t: (t > PUSHES_FROM + 0.3) & (t < 6.7)


def test_the_model_leaves_a_fifth_of_the_error(bench_run, log, estimate, validation, push):
    _, found = bench_run
    force = estimate_force(estimate, haptid.treat(log, TREATMENT), validation=validation)
    hand = signal.convolve(found.hand, TREATMENT.taps(found.dt)[:, None], mode="same")
    hand, during = hand[np.rint(force.t / found.dt).astype(int)], push(force.t)
    error = rms((force.force - hand)[during])
    assert force.usable.all()
    assert error < 0.02 * rms(hand[during])
    assert error < rms((force.bare[:, :3] - hand)[during]) / 15  # 5 would do
    low, high = np.moveaxis(force.conf_int(), -1, 0)
    inside = (hand >= low) & (hand <= high)
    assert inside[during].mean() > 0.9


def test_the_observer_is_as_good(bench_run, log, estimate, validation, push):
    """On the same treated motion, against the force estimate through the observer's own low-pass."""
    _, found = bench_run
    observer, dt = MomentumObserver(), found.dt
    seen = observe_force(estimate, haptid.treat(log, TREATMENT), observer, validation=validation)
    plain = replace(TREATMENT, decimation=1)
    force = estimate_force(estimate, haptid.treat(log, plain), validation=validation)

    def smoothed(signals, t):
        return observer.smooth(signals.T, dt).T[np.rint(t / dt).astype(int)]

    means = 0.5 * (found.hand + np.roll(found.hand, 1, axis=0))  # over each step, as the observer has them
    hand, during = smoothed(means, seen.t), push(seen.t)
    error = rms((seen.force - hand)[during])
    other = observer.smooth(force.force.T, dt).T - smoothed(found.hand, force.t)
    assert error <= rms(other[push(force.t)])
    assert error < rms((seen.bare[:, :3] - hand)[during]) / 30


def test_in_real_time_the_observer_beats_differentiated_velocities(bench_run, estimate, push):
    """From the controller's own velocity: no acceleration, and no more noise than with one."""
    setup, found = bench_run
    model, observer, dt = setup.model, MomentumObserver(), found.dt
    qa, qda, tau = found.position.T, found.velocity.T, found.command.T / 2.73
    seen = observer.follow(model, estimate.beta, dt, qa, qda, tau).torque
    qdda = np.diff(qda, axis=1, prepend=qda[:, :1]) / dt
    soft = smoothed_friction(model, observer.reversal_speed)
    differentiated = core_torque(soft, raw_parameters(model, estimate.beta), qa, qda, qdda) - tau
    exact = handle_motion(model, found.q[:, list(model.device.active)].T)
    hand = observer.smooth(np.einsum("nij,ni->jn", exact.jacobian[:, :3], found.hand), dt)
    during = push(found.t)
    error = rms((seen - hand).T[during])
    assert error < rms((observer.smooth(differentiated, dt) - hand).T[during])
    assert error < 0.1 * rms(hand.T[during])


def test_springs_behind_motors_do_not_hide_the_hand():
    """Both sides of an elastic arm are measured: six rows, and the hand acts on three; no moment is made up."""
    arm, rng = haptid.read_device("arm3"), np.random.default_rng(0)
    terms = [ElasticTerm(kind="elastic", motors="all"), *(term for term in arm.tables.terms if term.kind != "coulomb")]
    model = haptid.DynamicModel(device_of(arm.tables.model_copy(update={"terms": terms}), "arm3"))
    chi = true_parameters(model, KE=400.0, DE=0.8, IA=0.02, FV=0.05)
    kind = bench.Multisine(3.0, (0.0, 0.7, -1.0), (0.5, 0.3, 0.4), frequencies_hz=(0.4, 2.0), ramp=1.0)
    push = bench.Push((5.0, -4.0, 6.0), frequency_hz=1.3, start=1.0)
    setup = bench.Setup(model, chi, bench.Controller((80.0, 80.0, 40.0), (2.0, 2.0, 1.0), gravity=True), hand=(push,))
    found = bench.simulate(setup, bench.plan(kind, model, setup.dt, rng), rng)
    sides = haptid.Signal(tuple(f"q{k}" for k in range(6)), "rad")
    channels = haptid.Channels(sides, haptid.Signal(("u1", "u2", "u3"), "N m", side="motor"), time="t")
    log = haptid.Log("bench", "", found.t, found.position, found.command, channels)
    estimate = haptid.estimate(
        haptid.observe(model, motion(model, model.base.of(chi), seconds=5.0, noise=0.02)), haptid.WLS()
    )
    treated = haptid.treat(log, replace(TREATMENT, torque_delay_s=5e-4))
    force, watched = estimate_force(estimate, treated), observe_force(estimate, treated)
    assert force.moment == watched.moment == "taken as zero"
    assert not force.lever.inverse[:, :, model.device.row_map[:, 3:].any(axis=1)].any()
    hand = signal.convolve(found.hand, TREATMENT.taps(found.dt)[:, None], mode="same")
    hand, during = hand[np.rint(force.t / found.dt).astype(int)], (force.t > 1.3) & (force.t < 2.7)
    assert rms((force.force - hand)[during]) < 0.02 * rms(hand[during])
    means = 0.5 * (found.hand + np.roll(found.hand, 1, axis=0))
    seen = MomentumObserver().smooth(means.T, found.dt).T[np.rint(watched.t / found.dt).astype(int)]
    during = (watched.t > 1.3) & (watched.t < 2.7)
    assert rms((watched.force - seen)[during]) < 0.02 * rms(seen[during])
