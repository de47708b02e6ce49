"""Joints at rest: their friction is anything up to dry friction, and nothing is learnt of their parameters."""

from pathlib import Path

import numpy as np
import pytest
from test_model_for_use import BODIES, DEVICE, model_of, torque_error, truth

import haptid
from haptid.estimation import WLS
from haptid.estimation.methods.anchored import Anchored, AnchoredConsistent, open_parameters, reference_torque
from haptid.log.spectrum import Spectrum, widest
from haptid.observation.plan import Plan
from haptid.validation.model_for_use import model_for_use

DT, STEP, STICTION = 4e-3, 2e-4, 0.15


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return model_of(tmp_path_factory.mktemp("bodies"), DEVICE + BODIES)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    return model_of(tmp_path_factory.mktemp("bare"), DEVICE)


def recorded(model, *, seed=1, moving=((0.0, 1.0), (0.0, 1.0)), seconds=24.0, noise=0.01):
    """A log whose joints move only in a share of it; friction at rest is half of dry friction, with either sign.

    Args:
        moving: for each joint the shares of the log between which it moves.
    """
    rng, t = np.random.default_rng(seed), np.arange(0, seconds, DT)
    q = np.zeros((3, 2, t.size))
    for joint, (begin, end) in enumerate(moving):
        x = np.clip((t - begin * seconds) / max((end - begin) * seconds, DT), 0, 1)
        for f, size in ((0.31, 0.5), (0.53, 0.4), (0.87, 0.2)):
            q[0, joint] += size * (np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) - np.sin(rng.uniform(0, 6)))
        q[0, joint] *= (16 * (x * (1 - x)) ** 2) ** 0.25
    q[0] += np.array([0.2, 0.5])[:, None]
    q[1] = np.gradient(q[0], DT, axis=1)
    q[2] = np.gradient(q[1], DT, axis=1)
    tau = haptid.inverse_dynamics(model, truth(model), *q)
    still = np.abs(q[1]) < 1e-9
    tau += np.where(still, STICTION * rng.choice([-1, 1]), 0.0) + noise * rng.standard_normal(tau.shape)
    position = STEP * np.round((q[0] + 0.5 * STEP * rng.standard_normal(q[0].shape)) / STEP)
    channels = haptid.Channels(haptid.Signal(("a", "b"), "rad"), haptid.Signal(("u", "v"), "N m"), time="t")
    return haptid.Log(Path("made"), f"{seed}{moving}", t, position.T, tau.T, channels)


def fitted(model, *logs):
    """The proposal, the free estimate and the model for use."""
    proposal = haptid.propose(model, *logs)
    made = haptid.estimate(haptid.observe(model, *(haptid.treat(log, proposal.treatment) for log in logs)), WLS())
    return proposal, made, model_for_use(made)


def test_rest_before_and_after_the_motion_is_no_error_of_the_model(model):
    """A third of the log is rest; all other rows, reversals too, are predicted to their noise."""
    proposal, _, use = fitted(model, recorded(model))
    unseen = recorded(model, seed=5, moving=((0.2, 0.85), (0.2, 0.85)))
    rows = haptid.observe(model, haptid.treat(unseen, proposal.treatment))
    with_rest = haptid.Treatment(**{**vars(proposal.reference), "rest_speed": 0.0})
    errors = [
        haptid.validate(use.estimate, rows, haptid.treat(unseen, reference)).comparable.relative
        for reference in (proposal.reference, with_rest)
    ]
    assert errors[0] < 0.25 * errors[1]
    plan = Plan.of(model, haptid.treat(unseen, proposal.reference))
    kept = plan.weights(0, plan.rows) > 0
    share = (unseen.t[0] + 24.0 * 0.2, unseen.t[0] + 24.0 * 0.85)
    t = plan.t(0, plan.rows)
    assert not kept[:, (t < share[0] - 0.5) | (t > share[1] + 0.5)].any()
    assert kept[:, (t > share[0] + 1.0) & (t < share[1] - 1.0)].all()


def test_rest_is_reported_and_continuous_motion_is_not(model):
    resting, _, _ = fitted(model, recorded(model, moving=((0.2, 0.85), (0.2, 0.85))))
    assert any("at rest" in reason for reason in resting.reasons)
    steady, _, _ = fitted(model, recorded(model, moving=((-1.0, 2.0), (-1.0, 2.0))))
    assert not any("at rest" in reason for reason in steady.reasons)


def test_one_joint_after_the_other_identifies_both(model):
    """Each log moves one joint, and the other gives no rows; together they predict motion of both."""
    first = recorded(model, moving=((0.0, 1.0), (0.0, 0.0)))
    second = recorded(model, seed=2, moving=((0.0, 0.0), (0.0, 1.0)))
    _, _, use = fitted(model, first, second)
    assert torque_error(model, use.beta, truth(model)) < 0.05


def test_a_resting_joint_is_left_open_and_stays_near_the_prior(model):
    """Least squares alone magnifies noise; the prior bodies are the true ones, only friction of joint 2 is missing."""
    _, made, use = fitted(model, recorded(model, moving=((0.0, 1.0), (0.0, 0.0))))
    assert {"FV2"} <= set(use.open)
    assert not {"FV1", "FC1", "ZZ1R"} & set(use.open)
    assert use.open[0] in use.reason
    assert isinstance(use.method, Anchored)
    beta = truth(model)
    assert torque_error(model, use.beta, beta) < 0.4
    assert torque_error(model, use.beta, beta) < 0.2 * torque_error(model, made.beta, beta)


def test_without_prior_bodies_it_stays_near_zero(bare):
    _, made, use = fitted(bare, recorded(bare, moving=((0.0, 1.0), (0.0, 0.0))))
    assert "near that of zero" in use.reason
    assert torque_error(bare, use.beta, truth(bare)) < min(1.0, 0.5 * torque_error(bare, made.beta, truth(bare)))


def test_a_log_that_tells_everything_is_left_alone(model):
    _, made, use = fitted(model, recorded(model))
    assert use.open == ()
    assert not isinstance(use.method, Anchored)
    A = reference_torque(made.observation)
    assert open_parameters(made.observation, A, made.covariance) == ()
    pulled = haptid.estimate(made.observation, AnchoredConsistent())
    assert np.linalg.norm(A @ (pulled.beta - made.beta)) < 0.02 * np.linalg.norm(A @ made.beta)


def test_the_reference_torque_depends_on_no_unit_of_the_parameters(model):
    """The prior is on torque: one in proportion to the measured torque, and its mean square at the reference states."""
    made = fitted(model, recorded(model))[1]
    A, beta = reference_torque(made.observation), truth(model)
    share = np.linalg.norm(A @ beta)
    assert 0.3 < share < 3.0


def test_a_channel_that_only_trembles_does_not_set_its_filter():
    f = np.arange(1, 200) * 0.05
    slow = Spectrum(f, 1e-2 / (1 + (f / 0.5) ** 8), np.full(f.size, 1e-9), 0.0, 0.6)
    tremble = Spectrum(f, 1e-9 / (1 + (f / 5) ** 8), np.full(f.size, 1e-9), 0.0, 5.0)
    quick = Spectrum(f, 2e-3 / (1 + (f / 2) ** 8), np.full(f.size, 1e-9), 0.0, 2.2)
    assert widest([(slow,), (tremble,)]) == (slow,)
    assert widest([(tremble,), (quick,), (slow,)]) == (quick,)
