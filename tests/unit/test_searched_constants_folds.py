"""Searched constants in results, in the report, and in fits to rows that are held out."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import haptid
from haptid.cli import app
from haptid.estimation.nonlinear import AlternateBlocks, variable_projection
from haptid.validation.cross_validation import alternate, each_log
from motions import motion
from small_study import DEVICE, HEAD

STRIBECK = """
[[terms]]
kind = "stribeck"
joints = ["2"]
velocity = { start = 0.5, low = 0.02, high = 5 }
"""
STUDY = f"""{HEAD}
[[logs]]
path = "log.parquet"
[validation]
cross_validation = "blocks"
[treatment]
cutoff_hz = "none"
parallel_cutoff_hz = 20
decimation = 5
torque_delay_s = 0
"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("device") / "device.toml"
    path.write_text(DEVICE + STRIBECK)
    return haptid.DynamicModel(haptid.read_device(path))


def moved(model, seed, velocity=0.3):
    sizes = {"FV": 0.4, "FC": 0.5, "FS": 0.8}
    beta = np.array([sizes.get(name[:2], 0.3) for name in model.base.names])
    return motion(model.at_constants((velocity,)), beta, seconds=8.0, dt=4e-3, seed=seed, noise=0.03)


def test_half_the_blocks_tell_a_constant_of_their_own(model):
    whole = moved(model, 1)
    values = [variable_projection(model, [AlternateBlocks(whole, k)])["FS2.velocity"].value for k in (0, 1)]
    assert values[0] != values[1]
    np.testing.assert_allclose(values, 0.3, rtol=0.3)


def test_a_fold_knows_nothing_of_what_it_predicts(model):
    """The other log has another constant: whoever had seen it would come nearer."""
    near, far = moved(model, 1), moved(model, 2, velocity=1.2)
    fold = each_log(model, far, [near], haptid.WLS())
    found = variable_projection(model, [near])
    own = haptid.validate(
        haptid.estimate(haptid.observe(found.model, near), haptid.WLS()), haptid.observe(found.model, far)
    )
    assert fold.relative == pytest.approx(own.relative, rel=1e-9)
    seen = variable_projection(model, [near, far]).model
    leaked = haptid.validate(haptid.estimate(haptid.observe(seen, near), haptid.WLS()), haptid.observe(seen, far))
    assert leaked.relative < fold.relative
    (both,) = alternate(model, [near], [], haptid.WLS())
    assert not both.seen
    assert both.relative < 5.0


def test_the_command_shows_them(model, tmp_path):
    (tmp_path / "device.toml").write_text(DEVICE + STRIBECK)
    (tmp_path / "study.toml").write_text(STUDY)
    made = moved(model, 1)
    columns = {"t": made.t0 + made.dt * np.arange(len(made))}
    columns |= {f"q{k + 1}": made.q[:, k] for k in (0, 1)} | {f"tau{k + 1}": made.tau[:, k] for k in (0, 1)}
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    ran = CliRunner().invoke(app, ["identify", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 0, ran.output
    assert "Nonlinear constants" in ran.output
    (entry,) = json.loads((tmp_path / "out" / "result.json").read_text())["estimate"]["nonlinear_constants"]
    assert entry["name"] == "FS2.velocity"
    assert entry["conf_int"][0] < 0.3 < entry["conf_int"][1]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Nonlinear constants" in page
    assert "FS2.velocity" in page
