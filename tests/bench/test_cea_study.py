"""The study of one branch of the CEA interface reads what the bench writes of its experiments."""

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.experiment import bench

pytest.importorskip("mujoco", reason="MuJoCo has no wheel for this platform")


def test_its_channels_and_logs_are_those_of_the_bench(request, tmp_path):
    examples = request.config.rootpath / "examples/cea"
    study = haptid.read_study(examples / "study.toml")
    assert (
        bench.read_experiment(examples / "excite.toml")
        .setup(haptid.DynamicModel(haptid.read_device(study.device)))
        .model.device.handle
    )
    text = (examples / "experiment.toml").read_text(encoding="utf-8").replace("seconds = 30.0", "seconds = 3.0")
    (tmp_path / "short.toml").write_text(text, encoding="utf-8")
    log = tmp_path / "log.parquet"
    done = CliRunner().invoke(app, ["bench", study.device, str(tmp_path / "short.toml"), "--out", str(log)])
    assert done.exit_code == 0, done.stderr
    written = set(pq.read_schema(log).names)
    for entry in study.logs:
        assert {entry.channels.time, *entry.channels.position.channels, *entry.channels.torque.channels} <= written
    commands = (examples / "study.toml").read_text(encoding="utf-8")
    for entry in study.logs:
        assert f"--out logs/{entry.path}" in commands
