"""The largest neglected force over directions, against hundreds of directions."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import haptid
from haptid.demos import read_demo
from haptid.end_effector.characterisation import GivenParameters, characterise
from haptid.end_effector.characterisation.velocity_forces import unit_directions
from mechanisms import draw
from random_devices import as_device, parameters
from true_parameters import true_parameters

# Signs do not matter, so that these cover half a sphere. Fewer directions make the comparison weaker, never wrong: the
# largest of them is below the largest of all.
MANY, CLOSE = 300, 1e-3


def largest(found, speed):
    """Largest |F_d| over many directions, (poses,), N."""
    every = unit_directions(len(found.handle.rows), MANY)
    return np.max([np.linalg.norm(found.neglected_force_of(speed * d).values, axis=1) for d in every], axis=0)


def shipped(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    if name == "phantom_premium_15":
        return GivenParameters(model, model.base.of(true_parameters(model)))
    table = read_demo("medical").tables["upper"]
    return GivenParameters.of(model, dict(zip(table.rows, table.column("identified"), strict=True)))


CENTRES = {"phantom_premium_15": (0.0, 0.3, 0.1), "cea_medical_branch": (0.0, -0.9, np.pi + 0.9)}


@pytest.mark.parametrize("name", CENTRES)
@pytest.mark.parametrize("speed", [0.25, 1.0, 3.0])
def test_no_direction_of_hundreds_has_more(name, speed):
    qa = np.array(CENTRES[name])[:, None] + np.random.default_rng(0).uniform(-0.5, 0.5, (3, 30))
    found = characterise(shipped(name), qa, worst_condition=20.0)
    usable = found.handle.usable
    assert usable.sum() > 10
    best = found.neglected_force(speed).values
    assert (best[usable] >= (1 - CLOSE) * largest(found, speed)[usable]).all()
    assert np.isnan(best[~usable]).all()


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 30), st.floats(0.1, 3.0))
def test_nor_of_random_arms(seed, speed):
    mechanism = draw(seed, joints=3, closed=False, chain=True)
    model = as_device(mechanism)
    identified = GivenParameters(model, model.base.of(parameters(mechanism, model)))
    found = characterise(identified, np.random.default_rng(seed).normal(size=(3, 9)), worst_condition=100.0)
    usable = found.handle.usable
    assume(usable.any())
    assert (found.neglected_force(speed).values >= (1 - CLOSE) * largest(found, speed))[usable].all()
