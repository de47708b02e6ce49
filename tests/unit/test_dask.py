"""A Dask cluster of processes on this machine: the same results, also with a worker killed in the middle."""

from __future__ import annotations

import json
import socketserver
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

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


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("tcp://127.0.0.1:9", "Timed out"),
        ("nowhere", "missing port number"),
        ("http://127.0.0.1:8787", "unknown address scheme 'http'"),
        ("", "missing port number"),
    ],
)
def test_a_scheduler_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch, address: str, why: str) -> None:
    monkeypatch.setattr("haptid.executors.cluster.PATIENCE", 1.0)
    with pytest.raises(errors.ExecutorError, match=f"no Dask scheduler answers at {address}.*({why})"):
        list(DaskExecutor(address).map(abs, [1]))


def test_a_program_that_is_no_scheduler_is_told(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    """Such as a page of the web on the port beside, or a worker of the same cluster."""
    monkeypatch.setattr("haptid.executors.cluster.PATIENCE", 1.0)
    with (
        socketserver.ThreadingTCPServer(("127.0.0.1", 0), _WebPage) as server,
        distributed.Client(address, set_as_default=False) as client,
    ):
        Thread(target=server.serve_forever, daemon=True).start()
        with pytest.raises(errors.ExecutorError, match="what listens there does not speak"):
            DaskExecutor(f"tcp://127.0.0.1:{server.server_address[1]}").check()
        server.shutdown()
        worker = next(iter(client.scheduler_info()["workers"]))
    with pytest.raises(errors.ExecutorError, match="it is the address of a Worker"):
        DaskExecutor(worker).check()


class _WebPage(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        self.request.sendall(b"HTTP/1.0 400 Bad Request\r\n\r\n")
        self.request.recv(1)  # until the other side ends


@pytest.mark.parametrize("command", [["identify"], ["fleet", "."], ["pool", "."], ["bench"]])
def test_a_wrong_scheduler_is_one_error_of_each_command(tmp_path: Path, command: list[str]) -> None:
    """In a process of its own, as what Dask leaves undone is printed at its end."""
    study = str(write_study(tmp_path))
    given = [command[0], study, *command[1:]]
    if command == ["bench"]:
        experiment = Path(__file__).parents[2] / "examples" / "phantom" / "experiment.toml"
        given = ["bench", "phantom_premium_15", str(experiment), "--count", "2"]
    out = str(tmp_path / "out.parquet")
    call = [sys.executable, "-m", "haptid", *given, "--out", out, "--scheduler", "nowhere", "--quiet"]
    done = subprocess.run(call, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: no Dask scheduler answers at nowhere: missing port number")
    assert done.stderr.rstrip().endswith("give the address that the scheduler prints.")
    assert "Traceback" not in done.stderr
