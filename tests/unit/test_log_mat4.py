"""MAT files of level 4, as "To File" blocks and real-time targets write them; SciPy is the oracle."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from haptid import errors
from haptid.log import Channels, Signal, read_log
from haptid.log.formats import mat
from haptid.log.formats.mat4_header import is_mat4
from haptid.log.survey import survey

T = np.arange(400) * 0.002
DATA = np.vstack([T, np.sin(9 * T), 9 * np.cos(9 * T), np.cos(8 * T)])


@pytest.mark.parametrize("kind", ["f8", "f4", "i4", "i2"])
def test_it_is_read_as_scipy_reads_it(tmp_path: Path, kind: str) -> None:
    data = (DATA * (1 if kind[0] == "f" else 1000)).astype(kind)
    io.savemat(tmp_path / "log.mat", {"rec": data, "note": "made by hand", "gain": np.eye(2)}, format="4")
    wanted = io.loadmat(tmp_path / "log.mat")["rec"]
    from haptid.log.formats import mat

    assert mat.names(tmp_path / "log.mat") == [*(f"rec[{k}]" for k in range(1, 5)), "gain[1]", "gain[2]"]
    found = mat.columns(tmp_path / "log.mat", ["rec[3]", "rec[1]"])
    np.testing.assert_array_equal(found["rec[3]"], wanted[2])
    np.testing.assert_array_equal(found["rec[1]"], wanted[0])


@pytest.mark.parametrize("name", [b"data\0", b"data"])
def test_a_matrix_of_the_other_byte_order_and_a_name_without_its_zero(tmp_path: Path, name: bytes) -> None:
    head = struct.pack(">5i", 1000, 4, T.size, 0, len(name)) + name
    (tmp_path / "log.mat").write_bytes(head + DATA.astype(">f8").tobytes(order="F"))
    channels = Channels(Signal("data[2]", "rad"), Signal("data[4]", "N m"), time="data[1]")
    log = read_log(tmp_path / "log.mat", channels)
    np.testing.assert_allclose(log.position[:, 0], DATA[1], atol=1e-12)
    assert 'time = "data[1]"' in survey(tmp_path / "log.mat").table


def test_what_is_cut_short_or_declares_too_much_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    io.savemat(path, {"rec": DATA}, format="4")
    whole = path.read_bytes()
    for wrong in (whole[:-100], struct.pack("<5i", 0, 2**31 - 1, 2**31 - 1, 0, 4) + whole[20:], whole + b"\1" * 30):
        path.write_bytes(wrong)
        with pytest.raises(errors.LogFileError, match="damaged or cut short"):
            survey(path)


def test_an_empty_matrix_of_millions_of_columns_has_no_channels(tmp_path: Path) -> None:
    """Found by fuzzing: a name was made for each, a gigabyte of them."""
    from haptid.log.formats import mat

    path = tmp_path / "log.mat"
    path.write_bytes(struct.pack("<5i", 0, 0, 2**31 - 1, 0, 2) + b"a\0")
    assert mat.names(path) == []


def test_an_array_without_sizes_is_refused(tmp_path: Path) -> None:
    """Found by fuzzing, level 5: a text with an empty list of sizes ended the process in SciPy's compiled reader."""
    path = tmp_path / "log.mat"
    io.savemat(path, {"note": "made by hand"}, format="5")
    sizes = struct.pack("<II", 5, 8)
    raw = path.read_bytes()
    assert raw.count(sizes) == 1
    path.write_bytes(raw.replace(sizes, struct.pack("<II", 5, 0)))
    with pytest.raises(errors.LogFileError, match="sizes are of type 5 and 0 bytes"):
        survey(path)


@pytest.mark.parametrize("what", ["without characters", "of millions of structs"])
def test_an_array_that_holds_less_than_it_declares_is_refused(tmp_path: Path, what: str) -> None:
    """Found by fuzzing, level 5: SciPy's reader ends the process, or makes half a billion structs."""
    path = tmp_path / "log.mat"
    if what == "without characters":  # flags, sizes and a name
        parts = struct.pack("<IIII", 6, 8, 4, 0) + struct.pack("<IIii", 5, 8, 1, 4) + struct.pack("<II", 1, 0)
    else:  # flags, sizes, a name, the length of a field's name, and a name
        parts = struct.pack("<IIII", 6, 8, 2, 0) + struct.pack("<IIii", 5, 8, 2**29, 1) + struct.pack("<II", 1, 0)
        parts += struct.pack("<HHi", 5, 4, 8) + struct.pack("<II8s", 1, 8, b"field")
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
    path.write_bytes(head + struct.pack("<II", 14, len(parts)) + parts)
    with pytest.raises(errors.LogFileError, match="an array of"):
        survey(path)


def test_other_files_are_none() -> None:
    assert not is_mat4(b"t,q1,tau1\n0,0,0\n" * 3)
    assert not is_mat4(bytes(64))
    assert not is_mat4(np.arange(40.0).tobytes())


def test_cells_are_channels_and_one_of_texts_says_what_to_save(tmp_path: Path) -> None:
    path = tmp_path / "runs.mat"
    runs = np.empty(2, dtype=object)
    runs[:] = [DATA, DATA[:, :50]]
    io.savemat(path, {"runs": runs})
    assert len(mat.names(path)) == 2 * len(DATA)
    runs[:] = ["first", "second"]
    io.savemat(path, {"runs": runs})
    with pytest.raises(errors.LogFileError, match="nothing in it is an array of numbers"):
        survey(path)
