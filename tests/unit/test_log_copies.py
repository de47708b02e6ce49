"""Samples of one recording in two files: one that was saved again, converted, or cut out of another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import haptid
from haptid.errors import SharedRowsError
from haptid.log import same_samples
from haptid.study.check import check_study

T = np.arange(3000) * 2e-3
DEVICE = """
schema = 1
name = "pendulum"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
[[terms]]
kind = "viscous"
joints = "all"
"""
STUDY = """
schema = 1
device = "device.toml"
[channels]
time = "t"
position = { channels = ["q"], unit = "rad" }
torque = { channels = ["tau"], unit = "N m" }
[[logs]]
path = "one.csv"
[[logs]]
path = "OTHER"
role = "validate"
"""


def recorded(seed: int, share: float = 0.01) -> np.ndarray:
    """Times, position and torque of one motion, (n, 3), each with noise of its own that is a share of its size."""
    q = 0.6 * np.sin(5.0 * T) + 0.3 * np.sin(11.0 * T + 1.0)
    v = 3.0 * np.cos(5.0 * T) + 3.3 * np.cos(11.0 * T + 1.0)
    a = -15.0 * np.sin(5.0 * T) - 36.3 * np.sin(11.0 * T + 1.0)
    tau = 0.02 * a + 0.9 * np.cos(q) + 0.05 * v
    noise = np.random.default_rng(seed).standard_normal((2, T.size))
    return np.column_stack([T, q + 0.1 * share * q.std() * noise[0], tau + share * tau.std() * noise[1]])


def written(path: Path, table: np.ndarray, digits: int = 9) -> Path:
    np.savetxt(path, table, delimiter=",", header="t,q,tau", comments="", fmt=f"%.{digits}g")
    return path


def read(path: Path) -> haptid.Log:
    signals = {"position": haptid.Signal(("q",), "rad"), "torque": haptid.Signal(("tau",), "N m")}
    return haptid.read_log(path, haptid.Channels(**signals, time="t"))


def test_a_log_that_was_saved_again_or_cut_is_found(tmp_path: Path) -> None:
    table = recorded(0)
    one = read(written(tmp_path / "one.csv", table))
    again = read(written(tmp_path / "again.csv", table, digits=6))
    part = table[700:1900] - [[table[700, 0], 0.0, 0.0]]
    cut = read(written(tmp_path / "cut.csv", part))
    savemat(tmp_path / "one.mat", dict(zip(("t", "q", "tau"), table.T, strict=True)))
    for first, second, start in (
        (one, again, 0.0),
        (one, read(tmp_path / "one.mat"), 0.0),
        (one, cut, 0.0),
        (cut, one, 1.4),
    ):
        found = same_samples(first, second)
        assert found is not None
        assert found[0] == pytest.approx(start, abs=1e-6)
        assert found[1] > found[0] + 1.0


@pytest.mark.parametrize(("every", "first"), [(2, 0), (3, 2), (10, 7)])
def test_every_other_sample_of_a_log_is_found(tmp_path: Path, every: int, first: int) -> None:
    """A copy at a lower rate validated the log that it is of."""
    table = recorded(0)
    one, slower = read(written(tmp_path / "one.csv", table)), read(written(tmp_path / "s.csv", table[first::every]))
    for logs, start in (((one, slower), 0.0), ((slower, one), T[first])):
        found = same_samples(*logs)
        assert found is not None
        assert found[0] == pytest.approx(start, abs=1e-6)
    repeated = read(written(tmp_path / "r.csv", recorded(1, 0.001)[first::every]))
    assert same_samples(one, repeated) is None


@pytest.mark.parametrize("share", [0.001, 0.01])
def test_a_motion_that_is_repeated_is_another_recording(tmp_path: Path, share: float) -> None:
    one, other = (read(written(tmp_path / f"{k}.csv", recorded(k, share))) for k in range(2))
    assert same_samples(one, other) is None
    assert same_samples(one, one) is None  # rows of one file are told by their times


def test_the_same_approach_does_not_make_simulated_logs_one(tmp_path: Path) -> None:
    one, other = recorded(0), recorded(1)
    other[:1100] = one[:1100]  # one of the four pieces
    logs = [read(written(tmp_path / f"{k}.csv", table)) for k, table in enumerate((one, other))]
    assert same_samples(*logs) is None


@pytest.mark.parametrize(("seed", "refused"), [(0, True), (1, False)])
def test_a_copy_does_not_validate(tmp_path: Path, seed: int, refused: bool) -> None:
    written(tmp_path / "one.csv", recorded(0))
    written(tmp_path / "other.csv", recorded(seed)[400:], digits=8)
    (tmp_path / "device.toml").write_text(DEVICE)
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("OTHER", "other.csv"))
    problems = check_study(path).problems
    if refused:
        assert "other.csv has samples of one.csv" in problems[0]
        with pytest.raises(SharedRowsError, match=r"validate with another recording"):
            haptid.identify(haptid.read_study(path))
    else:
        assert not problems
        assert haptid.identify(haptid.read_study(path)).unseen[0].relative < 5.0
