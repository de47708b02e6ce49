"""A log that stays on disk is the log that was read, and gives the same observation."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import parquet

import haptid
from haptid import errors
from haptid.log import Channels, OnDisk, Signal, open_log, read_log
from haptid.log.lazy import CHUNK
from motions import motion, truth

QUICK = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
UNWRAPPED = Channels(Signal(("q1", "q2"), "deg", unwrap=True, gain=(2.0, -1.0)), Signal(("u",), "A"), time="t")


def samples(n: int, seed: int) -> dict[str, np.ndarray]:
    """Time, two angles in degrees that wrap, and a current, each (n,)."""
    rng, t = np.random.default_rng(seed), np.arange(n) * 1e-3
    angles = {f"q{k}": np.mod(400 * np.sin(0.3 * k * t + k), 360.0) for k in (1, 2)}
    return {"t": t, **angles, "u": rng.normal(size=n)}


def write(folder: Path, suffix: str, data: dict[str, np.ndarray], group: int = 50_000) -> Path:
    path = folder / f"log{suffix}"
    if suffix == ".parquet":
        parquet.write_table(pa.table(data), path, row_group_size=group)
        return path
    with h5py.File(path, "w") as file:
        for name, column in data.items():
            file.create_dataset(
                name,
                data=column,
                chunks=(min(10_000, len(column)) or 1,),
                maxshape=(None,),
                compression="gzip",
                compression_opts=1,
            )
    return path


def disturbed(data: dict[str, np.ndarray], kind: str, seed: int) -> dict[str, np.ndarray]:
    """The same with samples repeated, samples missing, or irregular times."""
    rng, n = np.random.default_rng(seed), data["t"].size
    if kind == "repeated":
        index = np.sort(np.append(np.arange(n), rng.choice(n, 20, replace=False)))
        return {name: column[index] for name, column in data.items()}
    if kind == "gaps":
        return {name: np.delete(column, rng.choice(n // 4, 20, replace=False) * 4 + 1) for name, column in data.items()}
    if kind == "irregular":
        return {**data, "t": data["t"] + rng.uniform(-2e-4, 2e-4, n)}
    return data


@QUICK
@given(
    st.sampled_from([".parquet", ".h5"]),
    st.sampled_from(["plain", "repeated", "gaps", "irregular"]),
    st.integers(0, 99),
    st.booleans(),
)
def test_an_opened_log_is_the_log_that_is_read(tmp_path: Path, suffix: str, kind: str, seed: int, part: bool) -> None:
    path = write(tmp_path, suffix, disturbed(samples(2 * CHUNK + 999, seed), kind, seed))
    time_range = (1.0, 120.0) if part else None
    read, opened = (how(path, UNWRAPPED, time_range) for how in (read_log, open_log))
    assert opened.notes == read.notes
    assert opened.sha256 == read.sha256
    np.testing.assert_array_equal(opened.t, read.t)
    for name in ("position", "torque"):
        ours, theirs = getattr(opened, name), getattr(read, name)
        assert isinstance(ours, OnDisk)
        np.testing.assert_array_equal(ours[CHUNK - 50 : CHUNK + 50], theirs[CHUNK - 50 : CHUNK + 50])
        np.testing.assert_array_equal(np.asarray(ours), theirs)
        for channel, other in zip(ours.T, theirs.T, strict=True):
            np.testing.assert_array_equal(channel, other)
    assert opened.profile.spans == read.profile.spans
    np.testing.assert_array_equal(opened.busiest(9.0).position, read.busiest(9.0).position)


@QUICK
@given(st.lists(st.integers(1, 400), min_size=2, max_size=12), st.integers(0, 99))
def test_a_folder_of_parquet_files_is_the_one_file(tmp_path: Path, cuts: list[int], seed: int) -> None:
    """Files are in the order of their numbers: part 10 follows part 9. A log in one file is the oracle."""
    data = disturbed(samples(sum(cuts) + 600, seed), "gaps", seed)
    whole, edges = write(tmp_path, ".parquet", data), [0, *np.cumsum(cuts).tolist(), None]
    folder = tmp_path / f"parts-{seed}-{len(cuts)}-{cuts[0]}"
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    for k, (start, stop) in enumerate(pairwise(edges)):
        parquet.write_table(pa.table({n: c[start:stop] for n, c in data.items()}), folder / f"part-{k}.parquet")
    one = read_log(whole, UNWRAPPED)
    for log in (read_log(folder, UNWRAPPED), open_log(folder, UNWRAPPED)):
        assert log.notes == one.notes
        np.testing.assert_array_equal(log.t, one.t)
        np.testing.assert_array_equal(np.asarray(log.position), one.position)
        np.testing.assert_array_equal(log.torque[100:500], one.torque[100:500])
    digest = one.sha256
    assert digest != read_log(folder, UNWRAPPED).sha256 == open_log(folder, UNWRAPPED).sha256


def test_a_folder_whose_files_differ_in_channels_is_refused(tmp_path: Path) -> None:
    data = samples(700, 0)
    for k, names in enumerate((("t", "q1", "q2", "u"), ("t", "q1", "u"))):
        parquet.write_table(pa.table({name: data[name] for name in names}), tmp_path / f"{k}.parquet")
    with pytest.raises(errors.LogFileError, match=r"1.parquet has other channels than 0.parquet.*q2"):
        read_log(tmp_path, UNWRAPPED)


def test_the_observation_is_the_same_to_the_last_digits(tmp_path: Path) -> None:
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    made = motion(model, truth(model), seconds=2.3 * CHUNK * 1e-3, noise=0.05)
    names = [f"q{k}" for k in (1, 2, 3)], [f"tau{k}" for k in (1, 2, 3)]
    columns = dict(zip(names[0] + names[1], [*made.q.T, *made.tau.T], strict=True))
    path = write(tmp_path, ".parquet", {"t": made.t, **columns})
    treatment = haptid.Treatment(cutoff_hz=40.0, decimation=8, torque_delay_s=4e-4, reversal_speed=0.05)
    found = []
    for how in (read_log, open_log):
        log = how(path, Channels(Signal(names[0], "rad"), Signal(names[1], "N m", side="joint"), time="t"))
        observation = haptid.observe(model, haptid.treat(log, treatment))
        found.append((observation, haptid.estimate(observation, haptid.WLS()).beta))
    (read, beta), (opened, other) = found
    assert [b.start for b in opened.blocks] == [b.start for b in read.blocks]
    for a, b in zip(read.motors, opened.motors, strict=True):
        np.testing.assert_array_equal(a.rows, b.rows)
        gram = a.whole.T @ a.whole
        np.testing.assert_allclose(b.whole.T @ b.whole, gram, atol=1e-12 * np.abs(gram).max())
    np.testing.assert_allclose(other, beta, rtol=1e-12, atol=1e-12 * np.abs(beta).max())


def test_what_is_wrong_with_a_log_is_reported_when_it_is_opened(tmp_path: Path) -> None:
    data = samples(500, 1)
    for wrong, error in (
        ({"q2": data["q1"]}, errors.LogDataError),
        ({"q2": np.where(np.arange(500) == 7, np.nan, data["q2"])}, errors.LogDataError),
        ({"u": np.ones(500)}, errors.LogDataError),
    ):
        with pytest.raises(error):
            open_log(write(tmp_path, ".parquet", {**data, **wrong}), UNWRAPPED)
    with pytest.raises(errors.LogDataError):
        open_log(write(tmp_path, ".h5", {**data, "u": data["u"][:-1]}), UNWRAPPED)
    with pytest.raises(errors.LogChannelError) as raised:
        open_log(write(tmp_path, ".parquet", {k: data[k] for k in ("t", "q1", "q2")}), UNWRAPPED)
    assert raised.value.where == "u"
    with pytest.raises(errors.LogFileError):
        open_log(write(tmp_path, ".parquet", {k: v[:0] for k, v in data.items()}), UNWRAPPED)


def test_a_format_without_rows_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, **samples(100, 1))
    with pytest.raises(errors.LogFileError) as raised:
        open_log(path, UNWRAPPED)
    assert raised.value.limit == ("Parquet", "HDF5", "folder of Parquet files")


def test_a_file_that_changed_is_rejected(tmp_path: Path) -> None:
    log = open_log(write(tmp_path, ".h5", samples(500, 1)), UNWRAPPED)
    write(tmp_path, ".h5", samples(5000, 1))
    with pytest.raises(errors.LogFileError) as raised:
        log.position[:10]
    assert raised.value.found != raised.value.limit
