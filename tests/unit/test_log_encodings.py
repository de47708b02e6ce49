"""Text in UTF-16 and in code pages, as Windows tools write it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid import errors
from haptid.log.file_format import format_of
from haptid.log.survey import survey

N = 120
T = np.arange(N) * 0.01
DATA = np.column_stack([T, np.sin(2 * T), np.cos(3 * T)])


def rows(separator: str, decimal: str = ".", end: str = "\n") -> str:
    return end.join(separator.join(f"{v:.6f}".replace(".", decimal) for v in row) for row in DATA) + end


def read(path: Path, wanted: list[str]) -> dict[str, np.ndarray]:
    return format_of(path).columns(path, wanted)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("log.csv", "\ufefft;q1 [°];tau1\n" + rows(";", ",")),
        ("log.txt", "\ufefft\tq1 [°]\ttau1\r\n" + rows("\t", end="\r\n")),
        ("stopped.csv", "\ufefft q1 tau1\n" + rows(" ") + "1.2 0.3"),
        (
            "rows.csv",
            "\ufeff"
            + "".join(f"{n},{','.join(map(str, v))}\n" for n, v in zip(("t", "q1", "tau1"), DATA.T, strict=True)),
        ),
        ("log.jsonl", "\ufeff" + "".join(f'{{"t": {a}, "q1": {b}, "tau1": {c}}}\n' for a, b, c in DATA)),
    ],
)
def test_utf_16_text_is_read_as_other_text(tmp_path: Path, name: str, text: str, encoding: str) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    kind = format_of(path)
    found = read(path, kind.names(path))
    np.testing.assert_allclose(np.column_stack(list(found.values())), DATA, atol=1e-6)
    if "[°]" in text:
        assert kind.units(path) == {"q1 [°]": "°"}


def test_an_error_in_utf_16_text_names_its_line(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(("\ufefft,q1,tau1\n" + rows(",") + "1.2,oops,0\n").encode("utf-16-le"))
    with pytest.raises(errors.LogFileError, match=f"line {N + 2}: q1 is `oops`"):
        read(path, ["q1"])
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(errors.LogFileError, match="odd number"):
        format_of(path).names(path)


def test_damaged_bytes_leave_utf_8_what_it_is(tmp_path: Path) -> None:
    """As in the first line of a log from a serial port."""
    path, names = tmp_path / "log.csv", ["t [s]", "θ [°]", "τ [mN·m]"]
    path.write_bytes(b"# \xfe\x80\xff12\n" + (",".join(names) + "\n" + rows(",")).encode())
    assert format_of(path).names(path) == names
    assert list(format_of(path).units(path).values()) == ["s", "°", "mN·m"]


@pytest.mark.parametrize(
    ("page", "names", "units"),
    [
        ("cp1252", ["Zeit [s]", "Größe 1 [°]", "Stellkraft [µm]"], ["s", "°", "µm"]),
        ("gbk", ["时间 [s]", "关节角 [°]", "力矩 [N·m]"], ["s", "°", "N·m"]),
        ("gbk", ["时间 [s]", "髋关节角θ [°]", "踝关节力矩τ [N·m]"], ["s", "°", "N·m"]),
        ("utf-8", ["Zeit [s]", "Größe 1 [°]", "力矩 [N·m]"], ["s", "°", "N·m"]),
    ],
)
def test_code_pages_of_spreadsheets_are_read(tmp_path: Path, page: str, names: list[str], units: list[str]) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes((";".join(names) + "\n" + rows(";", ",")).encode(page))
    kind = format_of(path)
    assert kind.names(path) == names
    assert list(kind.units(path).values()) == units
    np.testing.assert_allclose(np.column_stack(list(read(path, names).values())), DATA, atol=1e-6)


def test_degrees_of_a_code_page_below_the_header_are_drafted(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(("Zeit;Winkel;Moment\ns;°;Nm\n" + rows(";", ",")).encode("cp1252"))
    assert 'position = { channels = ["Winkel"], unit = "deg" }' in survey(path).table
