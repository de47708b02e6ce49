"""Without the optional packages: text logs are read as with them, and what needs one says which extra brings it."""

import subprocess
import sys

import numpy as np
import pytest
from pyarrow import csv as arrow

import haptid
from haptid.log.formats import csv
from haptid.log.request import Request

OPTIONAL = ("pyarrow", "h5py", "matplotlib", "mujoco", "distributed", "fsspec", "starlette", "uvicorn")
ABSENT = f"import sys\nfor name in {OPTIONAL}:\n    sys.modules[name] = None\n"
TEXTS = {
    "commas": "t,q,tau\n0,1.5,2\n1,-2.5e-3,3\n2,,4\n3,nan,5\n",
    "semicolons and decimal commas": "t;q;tau\n0,5;1,25;2\n1,5;-3,75;3\n",
    "runs of blanks": "  t    q   tau\n 0   1.5   2 \n 1  2.5   3\n",
    "tabs, a blank line": "t\tq\ttau\n0\t1\t2\n\n1\t3\t4\n",
}


def without(program: str) -> subprocess.CompletedProcess[str]:
    """A program in a process of its own that has none of the optional packages."""
    return subprocess.run([sys.executable, "-c", ABSENT + program], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_the_standard_library_reads_what_pyarrow_reads(tmp_path, monkeypatch, text):
    path = tmp_path / "log.csv"
    path.write_text(text)
    fast = csv.columns(path, ["q", "tau", "t"], Request())
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    plain = csv.columns(path, ["q", "tau", "t"], Request())
    assert list(fast) == list(plain)
    for name in fast:
        np.testing.assert_array_equal(plain[name], fast[name])


@pytest.mark.parametrize("row", ["0,1", "0,1,2,3", "0,x,2"])
def test_it_refuses_what_pyarrow_refuses_in_the_same_words(tmp_path, monkeypatch, row):
    path = tmp_path / "log.csv"
    path.write_text(f"t,q,tau\n0,1,2\n{row}\n1,2,3\n")
    with pytest.raises(haptid.errors.LogError) as fast:
        csv.columns(path, ["q"], Request())
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(haptid.errors.LogError) as plain:
        csv.columns(path, ["q"], Request())
    assert str(plain.value) == str(fast.value)


def test_missing_cells_are_those_of_pyarrow():
    assert set(arrow.ConvertOptions().null_values) == csv.MISSING


def test_what_needs_an_optional_package_names_its_extra(tmp_path):
    (tmp_path / "log.parquet").write_bytes(b"PAR1" + bytes(20) + b"PAR1")
    done = without(f"import haptid; haptid.read_log({str(tmp_path / 'log.parquet')!r})")
    assert "MissingDependencyError: reading Parquet needs the package pyarrow" in done.stderr
    assert 'pip install "haptid[parquet]"' in done.stderr
    done = without("import haptid.end_effector.characterisation.plots")
    assert 'pip install "haptid[plots]"' in done.stderr
    done = without(f"sys.argv = ['haptid', 'app', {str(tmp_path)!r}]\nfrom haptid.cli import main\nmain()")
    assert 'pip install "haptid[app]"' in done.stderr.replace("\n", " ")


def test_commands_start_without_them():
    done = without("sys.argv = ['haptid', 'model', 'emps']\nfrom haptid.cli import main\nmain()")
    assert "4 base parameters" in done.stdout, done.stderr
