"""Readers: the same samples come back from every format, and a bad file is one clear error."""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from itertools import product
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pyarrow import parquet

from haptid import errors
from haptid._internal.bounded_files import LOG_UNPACKED
from haptid.log import Channels, Signal, read_log
from haptid.log.file_format import FORMATS
from haptid.log.formats import sniff

QUICK = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
BY_SUFFIX = {suffix: kind for kind in FORMATS for suffix in kind.suffixes}


def samples(n: int = 200) -> dict[str, np.ndarray]:
    """Time, two positions and two torques of an ordinary motion, each (n,)."""
    t = np.arange(n) * 0.01
    rng = np.random.default_rng(1)
    return {
        "t": t,
        "q1": np.sin(2 * t),
        "q2": np.cos(3 * t),
        "tau1": rng.normal(size=n),
        "tau2": rng.normal(size=n),
    }


def text(data: dict[str, np.ndarray], separator: str = ",", decimal: str = ".") -> str:
    rows = [separator.join(data)]
    rows += [
        separator.join(repr(float(v)).replace(".", decimal) for v in row) for row in zip(*data.values(), strict=True)
    ]
    return "\n".join(rows) + "\n"


def write(path: Path, kind: str, data: dict[str, np.ndarray]) -> tuple[Path, dict[str, str]]:
    """A file of this kind, and the name of each channel in it."""
    same = {name: name for name in data}
    path = path / f"log{kind.split()[0]}"
    matrix = np.column_stack(list(data.values()))
    numbered = (
        {name: f"run.x[{k}]" for k, name in enumerate(data, 1)} if len(data) > 1 else dict.fromkeys(data, "run.x")
    )
    if kind == ".csv":
        path.write_text(text(data))
    elif kind == ".tsv":
        path.write_text(text(data, "\t"))
    elif kind == ".csv comma":
        path.write_text(text(data, ";", ","))
    elif kind == ".parquet":
        parquet.write_table(pa.table(data), path)
    elif kind == ".npz":
        np.savez_compressed(path, **data)
    elif kind == ".h5":
        with h5py.File(path, "w") as file:
            file["run/x"] = matrix
        return path, numbered
    elif kind == ".mat":
        scipy.io.savemat(path, data, do_compression=True)
    elif kind == ".mat struct":
        scipy.io.savemat(path, {"run": {"x": matrix.T}, "note": "text"})
        return path, numbered
    elif kind == ".mat 7.3":
        with h5py.File(path, "w", userblock_size=512) as file:
            file["run/x"] = matrix.T  # MATLAB writes an (n, channels) array as (channels, n)
            file["run/x"].attrs["MATLAB_class"] = np.bytes_("double")
            file["run/label"] = np.frombuffer(b"ab", np.uint8).astype(np.uint16)
            file["run/label"].attrs["MATLAB_class"] = np.bytes_("char")
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
        return path, numbered
    return path, same


KINDS = [".csv", ".tsv", ".csv comma", ".parquet", ".npz", ".h5", ".mat", ".mat struct", ".mat 7.3"]


@pytest.mark.parametrize("kind", KINDS)
@QUICK
@given(
    matrix=hnp.arrays(
        np.float64,
        st.tuples(st.integers(10, 40), st.integers(1, 4)),
        elements=st.floats(-1e6, 1e6, allow_subnormal=False),
    )
)
def test_every_format_gives_back_the_samples(tmp_path: Path, kind: str, matrix: np.ndarray) -> None:
    data = {f"c{k}": column for k, column in enumerate(matrix.T)}
    path, names = write(tmp_path, kind, data)
    reader = BY_SUFFIX[path.suffix]
    assert set(names.values()) <= set(reader.names(path))
    found = reader.columns(path, [*names.values(), "absent"])
    assert set(found) == set(names.values())
    for name, column in data.items():
        np.testing.assert_array_equal(found[names[name]], column)


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_the_same_log(tmp_path: Path, kind: str) -> None:
    data = samples()
    path, names = write(tmp_path, kind, data)
    channels = Channels(
        Signal((names["q1"], names["q2"]), "rad"),
        Signal((names["tau1"], names["tau2"]), "N m"),
        time=names["t"],
    )
    log = read_log(path, channels)
    np.testing.assert_array_equal(log.position, np.column_stack([data["q1"], data["q2"]]))
    np.testing.assert_array_equal(log.torque, np.column_stack([data["tau1"], data["tau2"]]))
    np.testing.assert_allclose(log.t, data["t"], rtol=0, atol=1e-14)
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert log.position.T.flags.c_contiguous
    assert not (log.position.flags.writeable)
    assert not (log.torque.flags.writeable)
    assert not (log.t.flags.writeable)
    told = ("cells are separated by semicolons, with decimal commas",) if kind == ".csv comma" else ()
    assert log.notes == told


NUMBERS = [np.float32, np.int8, np.int64, np.uint16, np.dtype(">f8"), np.dtype(">i4")]


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [(kind, dtype) for kind in (".npz", ".h5", ".mat struct") for dtype in NUMBERS]
    + [(".npz", np.float16), (".h5", np.float16)],
)
def test_numbers_of_any_type_are_taken(tmp_path: Path, kind: str, dtype: np.dtype) -> None:
    data = {"a": np.arange(60).astype(dtype), "b": (2 * np.arange(60)).astype(dtype)}
    path, names = write(tmp_path, kind, data)
    found = BY_SUFFIX[path.suffix].columns(path, list(names.values()))
    np.testing.assert_array_equal(found[names["b"]].astype(float), 2.0 * np.arange(60))


def test_parquet_decimals_nulls_and_narrow_types(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    table = {
        "d": pa.array(np.arange(5), pa.int64()).cast(pa.decimal128(21, 2)),
        "f": pa.array([1, 2, 3, 4, 5], pa.float32()),
        "i": pa.array([1, None, 3, 4, 5], pa.int16()),
        "s": pa.array(list("abcde")),
        "w": pa.array(np.arange(5), pa.timestamp("ns")),
    }
    parquet.write_table(pa.table(table), path)
    reader = BY_SUFFIX[".parquet"]
    assert reader.names(path) == ["d", "f", "i", "w"]
    found = reader.columns(path, ["d", "f", "i", "w"])
    np.testing.assert_array_equal(found["w"], np.arange(5))
    np.testing.assert_array_equal(found["d"], np.arange(5.0))
    np.testing.assert_array_equal(found["i"], [1, np.nan, 3, 4, 5])
    for name in "s":
        with pytest.raises(errors.LogFileError, match=name):
            reader.columns(path, [name])


def test_matrix_channels_run_along_the_shorter_side() -> None:
    assert sniff.addresses("x", (6, 2501)).keys() == sniff.addresses("x", (2501, 6)).keys()
    assert list(sniff.addresses("x", (100, 2))) == ["x[1]", "x[2]"]
    assert list(sniff.addresses("x", (100, 1))) == list(sniff.addresses("x", (1, 100))) == ["x"]
    assert sniff.addresses("x", (1, 1)) == sniff.addresses("x", (3, 4, 5)) == {}


# --- text ---


@pytest.mark.parametrize(
    "head",
    [
        "t,q1,tau1",
        "# recorded on a bench\n\nt, q1 ,tau1",
        "# t,q1,tau1",
        "\ufefft,q1,tau1",
        '"t","q1","tau1"',
        "% any\n# t , q1 , tau1",
    ],
)
def test_headers_as_programs_write_them(tmp_path: Path, head: str) -> None:
    path = tmp_path / "log.csv"
    rows = "\n".join(f"{k / 100}, {np.sin(k)} ,{np.cos(k)}" for k in range(60))
    path.write_text(f"{head}\n{rows}", encoding="utf-8")
    log = read_log(path)
    np.testing.assert_array_equal(log.position[:, 0], np.sin(np.arange(60)))
    assert "channels were not given" in log.notes[0]


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r", "\n\n"])
def test_line_ends_and_blank_lines(tmp_path: Path, newline: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(text(samples()).replace("\n", newline).encode())
    assert read_log(path).t.size == 200


def test_a_column_of_text_that_is_not_mapped_is_no_trouble(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = text(samples()).splitlines()
    path.write_text("\n".join([lines[0] + ",phase", *(line + ",Übung" for line in lines[1:])]), "latin-1")
    assert read_log(path).t.size == 200


def broken(tmp_path: Path, line: int, new: str | None, separator: str = ",") -> Path:
    """A text log whose line (counted from 1) is replaced."""
    lines = text(samples(), separator, "," if separator == ";" else ".").splitlines()
    lines[line - 1 : line] = [] if new is None else [new]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    return path


def test_ragged_row_names_its_line(tmp_path: Path) -> None:
    with pytest.raises(errors.LogFileError) as raised:
        read_log(broken(tmp_path, 17, "1,2,3"))
    assert (raised.value.where, raised.value.found, raised.value.limit) == (17, 3, 5)
    assert raised.value.__cause__ is not None
    with pytest.raises(errors.LogFileError) as raised:
        read_log(broken(tmp_path, 17, "1,2,3,4,5,6"))
    assert raised.value.found == 6


def test_the_last_row_of_a_recording_that_was_stopped_is_dropped(tmp_path: Path) -> None:
    path = broken(tmp_path, 201, "1,2")
    log = read_log(path)
    assert log.t.size == 199
    assert any("2 cells of 5" in note for note in log.notes)
    # One more short row is damage.
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:90], "1,2", *lines[91:]]))
    with pytest.raises(errors.LogFileError) as raised:
        read_log(path)
    assert raised.value.where == 91


def test_text_cell_names_line_and_channel(tmp_path: Path) -> None:
    with pytest.raises(errors.LogFileError) as raised:
        read_log(broken(tmp_path, 9, "1,error,3,4,5"))
    assert raised.value.where == (9, "q1")
    assert raised.value.found == "error"
    with pytest.raises(errors.LogFileError) as raised:
        read_log(broken(tmp_path, 9, "1;1:2;3;4;5", ";"))
    assert raised.value.where == (9, "q1")
    assert raised.value.found == "1:2"


def test_empty_cell_is_a_missing_sample(tmp_path: Path) -> None:
    with pytest.raises(errors.LogDataError) as raised:
        read_log(broken(tmp_path, 9, "0.07,,3,4,5"))
    assert raised.value.where == ("q1", 7)
    assert raised.value.found == 1


def test_columns_without_a_header_are_numbered_and_not_guessed(tmp_path: Path) -> None:
    with pytest.raises(errors.LogChannelError) as raised:
        read_log(broken(tmp_path, 1, None))
    assert raised.value.found == tuple(f"column[{k}]" for k in range(1, 6))


def test_repeated_names(tmp_path: Path) -> None:
    with pytest.raises(errors.LogFileError, match="'q1'"):
        read_log(
            broken(tmp_path, 1, "t,q1,q1,tau1,tau2"),
            Channels(Signal("q1", "rad"), Signal("tau1", "N m"), "t"),
        )


@pytest.mark.parametrize("content", ["t,q1,tau1\n", "t,q1,tau1", "# t,q1\n", "\n\n", ""])
def test_no_rows(tmp_path: Path, content: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(errors.LogFileError):
        read_log(path)


# --- files that are not what they should be ---


def test_paths_that_lead_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(errors.LogFileError):
        read_log(tmp_path / "absent.csv")
    with pytest.raises(errors.LogFileError):
        read_log(tmp_path)
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(errors.LogFileError) as raised:
        read_log(tmp_path / "pipe.csv")
    assert raised.value.where == tmp_path / "pipe.csv"
    path = tmp_path / "log.csv"
    path.write_text(text(samples()))

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(errors.LogFileError) as raised:
        read_log(path)
    assert raised.value.where == path
    assert isinstance(raised.value.__cause__, PermissionError)


def test_unknown_suffix_lists_the_formats(tmp_path: Path) -> None:
    path = tmp_path / "log.xlsx"
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(errors.LogFileError) as raised:
        read_log(path)
    assert raised.value.found == ".xlsx"
    assert raised.value.limit[0] == "CSV (.csv, .tsv, .txt, .dat, .log, .lvm)"


SUFFIXES = (".csv", ".parquet", ".npz", ".h5", ".mat")


@pytest.mark.parametrize(
    ("kind", "suffix"), [p for p in product(SUFFIXES, SUFFIXES) if p[0] != p[1] and p != (".h5", ".mat")]
)
def test_content_counts_and_not_the_suffix(tmp_path: Path, kind: str, suffix: str) -> None:
    path, _ = write(tmp_path, kind, samples())
    with pytest.raises(errors.LogFileError, match="but it holds"):
        read_log(path.rename(tmp_path / f"renamed{suffix}"))


@pytest.mark.parametrize("kind", [".csv", ".parquet", ".npz", ".h5", ".mat", ".mat struct", ".mat 7.3"])
@QUICK
@given(
    share=st.floats(0.0, 0.999),
    flips=st.lists(st.tuples(st.floats(0, 0.999), st.integers(1, 255)), max_size=4),
)
def test_damaged_files_are_haptid_errors_or_fine(
    tmp_path: Path, kind: str, share: float, flips: list[tuple[float, int]]
) -> None:
    path, names = write(tmp_path, kind, samples())
    raw = bytearray(path.read_bytes())
    for place, change in flips:
        raw[int(place * len(raw))] ^= change
    path.write_bytes(raw if flips else raw[: int(share * len(raw))])
    channels = Channels(Signal(names["q1"], "rad"), Signal(names["tau1"], "N m"), time=names["t"])
    try:
        read_log(path, channels)
    except errors.LogError:
        return
    assert flips or kind == ".csv", "a binary file cut short cannot be read"


def test_corrupt_file_is_chained_from_its_library(tmp_path: Path) -> None:
    path, _ = write(tmp_path, ".parquet", samples())
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(errors.LogFileError) as raised:
        read_log(path)
    assert raised.value.limit == "Parquet"
    assert isinstance(raised.value.__cause__, pa.ArrowInvalid)


@pytest.mark.parametrize("kind", [".parquet", ".npz", ".h5", ".mat"])
def test_zip_bombs_are_rejected(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LOG_UNPACKED.variable, str(2**20))
    zeros = np.zeros(2**20)
    path = tmp_path / f"bomb{kind}"
    if kind == ".parquet":
        parquet.write_table(pa.table({"q1": zeros}), path)
    elif kind == ".npz":
        np.savez_compressed(path, q1=zeros)
    elif kind == ".h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("q1", shape=zeros.shape, dtype=float, chunks=True)  # nothing is stored at all
    else:
        scipy.io.savemat(path, {"q1": zeros}, do_compression=True)
    with pytest.raises(errors.LogFileError) as raised:
        read_log(path, Channels(Signal("q1", "rad"), Signal("tau1", "N m"), rate_hz=100))
    assert raised.value.found > raised.value.limit


def test_a_header_with_a_wrong_size_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("q1.npy", head.getvalue() + bytes(80))
    with pytest.raises(errors.LogFileError, match="should have 8000000000000 bytes and has 80"):
        read_log(path, Channels(Signal("q1", "rad"), Signal("tau1", "N m"), rate_hz=100))


def test_pickles_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, q1=np.array([{"a": 1}], dtype=object))
    with pytest.raises(errors.LogFileError) as raised:
        read_log(path)
    assert raised.value.where == "q1"
    with pytest.raises(errors.LogFileError):
        read_log(path, Channels(Signal("q1", "rad"), Signal("tau1", "N m"), rate_hz=100))


def test_samples_of_another_file_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    (tmp_path / "secret.bin").write_bytes(np.arange(100.0).tobytes())
    with h5py.File(path, "w") as file:
        file.create_dataset("q1", shape=(100,), dtype=float, external=[("secret.bin", 0, 800)])
    with pytest.raises(errors.LogFileError):
        read_log(path, Channels(Signal("q1", "rad"), Signal("tau1", "N m"), rate_hz=100))


@pytest.mark.parametrize("kind", [".npz", ".h5", ".mat"])
def test_channels_that_are_no_numbers(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"log{kind}"
    words = np.array(["a", "b"])
    if kind == ".npz":
        np.savez(path, q1=words)
    elif kind == ".h5":
        with h5py.File(path, "w") as file:
            file["q1"] = words.astype(bytes)
    else:
        scipy.io.savemat(path, {"q1": words})
    with pytest.raises(errors.LogFileError, match="'q1'"):
        read_log(path, Channels(Signal("q1", "rad"), Signal("tau1", "N m"), rate_hz=100))


def test_channels_of_different_lengths(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, q1=np.arange(100.0), tau1=np.arange(99.0))
    with pytest.raises(errors.LogDataError) as raised:
        read_log(path, Channels(Signal("q1", "rad"), Signal("tau1", "N m"), rate_hz=100))
    assert raised.value.where == ("q1", "tau1")
    assert raised.value.found == (100, 99)


def test_arrays_without_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, q=np.zeros((0, 2)), tau1=np.zeros(0))
    with pytest.raises(errors.LogFileError):
        read_log(path, Channels(Signal(("q[1]", "q[2]"), "rad"), Signal("tau1", "N m"), rate_hz=100))


# --- which channels ---


def test_missing_channel_names_the_closest(tmp_path: Path) -> None:
    path, _ = write(tmp_path, ".h5", samples())
    with pytest.raises(errors.LogChannelError) as raised:
        read_log(path, Channels(Signal("run.x", "rad"), Signal("run.x[2]", "N m"), rate_hz=100))
    assert raised.value.advice.startswith("Closest: run.x[1..5]. Channels")
    path, _ = write(tmp_path, ".csv", samples())
    with pytest.raises(errors.LogChannelError) as raised:
        read_log(path, Channels(Signal("q1", "rad"), Signal("tua1", "N m"), rate_hz=100))
    assert raised.value.where == "tua1"
    assert raised.value.advice.startswith("Closest: tau1")


@pytest.mark.parametrize(
    "names",
    [
        ("t", "q1", "q2", "tau1", "tau2"),
        ("time", "q_1", "q_2", "tau_1", "tau_2"),
        ("Time_ms", "pos1", "pos2", "torque1", "torque2"),
        ("t_us", "position1", "position2", "u1", "u2"),
        ("run.t", "run.q[1]", "run.q[2]", "run.tau0", "run.tau1"),
    ],
)
def test_channels_are_guessed_from_usual_names(tmp_path: Path, names: tuple[str, ...]) -> None:
    data = dict(zip(names, samples().values(), strict=True)) | {
        "temperature": np.ones(200),
        "qd1": np.ones(200),
    }
    path = tmp_path / "log.csv"
    path.write_text(text(data))
    log = read_log(path)
    assert log.channels.sources == names
    unit = {"Time_ms": "ms", "t_us": "us"}.get(names[0], "s")
    assert log.channels.time_unit == unit
    assert all(name in log.notes[0] for name in names)


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (("x", "q1", "q2", "tau1", "tau2"), "no time channel"),
        (("t", "time", "q2", "tau1", "tau2"), "2 time channels"),
        (("t", "a", "b", "tau1", "tau2"), "no position channels"),
        (("t", "q1", "q2", "a", "b"), "no torque channels"),
        (("t", "q1", "q3", "tau1", "tau2"), "not numbered without a gap"),
        (("t", "q1", "pos1", "tau1", "tau2"), "more than one set of position"),
        (("t", "q1", "q_1", "tau1", "tau2"), "one number"),
    ],
)
def test_channels_that_cannot_be_guessed(tmp_path: Path, names: tuple[str, ...], why: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text(dict(zip(names, samples().values(), strict=True))))
    with pytest.raises(errors.LogChannelError, match=why):
        read_log(path)


def test_a_single_joint_needs_no_number(tmp_path: Path) -> None:
    data = samples()
    path = tmp_path / "log.csv"
    path.write_text(text({"t": data["t"], "q": data["q1"], "tau": data["tau1"]}))
    assert read_log(path).channels.sources == ("t", "q", "tau")


def test_a_mistake_of_haptid_s_own_code_is_no_damaged_file(tmp_path: Path) -> None:
    """It said so of every log that was read through a wrong name, and sent its user to copy a good file again."""
    path = tmp_path / "log.csv"
    with pytest.raises(AttributeError, match="has no attribute 'kind'"), sniff.opened_file(path, "CSV"):
        sniff.numeric(3)
    with pytest.raises(NameError), sniff.opened_file(path, "CSV"):
        unknown_name  # noqa: B018, F821
    for damage in (lambda: json.loads(b"{"), lambda: np.load(io.BytesIO(b"no array")), lambda: json.loads(3)):
        with pytest.raises(errors.LogFileError, match="is damaged or cut short"), sniff.opened_file(path, "CSV"):
            damage()
