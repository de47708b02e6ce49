"""Known parameters come back, exactly without noise, and inside their own intervals with it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import haptid
from motions import motion, truth

DEVICES = [
    "phantom_premium_15",
    "cea_medical_branch",
    "rx90",
    "sr400",
    "puma560",
    "staubli_tx40",
    "arm7",
    "emps",
]


@pytest.mark.parametrize("name", DEVICES)
def test_without_noise_they_come_back_exactly(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    beta = np.random.default_rng(0).uniform(0.5, 1.5, len(model.base))
    made = motion(model, beta, seconds=20.0, dt=4e-3)
    observation = haptid.observe(model, made)
    found = haptid.estimate(observation, haptid.OLS())
    np.testing.assert_allclose(found.beta, beta, rtol=1e-12 * observation.condition[0] + 1e-9)
    assert haptid.fit_errors(found).relative < 1e-9


@pytest.mark.parametrize(("phi", "decimation"), [(0.0, 1), (0.95, 1), (0.95, 10)])
def test_intervals_hold_the_truth_about_95_times_in_100(phi, decimation):
    """A small version of benchmarks/coverage.py: 40 runs of 14 parameters, white and correlated residuals."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = truth(model)
    treatment = haptid.Treatment(cutoff_hz=None, decimation=decimation)
    runs, inside = 40, 0
    for run in range(runs):
        made = _noisy(model, beta, run, phi, treatment)
        low, high = haptid.estimate(haptid.observe(model, made), haptid.WLS()).conf_int().T
        inside += int(((low <= beta) & (beta <= high)).sum())
    share = inside / (runs * len(beta))
    assert 0.90 < share < 0.99


def _noisy(model, beta, run, phi, treatment):
    """One motion, its torque with noise of 10 % of it drawn from `run`."""
    clean = motion(model, beta, seconds=15.0, treatment=treatment)
    white = np.random.default_rng(run).standard_normal((len(clean) + 500, 3)) * np.sqrt(1 - phi**2)
    noise = signal.lfilter([1.0], [1.0, -phi], white, axis=0)[500:]
    return replace(clean, tau=clean.tau + 0.1 * clean.tau.std(axis=0) * noise)


def test_classical_intervals_do_not_hold_it_when_residuals_are_correlated():
    """What the honest interval is for: with correlated residuals the textbook's is far too narrow."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    found = haptid.estimate(
        haptid.observe(model, motion(model, truth(model), seconds=20.0, noise=0.1, phi=0.98)), haptid.WLS()
    )
    ratio = found.se / np.sqrt(np.diag(found.classical_covariance))
    assert np.median(ratio) > 2


IDENTICAL = """
schema = 1
name = "two equal pendulums on one another"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[terms]]
kind = "viscous"
joints = "all"
[[symmetry]]
reason = "cut from one drawing"
identical = ["1", "2"]
[[symmetry]]
reason = "slender"
zero = ["MY1"]
"""


def test_parameters_declared_equal_are_one_parameter_with_the_columns_of_both(tmp_path):
    """Torque of two equal links from the general device comes back as the one set of values they share."""
    (tmp_path / "equal.toml").write_text(IDENTICAL)
    (tmp_path / "general.toml").write_text(IDENTICAL.split("[[symmetry]]")[0])
    equal, general = (
        haptid.DynamicModel(haptid.read_device(tmp_path / f"{name}.toml")) for name in ("equal", "general")
    )
    assert len(equal.base) < len(general.base)
    assert any("cut from one drawing" in sentence for sentence in equal.device.notes)
    values = {"ZZ": 0.02, "MX": 0.15, "MY": 0.0, "M": 1.1, "FV": 0.3}
    chi = [values.get(kind, 0.01) for kind in general.device.parameters.kinds]
    made = motion(general, general.base.of(np.array(chi)))
    found = haptid.estimate(haptid.observe(equal, made), haptid.OLS())
    shared = np.array([values.get(kind, 0.01) for kind in equal.device.parameters.kinds])
    np.testing.assert_allclose(found.beta, equal.base.of(shared), rtol=1e-8)
