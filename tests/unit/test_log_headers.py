"""Headers of text that have more or fewer cells than the rows, and the end of a process that refused a table."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from haptid.errors import LogFileError
from haptid.log.file_format import format_of
from haptid.log.request import Request

N = 300
DATA = np.column_stack([np.arange(N) * 0.01, np.sin(np.arange(N)), np.cos(np.arange(N))])


@pytest.mark.parametrize(
    ("header", "row", "names", "note"),
    [
        ("t,q,u\n", "{0},{1},{2},\n", ["t", "q", "u", "column 4"], ""),
        ("t,q,u,\n", "{0},{1},{2}\n", ["t", "q", "u"], ""),
        ("t,q,u,\n", "{0},{1},{2},\n", ["t", "q", "u", "column 4"], ""),
        ('"t" "q" "u"\n', '"{k}" {0} {1} {2}\n', ["row", "t", "q", "u"], ""),
        ("t, q, u 20.5, 1.5, -2.5\n", "{0}, {1}, {2}\n", ["t", "q", "u"], ""),
        ("time joint angle torque measured\n", "{0} {1} {2}\n", ["column[1]", "column[2]", "column[3]"], "has 5 cells"),
        ("#time q wq\n", "{0}, {1}, {2}\n", ["time", "q", "wq"], ""),
        ("t[s] q u\n", "{0},{1},{2}\n", ["t[s]", "q", "u"], ""),
        ("# measured on Monday\n", "{0},{1},{2}\n", ["column[1]", "column[2]", "column[3]"], "no header"),
        (",pos,torque\nt,j1,j1\n", "{0},{1},{2}\n", ["t", "pos j1", "torque j1"], "two lines"),
        ("group,arm,\nt,q,q\n", "{0},{1},{2}\n", ["t", "q (1)", "q (2)"], "2 columns are named q"),
        ("time,torque\n", "{0},{1},{2}\n", ["column[1]", "column[2]", "column[3]"], "has 2 cells where they have 3"),
    ],
)
def test_headers_of_another_number_of_cells(tmp_path: Path, header: str, row: str, names: list[str], note: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(header + "".join(row.format(*values, k=k) for k, values in enumerate(DATA, 1)))
    kind, request = format_of(path), Request()
    assert kind.names(path) == names
    found = kind.columns(path, names, request)
    samples = [column for name, column in found.items() if name not in ("row", "column 4")]
    np.testing.assert_array_equal(np.column_stack(samples), DATA)
    assert any(note in one for one in request.notes) or not note


def test_a_process_that_refused_a_table_ends(tmp_path: Path) -> None:
    """A reader that reads ahead in Python's file objects stops the interpreter at its end."""
    path = tmp_path / "log.csv"
    path.write_text("t q u\n0 1 2\n0 1\n" + "0.123456  1.234567  2.345678\n" * 300_000)
    code = (
        "import sys\nfrom pathlib import Path\nfrom haptid.errors import LogFileError\n"
        "from haptid.log.file_format import format_of\nfrom haptid.log.request import Request\n"
        "path = Path(sys.argv[1])\n"
        "try: format_of(path).columns(path, ['t', 'q'], Request())\nexcept LogFileError as error: print(error)"
    )
    for _ in range(3):
        ended = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, timeout=120)
        assert "line 3: 2 cells where the header has 3" in ended.stdout
        assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("separator", [",", " "])
def test_a_header_that_comes_again_is_left_out(tmp_path: Path, separator: str) -> None:
    """A logger that is started twice appends its header too: the file had no column of numbers."""
    rows = [separator.join(map(str, values)) + "\n" for values in DATA]
    header = f"# run\nt{separator}q{separator}u\n"
    path = tmp_path / "log.txt"
    path.write_text(header + "".join(rows[:100]) + header + "".join(rows))
    kind, request = format_of(path), Request()
    found = kind.columns(path, ["t", "q", "u"], request)
    np.testing.assert_array_equal(np.column_stack([*found.values()]), np.vstack([DATA[:100], DATA]))
    assert any("come again" in note for note in request.notes)
    path.write_text(header + "".join(rows[:100]) + header + "".join(rows) + f"1{separator}x{separator}2\n")
    with pytest.raises(LogFileError, match="q is `x`, not a number"):
        kind.columns(path, ["t", "q", "u"], Request())


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("name", ["run.lvm", "run.txt"])
def test_measurements_of_labview(tmp_path: Path, name: str, decimal: str) -> None:
    path, end = tmp_path / name, "***End_of_Header***"
    t = 0.004 * np.arange(300)
    data = np.column_stack((t, np.sin(3 * t), np.cos(2 * t)))
    about = [
        "LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", f"Decimal_Separator\t{decimal}",
        "Multi_Headings\tNo", "X_Columns\tOne", "Date\t2019/03/04", "Time\t10:11:12.1", f"{end}\t", "\t",
        "Channels\t2\t\t", "Samples\t300\t300\t", "Date\t2019/03/04\t2019/03/04\t", "Y_Unit_Label\tmA\tdeg\t",
        "X_Dimension\tTime\tTime\t", "X0\t0\t0\t", f"Delta_X\t{0.004}\t{0.004}\t", f"{end}\t\t\t",
        "X_Value\tCurrent\tEncoder\tComment",
    ]  # fmt: skip
    text = "\n".join([*about, *("\t".join(f"{x:.6f}" for x in row) for row in data)]) + "\n"
    path.write_text(text.replace(".", decimal) if decimal == "," else text)
    kind = format_of(path)
    names = ["X_Value", "Current", "Encoder"]
    assert kind.names(path) == names
    assert kind.units(path) == {"X_Value": "s", "Current": "mA", "Encoder": "deg"}
    np.testing.assert_allclose(np.column_stack(list(kind.columns(path, names).values())), data, atol=1e-6)


@pytest.mark.parametrize(("mark", "columns"), [(",", "One"), ("\t", "Multi"), (",", "Multi")])
def test_units_of_labview_by_its_separator_and_with_times_of_each_channel(
    tmp_path: Path, mark: str, columns: str
) -> None:
    path, end, several = tmp_path / "run.lvm", "***End_of_Header***", columns == "Multi"
    about = [
        ["LabVIEW Measurement"], ["Separator", "Comma" if mark == "," else "Tab"], ["X_Columns", columns], [end],
        ["Channels", "2"], ["Y_Unit_Label", "mA", "deg"], ["X_Dimension", "Time", "Time"], [end],
        ["X_Value", "Current", *["X_Value"] * several, "Encoder", "Comment"],
    ]  # fmt: skip
    t = 0.004 * np.arange(200)
    rows = np.column_stack((t, np.sin(3 * t), *[t] * several, np.cos(2 * t)))
    path.write_text("\n".join(mark.join(map(str, line)) for line in (*about, *rows.round(6))) + "\n")
    times = {"X_Value (1)": "s", "X_Value (2)": "s"} if several else {"X_Value": "s"}
    assert format_of(path).units(path) == times | {"Current": "mA", "Encoder": "deg"}
