"""Inputs made to exhaust memory or time are refused with a sentence, by limits that a user can raise."""

import gc
import json
import os
import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy import io

import haptid
from haptid._internal.bounded_files import LIMITS, LOG_MEMBERS, LOG_UNPACKED, Limit, amount_text
from haptid._internal.toml_tables import toml_values
from haptid.errors import (
    DeviceFileError,
    HaptidError,
    LogDataError,
    LogFileError,
    LogTimeError,
    ResultFileError,
    SettingError,
)
from haptid.log import read_log
from haptid.log.formats import mat
from haptid.report import read_report
from haptid.report.mathml import formula_markup
from haptid.robot_files import import_robot
from small_study import DEVICE, HEAD, write_study

CHANNELS = ("t", "q1", "q2", "tau1", "tau2")


def zeros(count: int = 1000) -> dict[str, np.ndarray]:
    return {name: np.zeros(count) for name in CHANNELS}


def write_npz(path: Path, columns: dict[str, np.ndarray]) -> None:
    np.savez_compressed(path, **columns)


def write_hdf5(path: Path, columns: dict[str, np.ndarray]) -> None:
    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            file.create_dataset(name, data=column, compression="gzip")


def write_mat(path: Path, columns: dict[str, np.ndarray]) -> None:
    io.savemat(path, columns, do_compression=True)


def write_parquet(path: Path, columns: dict[str, np.ndarray]) -> None:
    parquet.write_table(pa.table(columns), path)


WRITERS = {".npz": write_npz, ".h5": write_hdf5, ".mat": write_mat, ".parquet": write_parquet}


@pytest.mark.parametrize("suffix", WRITERS)
def test_arrays_are_counted_together(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"log{suffix}"
    WRITERS[suffix](path, zeros(2**19))
    one = 8 * 2**19
    monkeypatch.setattr("haptid.log.formats.sniff.RATIO_LIMIT", 1.0)
    monkeypatch.setenv(LOG_UNPACKED.variable, str(6 * one))
    with pytest.raises(LogTimeError):  # it is read, and its stamps do not move
        read_log(path)
    monkeypatch.setenv(LOG_UNPACKED.variable, str(3 * one))
    with pytest.raises(LogFileError, match=r"its arrays unpack to 1[26] MiB.*HAPTID_LIMIT_LOG_UNPACKED"):
        read_log(path)


@pytest.mark.parametrize("suffix", [*WRITERS, ".csv"])
def test_files_with_very_many_channels(tmp_path, monkeypatch, suffix):
    columns = {**zeros(3), **{f"x{k}": np.zeros(3) for k in range(20)}}
    path = tmp_path / f"log{suffix}"
    if suffix == ".csv":
        path.write_text("\n".join([",".join(columns), *[",".join("0" * len(columns))] * 3]))
    else:
        WRITERS[suffix](path, columns)
    monkeypatch.setenv(LOG_MEMBERS.variable, "20")
    with pytest.raises(LogFileError, match=r"more than 20 .* it is no log"):
        read_log(path)


def test_a_sparse_log_is_not_hashed_before_it_is_looked_at(tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    with path.open("wb") as file:
        file.truncate(2**33)
    monkeypatch.setattr("haptid.log.read.sha256_of", lambda _: pytest.fail("hashed"))
    with pytest.raises(LogFileError, match="it holds binary data"):
        read_log(path)
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(LogFileError, match="it has 1 TiB, and at most 64 GiB are read; HAPTID_LIMIT_LOG_FILE"):
        read_log(path)


def special(folder: Path) -> list[Path]:
    """A pipe that nobody writes to, and devices without an end."""
    os.mkfifo(folder / "pipe")
    return [folder / "pipe", Path("/dev/zero")]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_only_regular_files_are_read(tmp_path):
    for path in special(tmp_path):
        for read in (haptid.read_device, haptid.read_study, haptid.Result.load, import_robot):
            with pytest.raises(HaptidError, match="not a regular file"):
                read(path)
        (tmp_path / "log.csv").symlink_to(path)
        with pytest.raises(LogFileError, match="not a regular file"):
            read_log(tmp_path / "log.csv")
        (tmp_path / "log.csv").unlink()
        (tmp_path / "result.json").unlink(missing_ok=True)
        for name in ("result.json", "report-data.json.gz"):
            (tmp_path / name).symlink_to(path)
        with pytest.raises(ResultFileError, match="not a regular file"):
            haptid.Result.load(tmp_path)
        with pytest.raises(ResultFileError, match="not a regular file"):
            read_report(tmp_path)
        (tmp_path / "report-data.json.gz").unlink()


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("a." * 50_000 + "b = 1", "a key of more than 32 parts"),
        ('x = 1\n["a" . ' + "'b'." * 40 + "c]", "line 2, column [12]: not TOML: a key of more than 32 parts"),
        ("a = " + "9" * 5000, "not TOML"),
        ("a = " + "[" * 5000, "not TOML"),
        ("a = 1\n" * 300_000, "at most 1 MiB are read"),
    ],
)
def test_toml_that_would_exhaust_the_parser(tmp_path, text, word):
    path = tmp_path / "device.toml"
    path.write_text(text)
    for read in (haptid.read_device, haptid.read_study):
        with pytest.raises(HaptidError, match=word):
            read(path)


def test_toml_of_any_other_kind_is_read():
    text = 'a.b.c = 1.5\n"x.y" = "a.b.c.d.e.f. ..... ' + "word. " * 60 + '"\nversion = "1.2.3"\n'
    assert toml_values(text)["a"] == {"b": {"c": 1.5}}


def test_formulas_of_a_report_are_mathml_alone():
    assert formula_markup("<math><msub><mi>&#x3c0;</mi><mn>1</mn></msub></math> <math><mo form='infix'>+</mo></math>")
    for text in ("<script>x</script>", "<mi onclick='x'>a</mi>", "<math href='x'/>", "<mi>", "</mrow><b/><mrow>"):
        with pytest.raises(ValueError, match="a formula"):
            formula_markup(text)


def test_damaged_results_and_reports(tmp_path):
    for values in ([], {"schema": 2}, {"schema": "2"}, {"schema": 2, "logs": 3, "device_file": []}):
        (tmp_path / "result.json").write_text(json.dumps(values))
        with pytest.raises(ResultFileError):
            haptid.Result.load(tmp_path)
    (tmp_path / "result.json").write_text('{"schema": ' + "9" * 5000 + "}")
    with pytest.raises(ResultFileError, match="cannot be read"):
        haptid.Result.load(tmp_path)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('t,q1,tau1\n0,1,1\n0.1,"2,2\n' + "0.2,3,3\n" * 40_000, "line 3: a cell cannot be read"),
        ("t,q1,tau1\n0,1,1\n0.1,２,2\n0.2,3,3\n", "line 3: q1 is `２`, not a number"),
        ("t,q1,tau1\n0,1,1\n0.1," + "x" * 600_000 + ",2\n0.2,3,3\n", "line 3: a cell cannot be read"),
        ("t,q1,tau1\n" + 40 * ("0,1," + "1" * 100_000 + "[\n"), "not a number|no numbers|no row"),
    ],
)
def test_rows_of_text_logs(tmp_path, text, word):
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    with pytest.raises(LogFileError, match=word):
        read_log(tmp_path / "log.csv")


def test_stamps_that_are_missing_are_not_said_to_be_cut_by_their_time(tmp_path):
    rows = "\n".join(f"{'nan' if k in (0, 70) else k / 100},{k % 7},{k % 5}" for k in range(200))
    (tmp_path / "log.csv").write_text(f"t,q1,tau1\n{rows}\n")
    with pytest.raises(LogDataError, match="Delete these rows"):
        read_log(tmp_path / "log.csv")


def test_messages_name_what_is_wrong(tmp_path):
    (tmp_path / "device.toml").write_text(DEVICE.replace('name = "2"', 'name = "é"'))
    with pytest.raises(DeviceFileError, match="letters A to Z"):
        haptid.read_device(tmp_path / "device.toml")
    term = '[[terms]]\nkind = "custom"\nname = "c"\njoints = ["1"]\nunit = "N m"\nexpression = "sin"\n'
    (tmp_path / "device.toml").write_text(DEVICE + term)
    with pytest.raises(DeviceFileError, match=r"`sin` is a function, without an argument: write sin\(\.\.\.\)"):
        haptid.read_device(tmp_path / "device.toml")


def test_limits_are_overridden_and_checked(tmp_path, monkeypatch):
    limit = Limit("LOG_FILE", 2**36, "bytes")
    for text, value in (("4096", 4096), ("2K", 2048), ("3MiB", 3 * 2**20), (" 1G ", 2**30)):
        monkeypatch.setenv(limit.variable, text)
        assert limit.value == value
    for text in ("", "0", "-1", "many", "1e9", "９"):
        monkeypatch.setenv(limit.variable, text)
        with pytest.raises(SettingError, match="HAPTID_LIMIT_LOG_FILE"):
            _ = limit.value
    monkeypatch.setenv("HAPTID_LIMIT_DEFINITION_FILE", "100")
    (tmp_path / "study.toml").write_text(HEAD)
    with pytest.raises(HaptidError, match="at most 100 bytes are read"):
        haptid.read_study(tmp_path / "study.toml")
    assert amount_text(1536) == "1.5 KiB"


def test_the_page_on_limits_states_every_default():
    text = (Path(__file__).parents[2] / "docs" / "limits.md").read_text(encoding="utf-8")
    for limit in LIMITS:
        shown = f"{limit.default}" if limit.counted else amount_text(limit.default)
        assert f"| `{limit.variable}` | {shown} | {limit.meaning}" in text


def test_parquet_pages_that_declare_two_gigabytes(tmp_path):
    path = tmp_path / "log.parquet"
    columns = {name: np.linspace(0, k, 100) for k, name in enumerate(CHANNELS, 1)}
    parquet.write_table(pa.table(columns), path, compression="none", use_dictionary=False, column_encoding="PLAIN")
    size, most = b"\x15\xce\x0c", b"\x15\xfe\xff\xff\xff\x0f"  # 807 bytes (100 numbers, levels) and 2^31 - 1
    assert path.read_bytes().count(2 * size) == len(CHANNELS)
    path.write_bytes(path.read_bytes().replace(2 * size, 2 * most))
    before = pa.default_memory_pool().max_memory()
    with pytest.raises(LogFileError, match="cannot be read"):
        read_log(path)
    assert pa.default_memory_pool().max_memory() < before + 2**28


@pytest.mark.parametrize("compressed", [False, True])
def test_mat_elements_of_no_type_do_not_reach_the_compiled_reader(tmp_path, compressed):
    """SciPy's reader takes the type as an index, and the process dies."""
    path = tmp_path / "log.mat"
    io.savemat(path, {name: np.linspace(0, 1, 60) for name in CHANNELS} | {"run": {"q": np.linspace(0, 1, 60)}})
    assert "run.q" in mat.names(path)
    header, element = path.read_bytes()[:128], path.read_bytes()[128:]
    broken = element.replace(struct.pack("<II", 9, 480), struct.pack("<II", 249, 480))
    assert broken != element
    if compressed:
        packed = zlib.compress(broken[: 8 + struct.unpack("<I", broken[4:8])[0]])
        broken = struct.pack("<II", 15, len(packed)) + packed
    path.write_bytes(header + broken)
    with pytest.raises(LogFileError, match="type 249"):
        read_log(path)


def test_logs_are_given_back_after_an_identification(tmp_path):
    """No cache keeps them: a process may identify as many logs as it likes."""
    study = haptid.read_study(write_study(tmp_path))
    haptid.identify(study)
    gc.collect()
    kept = sum(isinstance(one, haptid.Log) for one in gc.get_objects())
    haptid.identify(study)
    gc.collect()
    assert sum(isinstance(one, haptid.Log) for one in gc.get_objects()) <= kept
