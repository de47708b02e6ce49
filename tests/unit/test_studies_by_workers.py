"""Monte Carlo studies, bootstraps and sweeps of the bench: whoever works, the figures are the same."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pyarrow import parquet

import haptid
from haptid.estimation import Bootstrap
from haptid.executors import DaskExecutor, Executor, ProcessExecutor, SerialExecutor
from motions import motion, truth
from small_study import two_links

distributed = pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="as the other tests of clusters"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning"),
]
EXPERIMENT = """
schema = 1
name = "short"
[trajectory]
kind = "multisine"
seconds = 0.4
ramp = 0.1
centre = [0.0, 0.2, 0.3]
amplitude = 0.1
[controller]
kp = [40.0, 35.0, 14.0]
kd = [0.5, 0.4, 0.16]
"""


@pytest.fixture(scope="module")
def crews() -> Iterator[tuple[Executor, ...]]:
    """Two processes, and a scheduler with two workers in this one; test_dask.py has workers in processes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        local = {"processes": False, "protocol": "tcp", "dashboard_address": None}
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **local) as cluster:
            yield ProcessExecutor(2), DaskExecutor(cluster.scheduler_address)


@dataclass(frozen=True, eq=False)
class Trial:
    """An identification with noise of its own; called with a seed, its values and deviations, (2, p)."""

    model: haptid.Device
    beta: np.ndarray

    def __call__(self, seed: int) -> np.ndarray:
        treatment = haptid.Treatment(cutoff_hz=None, decimation=4)
        made = motion(self.model, self.beta, seconds=6.0, dt=2e-3, seed=seed, noise=0.05, treatment=treatment)
        found = haptid.estimate(haptid.observe(self.model, made), haptid.WLS())
        return np.array([found.beta, found.se])


@dataclass(frozen=True, eq=False)
class Draws:
    """Bootstraps of one fit; called with a seed, its covariance, (p, p)."""

    estimate: haptid.Estimate

    def __call__(self, seed: int) -> np.ndarray:
        return Bootstrap(draws=20, seed=seed).spread(self.estimate.fit).covariance


def done(item: tuple[Trial | Draws, int]) -> np.ndarray:
    work, seed = item
    return work(seed)


def test_monte_carlo_and_bootstrap(crews: tuple[Executor, ...]) -> None:
    model = two_links()
    observation = haptid.observe(model, motion(model, truth(model) + 0.1, seconds=6.0, dt=2e-3, noise=0.05))
    trial, draws = Trial(model, truth(model) + 0.1), Draws(haptid.estimate(observation, haptid.WLS()))
    items = [(work, seed) for work in (trial, draws) for seed in (0, 1)]
    here = dict(SerialExecutor().map(done, items))
    for crew in crews:
        there = dict(crew.map(done, items))
        for k, figures in here.items():
            assert_allclose(there[k], figures, rtol=1e-12, atol=1e-12 * np.abs(figures).max())
    for first in (0, 2):
        assert (here[first] != here[first + 1]).any()  # each seed draws anew


def test_a_sweep_of_the_bench(crews: tuple[Executor, ...], tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from haptid.experiment.bench.run import Job, make_logs, repeated

    (tmp_path / "short.toml").write_text(EXPERIMENT)
    tables = []
    for crew in (SerialExecutor(), crews[1]):  # processes make the logs of `haptid bench --count`
        folder = tmp_path / type(crew).__name__
        folder.mkdir()
        jobs = repeated(Job("phantom_premium_15", tmp_path / "short.toml", folder / "log.parquet", seed=3), 2)
        tables.append([parquet.read_table(path) for path in make_logs(jobs, crew)])
    assert tables[0] == tables[1]
    assert not tables[0][0].equals(tables[0][1])
