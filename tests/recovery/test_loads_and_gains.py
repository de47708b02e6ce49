"""Known loads: logs with and without them tell one model, and what the motors really give."""

from importlib import import_module

import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.device.priors import PriorBody
from haptid.inference import drive_gains
from haptid.observation import without_payload
from motions import motion

DEVICE = """
schema = 1
name = "three links"
gravity = [3.0, -9.0, 2.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
alpha = "pi/2"
d = 0.1
[[joints]]
name = "3"
d = 0.3
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
LOAD = PriorBody(0.8, np.array([0.25, 0.05, 0.02]), np.diag([0.002, 0.004, 0.003]))


def device_of(folder, text=DEVICE):
    (folder / "device.toml").write_text(text)
    return haptid.DynamicModel(haptid.read_device(folder / "device.toml"))


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return device_of(tmp_path_factory.mktemp("device"))


def true_beta(model):
    size = {"M": 0.6, "X": 0.12, "Y": 0.1, "Z": 0.15, "F": 0.4}
    return np.array([size[name[0]] * (1 + 0.1 * k) for k, name in enumerate(model.base.names)])


def recorded(model, load=None, seed=1, noise=0.02, factor=1.0, seconds=10.0):
    """A motion; `factor` is what the motors give over what the file says, (3,)."""
    beta = true_beta(model) + (haptid.observation.payload_torque(model, "3", load) if load else 0.0)
    moved = motion(model, beta, seconds=seconds, dt=2e-3, seed=seed, noise=noise)
    return haptid.Motion(moved.dt, moved.q, moved.tau / factor, moved.treatment, rates=moved.rates)


def test_a_load_is_the_base_parameters_of_its_body(model):
    """Against the torque of a device that has the load as one more link, fixed."""
    shift = haptid.observation.payload_torque(model, "3", LOAD)
    chi = np.zeros(len(model.device.parameters.names))
    index, com = model.device.parameters.index, LOAD.com
    J = LOAD.inertia + LOAD.mass * (com @ com * np.eye(3) - np.outer(com, com))
    for kind, value in zip(("XX", "YY", "ZZ", "XY", "XZ", "YZ"), (*np.diag(J), J[0, 1], J[0, 2], J[1, 2]), strict=True):
        chi[index[f"{kind}3"]] = value
    for kind, value in zip(("MX", "MY", "MZ"), LOAD.mass * com, strict=True):
        chi[index[f"{kind}3"]] = value
    chi[index["M3"]] = LOAD.mass
    np.testing.assert_allclose(shift, model.base.of(chi), rtol=1e-12, atol=1e-15)


def test_logs_with_and_without_a_load_tell_one_model(model):
    bare, loaded = recorded(model), recorded(model, LOAD, seed=2)
    both = haptid.observe(model, bare) + haptid.observe(model, without_payload(model, loaded, "3", LOAD))
    estimate = haptid.estimate(both, haptid.WLS())
    low, high = estimate.conf_int().T
    inside = (low < true_beta(model)) & (true_beta(model) < high)
    assert inside.mean() >= 0.85
    exact = haptid.observe(model, without_payload(model, recorded(model, LOAD, noise=0.0), "3", LOAD))
    np.testing.assert_allclose(haptid.estimate(exact, haptid.OLS()).beta, true_beta(model), rtol=1e-9)


def test_gains_are_exact_without_noise(model):
    factor = np.array([0.8, 1.1, 1.25])
    bare, loaded = (
        haptid.observe(model, recorded(model, load, seed, noise=0.0, factor=factor))
        for load, seed in ((None, 1), (LOAD, 2))
    )
    found = drive_gains(bare, loaded, "3", LOAD)
    np.testing.assert_allclose(found.factor, factor, rtol=1e-8)
    np.testing.assert_allclose(found.beta, true_beta(model), rtol=1e-7)


def test_gains_are_inside_their_intervals(model):
    """Thirty draws of three motors, which are no ninety: of one draw, hits of two motors correlate by 0.6 to 0.75."""
    factor, inside, errors_ = np.array([0.8, 1.1, 1.25]), [], []
    for seed in range(1, 31):
        bare = haptid.observe(model, recorded(model, None, seed, factor=factor))
        loaded = haptid.observe(model, recorded(model, LOAD, 100 + seed, factor=factor))
        found = drive_gains(bare, loaded, "3", LOAD)
        low, high = found.conf_int().T
        inside += ((low < factor) & (factor < high)).tolist()
        errors_.append(np.abs(found.factor / factor - 1).max())
    assert np.mean(inside) >= 0.85
    assert np.median(errors_) < 0.01
    assert "of the file's gain" in found.summary()


def test_what_cannot_be_is_rejected(model, tmp_path, monkeypatch):
    with pytest.raises(errors.UnknownNameError):
        haptid.observation.payload_torque(model, "9", LOAD)
    flat = device_of(tmp_path, DEVICE + '[[symmetry]]\nreason = "flat"\nzero = ["MZ3"]\n')
    with pytest.raises(errors.DeviceError, match="MZ3"):
        haptid.observation.payload_torque(flat, "3", LOAD)
    bare = haptid.observe(model, recorded(model))
    with pytest.raises(errors.ModelMismatchError):
        drive_gains(bare, haptid.observe(flat, recorded(flat, seed=2)), "3", LOAD)
    monkeypatch.setattr(import_module("haptid.inference.drive_gains"), "MOST_STEPS", 1)
    loaded = haptid.observe(model, recorded(model, LOAD, seed=2, factor=0.5))
    with pytest.raises(errors.ConvergenceError):
        drive_gains(bare, loaded, "3", LOAD)
    with pytest.raises(errors.IdentifiabilityError, match="gain"):
        drive_gains(bare, haptid.observe(model, recorded(model, seed=3)), "3", PriorBody(0.0, np.zeros(3), None))
