"""Slopes of a search on trees, parallelograms and loops whose rates vary: against central differences."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid.experiment.excitation import Coupling, Gradients, Limits, MotionBounds, RawCondition, ScaledCondition

# A tree, parallelograms, coupled motors, and loops that are not linear.
DEVICES = ("arm7", "phantom_premium_15", "cea_medical_branch", "four_bar", "slider_crank", "five_bar", "delta")


def limited(name: str) -> MotionBounds:
    """A device whose passive joints have narrow limits too, and so have torques."""
    model = haptid.DynamicModel(haptid.read_device(name))
    joints = tuple(
        joint if j in model.device.active else replace(joint, position_limits=(-0.1, 0.2), velocity_limit=0.5)
        for j, joint in enumerate(model.device.joints)
    )
    model = haptid.DynamicModel(replace(model.device, joints=joints))
    weights = tuple(np.linspace(1.0, 2.0, len(model.device.active)))
    limits = Limits(
        ((-0.1, 0.1),) * len(model.device.active),
        (0.5,),
        torque=(0.1,),
        acceleration=(2.0,),
        couplings=(Coupling(weights, -0.1, 0.1),),
    )
    beta = np.random.default_rng(3).normal(size=len(model.base))
    return MotionBounds.of(model, limits, beta)


def states_of(model: haptid.Device, count: int = 60) -> np.ndarray:
    """Near the start pose, no coordinate at rest: friction jumps there."""
    rng = np.random.default_rng(1)
    q = getattr(model.device.closure, "at", np.zeros(len(model.device.active)))[:, None]
    states = rng.uniform(-1, 1, (3, len(model.device.active), count)) * np.array([0.2, 2.0, 8.0])[:, None, None]
    states[0] += q
    states[1] += 0.1 * np.sign(states[1])
    return states


@pytest.mark.parametrize("name", DEVICES)
def test_gradients_of_limits_are_differences_of_the_excesses(name):
    bounds = limited(name)
    states = states_of(bounds.model)
    excesses = lambda x: np.array([excess for excess, _ in bounds.by_sample(x)])  # noqa: E731
    rng, step = np.random.default_rng(2), 1e-6
    weights, way = rng.normal(size=excesses(states).shape), rng.normal(size=states.shape)
    wanted = (weights * (excesses(states + step * way) - excesses(states - step * way))).sum(axis=0) / (2 * step)
    found = (bounds.gradients(states, weights) * way).sum(axis=(0, 1))
    # A sample at a corner of a limit is no sample to compare.
    assert np.quantile(np.abs(found - wanted) / np.abs(wanted).max(), 0.95) < 1e-5


def test_an_infinite_end_of_a_range_is_never_violated_and_the_other_end_is():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta, infinite = np.ones(len(model.base)), np.inf
    position = ((0.0, infinite), (-infinite, 0.05), (-infinite, infinite))
    bounds = MotionBounds.of(model, Limits(position, (0.5,)), beta)
    states = states_of(model)
    states[0] -= states[0].mean(axis=1, keepdims=True)
    excesses = np.array([excess for excess, _ in bounds.by_sample(states)])
    low, high = bounds.position.T[:, :, None]
    np.testing.assert_array_equal(excesses[:3] > 0, (states[0] < low) | (states[0] > high))
    assert (excesses[:2] > 0).any(axis=1).all()
    rng, step = np.random.default_rng(2), 1e-6
    weights, way = np.zeros_like(excesses), rng.normal(size=states.shape)
    weights[:3] = rng.normal(size=(3, states.shape[2]))
    ahead, behind = (np.array([e for e, _ in bounds.by_sample(states + s * way)])[:3] for s in (step, -step))
    wanted = (weights[:3] * (ahead - behind)).sum(axis=0) / (2 * step)
    np.testing.assert_allclose((bounds.gradients(states, weights) * way).sum(axis=(0, 1)), wanted, atol=1e-8)


@pytest.mark.parametrize("criterion", [ScaledCondition(), RawCondition()], ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("name", DEVICES)
def test_gradients_of_the_criterion_are_differences_of_the_cost(name, criterion):
    bounds = limited(name)
    states, model = states_of(bounds.model), bounds.model
    some = tuple(range(0, len(model.base), 2))
    gradients = Gradients.of(bounds, criterion, some, np.ones(sum(model.device.measured)))
    way, step = np.random.default_rng(2).normal(size=states.shape), 1e-6
    wanted = (gradients.at(states + step * way).cost(2.0) - gradients.at(states - step * way).cost(2.0)) / (2 * step)
    found = np.sum(gradients(states, 2.0, 0.0)[1] * way)
    assert found == pytest.approx(wanted, rel=1e-5, abs=1e-7)
