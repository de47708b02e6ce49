"""Matrices in brackets, as Python, NumPy, MATLAB and Mathematica print them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid.errors import LogFileError
from haptid.log import Channels, Signal, read_log
from haptid.log.formats.brackets import is_bracketed

T = np.arange(0.0, 4.0, 0.004)
TABLE = np.stack([T, np.sin(2 * T), np.cos(3 * T + 1), 0.3 * np.sin(5 * T), -2.0 * np.cos(T)], axis=1)


def cells(between: str) -> list[str]:
    return [between.join(f"{x:.9g}" for x in row) for row in TABLE]


def wrapped(row: str) -> str:
    """A row that is printed on two lines."""
    numbers = row.split()
    return " ".join(numbers[:3]) + "\n  " + " ".join(numbers[3:])


WRITTEN = {
    "lists": "[[" + "],\n [".join(cells(", ")) + "]]\n",
    "lists in one line": "[[" + "], [".join(cells(", ")) + "]]",
    "a list a line": "".join(f"[{row}]\n" for row in cells(", ")),
    "a tuple a line": "".join(f"({row})\n" for row in cells(",")),
    "numpy": "[[" + "]\n [".join(cells(" ")) + "]]\n",
    "numpy in two lines": "[[" + "]\n [".join(map(wrapped, cells("  "))) + "]]\n",
    "numpy with a type": "data = np.array([[" + "],\n       [".join(cells(", ")) + "]], dtype=float32)\n",
    "matlab": "A = [" + ";\n".join(cells(", ")) + "];\n",
    "matlab in one line": "A = [" + "; ".join(cells(", ")) + "];",
    "matlab over lines": "A = [" + ";\n".join(row.replace(", ", ", ...\n", 1) for row in cells(", ")) + "];\n",
    "matlab with comments": "% run [3]\nA = [" + ";\n".join(cells(", ")) + "]; % of (the) arm\n",
    "python with comments": "# run (3)\nq = [[" + "],  # a row\n [".join(cells(", ")) + "]]  # end\n",
    "mathematica": "{{" + "}, {".join(cells(", ")) + "}}\n",
}


@pytest.mark.parametrize("how", WRITTEN)
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_all_rows_and_columns_of_a_matrix_are_read(tmp_path: Path, how: str, mark: str) -> None:
    """The first and the last column, which hold the brackets, were left out without a word."""
    path = tmp_path / "log.txt"
    path.write_text(mark + WRITTEN[how], encoding="utf-8")
    channels = Channels(
        Signal(("column[2]", "column[3]"), "rad"), Signal(("column[4]", "column[5]"), "N m"), "column[1]"
    )
    log = read_log(path, channels)
    assert len(log.position) == len(T)
    np.testing.assert_allclose(log.position, TABLE[:, 1:3], atol=1e-7)
    np.testing.assert_allclose(log.torque, TABLE[:, 3:], atol=1e-7)


@pytest.mark.parametrize(
    "text",
    ["t,q\n0,1\n", "[s], [rad]\n0, 1\n", "A = [ 0 1;\n 2 3 ];\n", '"[0.1, 0.2]",3\n', "q: [0.1, 0.2]\n", "(a, b)\n"],
)
def test_other_texts_are_no_matrices_in_brackets(text: str) -> None:
    assert not is_bracketed(text.encode())


def test_rows_that_a_print_leaves_out_are_not_silent(tmp_path: Path) -> None:
    path, rows = tmp_path / "log.txt", cells(" ")
    path.write_text("[[" + "]\n [".join(rows[:200]) + "]\n ...\n [" + "]\n [".join(rows[-200:]) + "]]\n")
    with pytest.raises(LogFileError):
        read_log(path, Channels(Signal("column[2]", "rad"), Signal("column[4]", "N m"), "column[1]"))
