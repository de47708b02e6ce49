"""Slopes of criteria and limits against differences, stand-ins against the criteria, and one search of few tries."""

import numpy as np
import pytest

import haptid
from haptid import _core
from haptid.experiment import bench
from haptid.experiment.excitation import (
    AverageVariance,
    Coupling,
    FourierSeries,
    Gradients,
    Information,
    LargestDeviation,
    Limits,
    MotionBounds,
    RawCondition,
    ScaledCondition,
    Search,
    TrianglesWithSines,
    design_excitation,
    motion_condition,
    observed_motion,
    quality,
)
from motions import truth

PHANTOM = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
BETA = truth(PHANTOM)
# All kinds of limits, narrow enough that a random motion exceeds each of them somewhere.
NARROW = Limits(
    ((-0.5, 0.5), (-0.3, 0.6), (-0.2, 0.7)),
    speed=(1.0,),
    acceleration=(3.0,),
    torque=(0.05,),
    couplings=(Coupling((0.0, 1.0, -1.0), -0.2, 0.2),),
    conditioning=0.9,
)
CRITERIA = [ScaledCondition(), RawCondition(), Information(), AverageVariance(), LargestDeviation()]
NOISE = np.array([0.001, 0.002, 0.004])


def random_states(seed: int, count: int = 80) -> np.ndarray:
    """No coordinate at rest: friction jumps there."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(-1, 1, (3, 3, count)) * np.array([0.8, 2.0, 8.0])[:, None, None]
    states[1] += 0.05 * np.sign(states[1])
    return states


@pytest.mark.parametrize("zero", [(), (2, 5)], ids=["all known", "two of value zero"])
@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda one: type(one).__name__)
def test_slopes_are_those_of_the_cost(criterion, zero):
    beta = BETA.copy()
    beta[list(zero)] = 0.0
    gradients = Gradients.of(MotionBounds.of(PHANTOM, NARROW, beta), criterion, tuple(range(len(beta))), NOISE)
    states, way = random_states(1), random_states(2)
    cost = lambda t: gradients(states + t * way, 3.0, 10.0)[0]  # noqa: E731
    step = 1e-6
    slope = (cost(step) - cost(-step)) / (2 * step)
    assert np.sum(gradients(states, 3.0, 10.0)[1] * way) == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda one: type(one).__name__)
def test_a_sharp_stand_in_differs_from_the_criterion_by_a_constant(criterion):
    """By none but for Information, whose stand-in leaves out the number of rows."""
    columns = tuple(range(len(BETA)))
    gradients = Gradients.of(MotionBounds.of(PHANTOM, NARROW, BETA), criterion, columns, NOISE)
    apart = []
    for seed in (3, 4):
        states = random_states(seed)
        made = bench.Trajectory(0.04, *(np.ascontiguousarray(x.T) for x in states))
        found = quality(observed_motion(PHANTOM, made), columns, BETA, NOISE)
        apart.append(gradients.at(states).cost(200.0) - criterion.cost(found) - _left_out(criterion, found))
    np.testing.assert_allclose(apart, 0.0, atol=0.02)


def _left_out(criterion, found):
    if isinstance(criterion, LargestDeviation | AverageVariance):
        return -np.log(100)  # per cent
    return -0.5 * np.log(found.rows) if isinstance(criterion, Information) else 0.0


@pytest.mark.parametrize("rest", [None, (0.1, 0.2, 0.3)], ids=["from the centre", "from a pose"])
def test_the_basis_of_a_series_is_its_plan(rest):
    """States and gradients by the basis against plans of the bench, and their differences."""
    bounds, rng = MotionBounds.of(PHANTOM, NARROW, BETA), np.random.default_rng(0)
    family = FourierSeries(8.0, 0.2, 3, start_pose=rest)
    basis, x = family.basis(bounds, 0.04), rng.random(family.size(3))
    made = bench.plan(family.kind(x, bounds), PHANTOM, 0.04, rng)
    np.testing.assert_allclose(basis.states(x), [made.q.T, made.qd.T, made.qdd.T], atol=1e-11)
    if rest is not None:
        np.testing.assert_array_equal(made.q[[0, -1]], [rest, rest])
    way, weights = rng.normal(size=x.shape), rng.normal(size=basis.states(x).shape)
    slope = np.sum(weights * (basis.states(x + way) - basis.states(x)))
    assert basis.gradient(weights, len(x)) @ way == pytest.approx(slope, rel=1e-9)


def test_only_affine_families_have_a_basis():
    bounds = MotionBounds.of(PHANTOM, NARROW, BETA)
    assert TrianglesWithSines(8.0).basis(bounds, 0.04) is None


def test_a_drawn_series_fills_its_limits():
    bounds = MotionBounds.of(PHANTOM, NARROW, BETA)
    for seed in range(5):
        kind = FourierSeries().kind(FourierSeries().start(bounds, np.random.default_rng(seed)), bounds)
        made = bench.plan(kind, PHANTOM, 0.01, np.random.default_rng(1))
        low, high = bounds.position.T
        assert (made.q.min(axis=0) > low - 0.05).all()
        assert (made.q.max(axis=0) < high + 0.05).all()
        assert (np.abs(made.qd).max(axis=0) > 0.3).any()


def test_few_tries_come_near_the_optimum():
    """Descents along slopes reach in 120 tries what 150 tries at random miss by far."""
    wide = Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,), acceleration=(30.0,))
    family = FourierSeries(8.0, 0.2, 6)
    found = design_excitation(PHANTOM, family, wide, beta=BETA, search=Search(tries=120))
    assert found.after.scaled < 0.5 * found.before.scaled
    assert np.abs(found.trajectory(0.01).qdd).max() < 30.0 * 1.03


@pytest.mark.parametrize("power", [1, 2, 3, 4, 8])
def test_small_powers_have_the_cost_and_slope_of_the_eigenvalues(power):
    """Products of the Gram matrix and its inverse in place of its eigenvalues; singular ones have eigenvalues only."""
    V = np.random.default_rng(power).normal(size=(40, 7)) * 10.0 ** np.arange(-2, 5)
    for C in (V.T @ V, (V[:3]).T @ V[:3]):
        cost, B = RawCondition().smooth(C, power)
        near, near_B = RawCondition().smooth(C, power + 1e-9)  # no integer: by the eigenvalues
        assert cost == pytest.approx(near, rel=1e-6)
        np.testing.assert_allclose(B, near_B, atol=1e-6 * np.abs(near_B).max())
    condition = np.linalg.cond(V)  # that of V'V is its square
    assert RawCondition().value(V.T @ V) == pytest.approx(np.log(condition), abs=np.finfo(float).eps * condition**2)


@pytest.mark.parametrize("size", [1, 7, 48])
def test_condition_numbers_of_the_core_are_those_of_the_eigenvalues(size):
    V = np.random.default_rng(size).normal(size=(60, size)) * np.logspace(-3, 2, size)
    C = V.T @ V
    wanted = np.linalg.eigvalsh(C)
    np.testing.assert_allclose(_core.extreme_eigenvalues(C), wanted[[0, -1]], atol=1e-15 * size * wanted[-1])
    cost, slope = _core.smooth_condition(V.T @ V / np.outer(*[np.linalg.norm(V, axis=0)] * 2), 2)
    near = np.linalg.eigvalsh(C / np.outer(*[np.linalg.norm(V, axis=0)] * 2))
    assert cost == pytest.approx(np.log((near**2).sum() * (near**-2.0).sum()) / 4, rel=1e-9, abs=1e-14)
    np.testing.assert_allclose(slope, slope.T, atol=1e-9 * np.abs(slope).max())
    with pytest.raises(ValueError, match="it must be square"):
        _core.extreme_eigenvalues(np.ones((size, size + 1)))
    with pytest.raises(ValueError, match="power"):
        _core.smooth_condition(C, 0)


def test_a_motion_without_any_information_has_a_cost():
    """The least that is told apart, not a division by zero."""
    assert RawCondition().value(np.zeros((3, 3))) == pytest.approx(-np.log(1e-13) / 2)


@pytest.mark.parametrize("stroke", [1.0, 1e-3, 0.0], ids=["wide", "narrow", "still"])
def test_the_condition_of_a_motion_is_that_of_its_rows(stroke):
    """By the Gram matrix where that has the digits, by the R factor otherwise."""
    q, qd, qdd = stroke * random_states(7).transpose(0, 2, 1)
    made = bench.Trajectory(0.04, *map(np.ascontiguousarray, (q, qd, qdd)))
    wanted = quality(observed_motion(PHANTOM, made), tuple(range(len(BETA))), BETA, NOISE).raw
    assert motion_condition(PHANTOM, made) == pytest.approx(wanted, rel=1e-7)
