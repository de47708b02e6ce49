"""The entropic penalty: zero at the prior, frame-invariant, consistent in the limit, better in poor logs."""

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.estimation import PhysicallyConsistent, Profile
from haptid.estimation.feasibility.feasible import roomy
from haptid.estimation.methods.regularised import Entropic, EntropicPenalty, prior_links
from motions import motion

BODY = """
[[prior.bodies]]
link = "{link}"
mass = {mass}
com = [{x}, 0.01, -0.02]
inertia = [0.02, 0.05, 0.06, 0.001, 0.0, 0.002]
"""
DEVICE = """
schema = 1
name = "two links"
gravity = [0.0, -9.81, 3.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
alpha = "pi/2"
d = 0.3
[[joints]]
name = "3"
d = 0.25
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
""" + "".join(BODY.format(link=k, mass=m, x=x) for k, m, x in (("1", 2.0, 0.1), ("2", 1.5, 0.12), ("3", 0.8, 0.1)))


def device_of(folder, text=DEVICE):
    (folder / "device.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / "device.toml"))


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return device_of(tmp_path_factory.mktemp("device"))


def true_beta(model, factor=1.1):
    """Bodies heavier than the prior by a factor, and friction."""
    chi = np.nan_to_num(model.device.chi_prior) * factor
    for k, kind in enumerate(model.device.parameters.kinds):
        chi[k] = {"FV": 0.3, "FC": 0.5}.get(kind, chi[k])
    return model.base.of(chi)


def observed(model, noise=0.05, seed=1, seconds=8.0):
    return haptid.observe(model, motion(model, true_beta(model), seconds=seconds, dt=2e-3, seed=seed, noise=noise))


def test_a_prior_that_is_the_truth_stays(model):
    conditions = roomy(model, model.base.of(np.nan_to_num(model.device.chi_prior) + 0.1))
    pull = EntropicPenalty(conditions, tuple(block.is_link for block in conditions.blocks))
    R = np.zeros((len(model.base),) * 2)  # no data
    x = pull.minimiser(R, np.zeros(len(model.base)), 1.0)
    raw = [k for k, kind in enumerate(model.device.parameters.kinds) if kind not in ("FV", "FC")]
    np.testing.assert_allclose((conditions.scale * x)[raw], model.device.chi_prior[raw], rtol=1e-6, atol=1e-9)


def test_a_vanishing_pull_is_the_consistent_estimate(model):
    observation = observed(model, noise=0.6, seconds=3.0)
    held = haptid.estimate(observation, PhysicallyConsistent())
    pulled = haptid.estimate(observation, Entropic(1e-4))
    np.testing.assert_allclose(
        observation.stack(held.weights)[:-1, :-1] @ (pulled.beta - held.beta), 0.0, atol=0.2 * np.sqrt(len(held.beta))
    )


def test_a_strong_pull_is_the_prior(model):
    pulled = haptid.estimate(observed(model), Entropic(1e14))
    chi, prior = pulled.feasible.chi, model.device.chi_prior
    links = [k for k, kind in enumerate(model.device.parameters.kinds) if kind not in ("FV", "FC")]
    np.testing.assert_allclose(chi[links], prior[links], rtol=1e-3, atol=1e-5)


def test_frames_of_bodies_do_not_matter(model, tmp_path):
    """The same mechanism and bodies, the last link's frame moved along its axis."""
    text = DEVICE.replace("d = 0.25\n", "d = 0.25\nr = 0.2\n")
    head, tail = text.rsplit("-0.02]", 1)
    other = device_of(tmp_path, f"{head}-0.22]{tail}")
    moved = motion(model, true_beta(model), seconds=4.0, dt=2e-3, noise=0.3)
    torques = []
    for same in (model, other):
        beta = haptid.estimate(haptid.observe(same, moved), Entropic(100.0)).beta
        torques.append(haptid.inverse_dynamics(same, beta, *np.random.default_rng(0).uniform(-1, 1, (3, 3, 50))))
    np.testing.assert_allclose(torques[0], torques[1], rtol=1e-4, atol=1e-4)


def test_it_is_inside_and_stationary(model):
    pulled = haptid.estimate(observed(model, noise=0.5, seconds=3.0), Entropic(10.0))
    assert haptid.estimation.feasible_parameters(model, pulled.beta).ok
    assert all(np.linalg.eigvalsh(P)[0] > 0 for P in pulled.feasible.pseudo_inertias)


def test_poor_logs_gain_most(model):
    """Unseen torque of a short noisy log: the pull towards bodies 10 % off beats the free fit."""
    unseen = observed(model, noise=0.0, seed=99)
    gains = []
    for seed in range(4):
        poor = observed(model, noise=1.0, seed=seed, seconds=1.5)
        free = haptid.validate(haptid.estimate(poor, haptid.WLS()), unseen).relative
        pulled = haptid.validate(haptid.estimate(poor, Entropic()), unseen).relative
        gains.append(free / pulled)
    assert np.median(gains) > 1.5


def test_truth_is_inside_its_intervals(model):
    beta, inside = true_beta(model), []
    for seed in range(5):
        low, high = haptid.estimate(observed(model, seed=seed), Entropic()).conf_int().T
        inside += ((low <= beta) & (beta <= high)).tolist()
    assert np.mean(inside) >= 0.9


def test_there_is_no_profile_of_what_is_pulled(model):
    observation = observed(model, seconds=2.0)
    found = haptid.estimate(observation, Entropic(1.0), Profile())
    assert found.constrained_fit.pulled
    with pytest.raises(errors.SettingError) as raised:
        _ = found.conf_int()
    assert raised.value.where == "intervals"
    assert "ClusterRobust" in raised.value.advice
    assert not haptid.estimate(observation, PhysicallyConsistent()).constrained_fit.pulled


def test_what_cannot_be_pulled_is_rejected(model, tmp_path):
    assert prior_links(model) == ["1", "2", "3"]
    with pytest.raises(errors.SettingError):
        Entropic(-1.0)
    bare = device_of(tmp_path, DEVICE.split("[[prior.bodies]]")[0])
    with pytest.raises(errors.IncompleteDeviceError):
        haptid.estimate(observed(model).__class__(bare, observed(model).motors, observed(model).blocks, ()), Entropic())
