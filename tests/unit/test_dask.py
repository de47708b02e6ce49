"""A Dask cluster of processes on this machine: the same results, also with a worker killed in the middle."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import haptid
from haptid import errors
from haptid.app.work import WORK
from haptid.cli import app
from haptid.executors import DaskExecutor
from haptid.observation.batch import observe_all
from motions import motion, truth
from small_study import write_study
from work_to_share import killed_once

distributed = pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning"),
]


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            yield cluster.scheduler_address


def test_a_killed_worker_costs_only_its_tasks(address: str, tmp_path: Path) -> None:
    items = [(tmp_path, k) for k in range(6)]
    assert dict(DaskExecutor(address).map(killed_once, items)) == {k: k for k in range(6)}
    assert (tmp_path / "killed").exists()


def test_a_cluster_gives_the_observation_of_one_process(address: str) -> None:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    treatment = haptid.Treatment(cutoff_hz=None, decimation=10)
    made = motion(model, truth(model), seconds=80.0, noise=0.1, treatment=treatment)
    (there,) = observe_all(model, [made], DaskExecutor(address))
    for a, b in zip(haptid.observe(model, made).motors, there.motors, strict=True):
        np.testing.assert_allclose(a.r_factors, b.r_factors, rtol=0, atol=1e-12 * np.abs(a.r_factors).max())


def test_the_command_and_the_workbench_share_a_study(address: str, tmp_path: Path) -> None:
    study = write_study(tmp_path)
    options = ["--out", str(tmp_path / "out"), "--scheduler", address, "--no-report"]
    done = CliRunner().invoke(app, ["identify", str(study), *options])
    assert done.exit_code in (0, 1), done.output  # 1: a criterion is not met
    alone = haptid.identify(haptid.read_study(study)).estimate
    job = {"study": str(study), "out": str(tmp_path / "job"), "command": "", "scheduler": address}
    WORK["identify"](job, lambda _what, _share: None)
    for out in ("out", "job"):
        stored = json.loads((tmp_path / out / "result.json").read_text())["estimate"]["parameters"]
        shared = [parameter["value"] for parameter in stored]
        np.testing.assert_allclose(shared, alone.beta, rtol=0, atol=1e-12 * np.abs(alone.beta).max())


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("haptid.executors.cluster.PATIENCE", 1.0)
    with pytest.raises(errors.ExecutorError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9"):
        list(DaskExecutor("tcp://127.0.0.1:9").map(abs, [1]))
