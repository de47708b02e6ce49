"""Memory from file to motion: no channel is copied, filters work chunk by chunk."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pyarrow import parquet
from scipy import signal

import haptid
from haptid.errors import LogFileError
from haptid.log import as_array, checks, is_long, row_times
from haptid.log.formats.parquet import GROUPS_HELD
from haptid.log.lazy import CHUNK, OnDisk
from haptid.log.row_times import RawSignals
from haptid.log.spectrum import lattice_step
from haptid.motion.streaming import SAMPLES_FILTERED, filtered, memory
from small_study import write_study


class Constrained(OnDisk):
    """Samples in memory that go as if they were on disk."""

    def __init__(self, samples: np.ndarray) -> None:
        self.samples = samples

    @property
    def shape(self) -> tuple[int, int]:
        return self.samples.shape[0], self.samples.shape[1]

    def make(self, low: int, high: int) -> np.ndarray:
        return self.samples[low:high].T


def test_channels_of_a_parquet_file_stay_where_they_were_unpacked(tmp_path: Path) -> None:
    rng, names = np.random.default_rng(1), ("t", "q1", "q2", "u1", "u2")
    columns = {name: rng.normal(size=3000).cumsum() for name in names} | {"t": 1e-3 * np.arange(3000)}
    parquet.write_table(pa.table(columns), tmp_path / "log.parquet", row_group_size=700)
    channels = haptid.Channels(haptid.Signal(names[1:3], "rad"), haptid.Signal(names[3:], "N m"), time="t")
    log = haptid.read_log(tmp_path / "log.parquet", channels)
    for array, own in ((log.position, names[1:3]), (log.torque, names[3:])):
        np.testing.assert_array_equal(array.T, [columns[name] for name in own])
    distance = log.torque.ctypes.data - log.position.ctypes.data
    assert distance == log.position.nbytes  # one block, and nothing was copied out of it


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 8), st.sampled_from([0.02, 0.1, 0.5, 0.9]), st.integers(1, 60), st.integers(0, 9))
def test_pieces_are_filtered_as_the_whole(order: int, cutoff: float, more: int, seed: int) -> None:
    """Also where the last piece is shorter than what a filter is started with."""
    sections = np.asarray(signal.butter(order, cutoff, output="sos"))[None]
    samples = np.random.default_rng(seed).normal(size=(CHUNK + more, 2)).cumsum(axis=0)
    whole = signal.sosfiltfilt(sections[0], samples - samples[0], axis=0) + samples[0]
    assert memory(sections) >= 3 * (2 * sections.shape[1] + 1)
    for channels in (samples, as_array(Constrained(samples))):
        made = np.asarray(filtered(channels, sections, ((0, len(samples)),)))
        assert_allclose(made, whole, atol=1e-12 * np.abs(whole).max())


def test_what_stands_still_is_exactly_still_across_pieces() -> None:
    n = 2 * SAMPLES_FILTERED
    made = filtered(np.full((n, 1), 0.3), np.asarray(signal.butter(4, 0.08, output="sos"))[None], ((0, n),))
    assert np.ptp(made) == 0


@pytest.mark.parametrize("size", [5, checks.SAMPLES_CHECKED + 1, 3 * checks.SAMPLES_CHECKED, 3 * checks.SAMPLED + 7])
def test_the_longest_step_is_found_piece_by_piece(size: int) -> None:
    column = np.random.default_rng(size).normal(size=size)
    at, largest, sample = checks._steps(column)
    steps = np.abs(np.diff(column))
    assert (at, largest) == (int(np.argmax(steps)), steps.max())
    np.testing.assert_array_equal(sample, steps[:: max(1, steps.size // checks.SAMPLED)])


def test_an_opened_log_holds_its_times_once_and_no_row_marks(tmp_path: Path) -> None:
    """Times, and the activity of the positions: 8 bytes a sample each, beside chunks and row groups that are cached."""
    n, group, rng = 2**20, 2**17, np.random.default_rng(0)
    t = 1e-3 * np.arange(n)
    columns = {"t": t, "q": np.sin(t) + 1e-4 * rng.normal(size=n), "u": np.cos(t)}
    parquet.write_table(pa.table(columns), tmp_path / "log.parquet", row_group_size=group)
    channels = haptid.Channels(haptid.Signal(("q",), "rad"), haptid.Signal(("u",), "N m"), time="t")
    tracemalloc.start()
    try:
        log = haptid.open_log(tmp_path / "log.parquet", channels)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(log.t, t)
    assert held < 26 * n + 8 * group * GROUPS_HELD


def test_rough_steps_by_pieces_are_those_of_the_whole_channel() -> None:
    rng = np.random.default_rng(1)
    channel = np.sin(3e-3 * np.arange(3 * 4096)) + 1e-5 * rng.normal(size=3 * 4096)
    channel[5000:5200:3] += 0.01
    recorded = RawSignals(np.zeros(0, bool), np.zeros(0, bool), lambda: [channel], list)
    starts = np.arange(0, channel.size - row_times._PIECE + 1, row_times._PIECE)
    change = np.abs(np.diff(channel, n=2))
    noise = max(1.4826 * float(np.median(change)), lattice_step(channel) / 2**0.5)
    wanted = []
    for a in starts:
        speed = float(np.abs(np.diff(channel[a : a + row_times._PIECE])).mean())
        limit = max(row_times._ROUGH * noise, row_times._ROUGH_SHARE * speed)
        wanted.append(int((change[a : a + row_times._PIECE - 2] > limit).sum()))
    assert max(wanted) > 50
    assert row_times._rough_steps(recorded, starts).tolist() == wanted


def test_a_large_file_is_one_that_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.parquet").write_bytes(b"PAR1")
    assert not is_long(tmp_path / "log.parquet")
    monkeypatch.setattr("haptid.log.read._LARGE", 3)
    assert is_long(tmp_path / "log.parquet")


def test_a_study_of_logs_that_are_opened_is_that_of_logs_that_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = write_study(tmp_path)
    for log in tmp_path.glob("*.csv"):
        parquet.write_table(pa.csv.read_csv(log), log.with_suffix(".parquet"))
    study.write_text(study.read_text().replace(".csv", ".parquet"))
    read = haptid.identify(haptid.read_study(study))
    monkeypatch.setattr("haptid.log.read._LARGE_TOGETHER", 0)
    monkeypatch.setattr("haptid.log.read._LARGE_AMONG_MANY", 0)
    opened = haptid.identify(haptid.read_study(study))
    logs = [[run.motion.log for run in found.runs] for found in (read, opened)]
    assert [isinstance(log.position, np.ndarray) for several in logs for log in several] == [True] * 2 + [False] * 2
    np.testing.assert_allclose(opened.estimate.beta, read.estimate.beta, rtol=1e-9)


def test_a_path_that_cannot_be_is_an_error_of_the_log(tmp_path: Path) -> None:
    """The system refuses the name; it was called one of the results."""
    study = write_study(tmp_path)
    study.write_text(study.read_text().replace("log.csv", "a" * 300 + ".csv"))
    with pytest.raises(LogFileError):
        haptid.identify(haptid.read_study(study))


def test_of_logs_that_are_large_together_shorter_ones_are_opened(tmp_path: Path) -> None:
    log = tmp_path / "log.parquet"
    with log.open("wb") as file:
        file.truncate(2**21)
    assert not is_long(log, 2**28)
    assert is_long(log, 2**28 + 1)
    log.write_bytes(b"PAR1")  # a very short one is faster read
    assert not is_long(log, 2**30)
