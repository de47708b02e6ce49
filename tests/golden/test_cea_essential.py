"""One branch of the CEA interface: 34 parameters become the 15 that Janot et al. (2007) print in table 1."""

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import haptid
from haptid.experiment import bench
from haptid.experiment.excitation import observed_motion
from haptid.inference.elimination import eliminate

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "cea"
DEVICE = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
# Table 1, upper branch, as identified.
NAMES = [
    "ZZ1R",
    "MX1R",
    "MY1R",
    "FC1",
    "XX2R",
    "ZZ2R",
    "MX2R",
    "FC2R",
    "OFF2",
    "XX3R",
    "ZZ3R",
    "MX3R",
    "MX5R",
    "FC5R",
    "OFF5",
]
VALUES = [0.051, 0.006, 0.030, 0.12, -0.023, 0.029, -0.019, 0.11, 0.020, -0.011, 0.014, 0.039, 0.068, 0.11, 0.030]
PUBLISHED = dict(zip(NAMES, VALUES, strict=True))
BETA = np.array([PUBLISHED.get(name, 0.0) for name in DEVICE.base.names])
NOISE, CORRELATION = 5e-3, 0.95  # N m, and from one sample to the next


def planned(file, dt):
    experiment = bench.read_experiment(EXAMPLES / file)
    phases = np.random.default_rng(np.random.SeedSequence(experiment.seed).spawn(2)[0])
    return bench.plan(experiment.kind, DEVICE, dt, phases)


def fitted(file, seed):
    made = planned(file, 4e-3)
    tau = haptid.inverse_dynamics(DEVICE, BETA, made.q.T, made.qd.T, made.qdd.T)
    white = NOISE * np.sqrt(1 - CORRELATION**2) * np.random.default_rng(seed).standard_normal((3, len(made) + 500))
    tau = tau + signal.lfilter([1.0], [1.0, -CORRELATION], white, axis=1)[:, 500:]
    rates = (made.qd, made.qdd)
    motion = haptid.Motion(made.dt, made.q, tau.T, haptid.Treatment(cutoff_hz=None), rates=rates)
    return haptid.estimate(haptid.observe(DEVICE, motion), haptid.OLS())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_34_parameters_become_the_15_of_the_paper(seed):
    found = eliminate(fitted("excite.toml", seed))
    assert len(found.full.free_parameters) == 34
    assert set(found.essential) == set(PUBLISHED)
    assert np.nanmax(np.abs(found.shift)) < 4
    low, high = found.reduced.conf_int().T
    inside = [low[k] <= BETA[k] <= high[k] for k in found.reduced.free_parameters]
    assert np.mean(inside) > 0.8
    assert found.seen[1].relative < 1.03 * found.seen[0].relative


def test_condition_of_16000_rows_and_34_columns():
    """The paper says close to 50. Within 60 degrees and 4.5 rad/s, and no loop flat, the 15 alone reach that."""
    observation = observed_motion(DEVICE, planned("excite.toml", 20 / 5333))
    assert observation.rows == pytest.approx(16000, rel=1e-3)
    raw, scaled = observation.condition
    assert raw == pytest.approx(1925, rel=0.01)
    assert scaled == pytest.approx(849, rel=0.01)
    others = [k for k, name in enumerate(DEVICE.base.names) if name not in PUBLISHED]
    raw, scaled = observation.condition_without(others)
    assert raw == pytest.approx(142, rel=0.01)
    assert scaled == pytest.approx(16.5, rel=0.01)
    plain = observed_motion(DEVICE, planned("experiment.toml", 30 / 5333))
    assert plain.condition[1] > 20 * observation.condition[1]


def test_exciting_motion_is_one_that_the_bench_accepts():
    made = planned("excite.toml", 1e-3)
    chi = bench.read_experiment(EXAMPLES / "excite.toml").setup(DEVICE).chi
    bench.check_trajectory(DEVICE, made, chi)
    assert (np.abs(made.q - [0.1, -1.0, 3.79]) < np.radians(60)).all()
    assert np.abs(made.qd).max() < 4.51
