"""Profile likelihood within what bodies can have: a law, the border, coverage, and a large arm."""

from functools import cache

import numpy as np
import pytest

import haptid
from haptid.estimation import Profile, pseudo_inertia
from haptid.estimation.intervals import profile
from motions import motion
from sampling import of_mean, of_share
from small_study import two_links
from true_parameters import true_parameters

RUNS = 50


def truth(model, viscous=0.05):
    """Base parameters; the second joint's viscous friction is given."""
    chi = true_parameters(model, FV=0.05, FC=0.2)
    chi[model.device.parameters.index["FV2"]] = viscous
    return model.base.of(chi)


def observed(model, beta, seed=1, seconds=6.0):
    return haptid.observe(model, motion(model, beta, seconds=seconds, dt=4e-3, seed=seed, noise=0.05))


def test_with_room_all_around_it_is_the_ordinary_interval():
    model = two_links()
    rows = observed(model, truth(model))
    free = haptid.estimate(rows, haptid.WLS())
    found = haptid.estimate(rows, haptid.PhysicallyConsistent(), Profile())
    assert not found.constrained_fit.active
    np.testing.assert_allclose(found.conf_int(), free.conf_int(), rtol=1e-6, atol=1e-9)


@cache
def at_the_border():
    """An estimate whose viscous friction is held at zero."""
    model = two_links()
    for seed in range(1, 20):
        found = haptid.estimate(observed(model, truth(model, 0.0), seed), haptid.PhysicallyConsistent(), Profile())
        if "FV2" in str(found.constrained_fit.active) or "viscous friction of" in str(found.constrained_fit.active):
            return found
    raise AssertionError


def test_at_the_border_the_interval_has_one_side_and_stays_inside():
    found = at_the_border()
    k = found.base.names.index("FV2")
    low, high = found.conf_int().T
    assert low[k] == pytest.approx(0.0, abs=1e-9)
    assert high[k] > 0
    assert (low <= found.beta + 1e-9).all()
    assert (found.beta <= high + 1e-9).all()
    assert (
        high - low <= np.diff(haptid.estimate(found.observation, haptid.WLS()).conf_int(), axis=1)[:, 0] * 1.5
    ).all()
    # A combination is a parameter like any other.
    both = np.eye(len(low))[[k]] + np.eye(len(low))[[found.base.names.index("FC2")]]
    spread = found.spread(both)
    half = 2.0 * np.sqrt(np.diag(spread.covariance))
    ends = Profile().ends(
        found.fit, found.constrained_fit, np.concatenate([both, np.eye(len(low))[[k]]]), np.append(half, half)
    )
    assert ends[0, 0] <= float(both[0] @ found.beta) <= ends[0, 1]
    assert ends[1, 0] >= -1e-9


@pytest.mark.parametrize("level", [0.8, 0.95])
def test_ends_are_the_furthest_that_bodies_can_have(level):
    """Oracle: the cost of the best fit with the parameter fixed just inside an end, and just outside."""
    found = at_the_border()
    k, R = found.base.names.index("FC2"), found.fit.solution.R
    inside = found.feasible.chi
    raw = found.model.device.parameters.S @ inside
    assert np.linalg.eigvalsh(pseudo_inertia(raw[10:20]))[0] > -1e-9
    size = np.linalg.norm(found.fit.solution.root[k])
    half = float(np.diff(haptid.estimate(found.observation, haptid.WLS()).conf_int(level)[k])[0] / 2)
    most = np.sum((R @ (found.beta - found.constrained_fit.free)) ** 2) + (half / size) ** 2

    def cost(value):
        rows = np.zeros(len(found.beta))
        rows[k] = 1e6
        metric, target = np.vstack([R, rows]), found.constrained_fit.free.copy()
        target = np.linalg.lstsq(metric, np.append(R @ target, 1e6 * value), rcond=None)[0]
        near = haptid.estimation.project_to_feasible(found.model, target, np.linalg.qr(metric, mode="r"))
        return np.sum((R @ (near.beta - found.constrained_fit.free)) ** 2)

    low, high = found.conf_int(level)[k]
    step = 0.02 * (high - low)
    free = float(found.constrained_fit.free[k])
    assert cost(low + step) < most
    assert cost(high - step) < most
    # Beyond an end the fit is worse, or the unconstrained interval ends there too.
    assert most < cost(low - step) or low == pytest.approx(free - half, rel=1e-9)
    assert most < cost(high + step) or high == pytest.approx(free + half, rel=1e-9)


def test_it_covers_the_truth_as_often_as_stated():
    model = two_links()
    beta = truth(model, 0.0)
    inside, widths = [], []
    for seed in range(RUNS):
        found = haptid.estimate(observed(model, beta, seed), haptid.PhysicallyConsistent(), Profile())
        low, high = found.conf_int().T
        inside.append((low - 1e-9 <= beta) & (beta <= high + 1e-9))
        free = haptid.estimate(found.observation, haptid.PhysicallyConsistent()).conf_int()
        widths.append((high - low) / (free[:, 1] - free[:, 0]))
    shares = np.mean(inside, axis=1)
    assert shares.mean() > 0.95 - of_mean(shares)
    assert np.mean(inside, axis=0).min() > 0.95 - of_share(0.95, RUNS)
    assert np.median(widths) <= 1.0 + 1e-6


def test_an_end_of_an_arm_of_seven_joints_is_one_programme(monkeypatch):
    model, asked = haptid.DynamicModel(haptid.read_device("arm7")), []
    furthest = profile.furthest
    monkeypatch.setattr(profile, "furthest", lambda *given: (asked.append(given), furthest(*given))[1])
    beta = model.base.of(true_parameters(model))
    found = haptid.estimate(observed(model, beta, seconds=10.0), haptid.PhysicallyConsistent(), Profile())
    ends = found.conf_int()
    assert 0 < len(asked) <= 2 * len(beta)
    assert (ends[:, 0] <= found.beta).all()
    assert (found.beta <= ends[:, 1]).all()
