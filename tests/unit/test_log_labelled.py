"""Text with labels at its numbers, tables with lists in their cells, and tables with a row for each joint."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from haptid import errors
from haptid.log.file_format import format_of
from haptid.log.formats.labelled import is_labelled
from haptid.log.formats.rearranged import is_rearranged
from haptid.log.request import Request
from haptid.log.survey import survey

ROWS, DT = 900, 0.004
T = DT * np.arange(ROWS)
Q = np.stack([np.sin(3 * T) + 0.2 * np.cos(8 * T), np.cos(2 * T) + 0.2 * np.sin(9 * T)], axis=1)
TAU = Q + np.cos(5 * T)[:, None]
Row = Callable[[float, np.ndarray, np.ndarray], str]


def echo(t: float, q: np.ndarray, tau: np.ndarray) -> str:
    lists = "".join(f"{name}:\n" + "".join(f"- {x}\n" for x in values)
                    for name, values in (("position", q), ("velocity", 0 * q), ("effort", tau)))  # fmt: skip
    stamp = f"  stamp:\n    sec: {1_700_000_000 + int(t)}\n    nanosec: {round(t % 1 * 1e9)}\n"
    return f"header:\n{stamp}  frame_id: base\nname:\n- hip\n- knee\n{lists}---"


def read(path: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    kind, request = format_of(path), Request()
    return kind.columns(path, kind.names(path), request), request.notes


@pytest.mark.parametrize(
    ("name", "row", "position", "torque"),
    [
        ("a.txt", lambda t, q, tau: f"t:{t} q1:{q[0]} q2:{q[1]} tau1:{tau[0]}  tau2:{tau[1]}", ["q1", "q2"],
         ["tau1", "tau2"]),
        ("b.log", lambda t, q, tau: f"t = {t}; q1 = {q[0]}; q2 = {q[1]}; tau1 = {tau[0]}; tau2 = {tau[1]}",
         ["q1", "q2"], ["tau1", "tau2"]),
        ("c.dat", lambda t, q, tau: f"Time {t}\nPosition {q[0]} {q[1]}\nTorque {tau[0]} {tau[1]}",
         ["Position[1]", "Position[2]"], ["Torque[1]", "Torque[2]"]),
        ("d.txt", lambda t, q, tau: f"{{'t': {t}, 'q': array([{q[0]}, {q[1]}]), 'tau': array([{tau[0]}, {tau[1]}])}}",
         ["q[1]", "q[2]"], ["tau[1]", "tau[2]"]),
        ("e.yaml", echo, ["position[1]", "position[2]"], ["effort[1]", "effort[2]"]),
    ],
)  # fmt: skip
def test_prints_of_programs_are_tables(
    tmp_path: Path, name: str, row: Row, position: list[str], torque: list[str]
) -> None:
    path = tmp_path / name
    path.write_text("\n".join(map(row, T, Q, TAU)) + "\n")
    found, _ = read(path)
    np.testing.assert_array_equal(np.stack([found[p] for p in position], axis=1), Q)
    np.testing.assert_array_equal(np.stack([found[p] for p in torque], axis=1), TAU)
    assert survey(path).topics[0].rate_hz == pytest.approx(1 / DT)
    drafted = tomllib.loads(survey(path).table)["channels"]
    assert {"time", "position", "torque"} <= drafted.keys()


@pytest.mark.parametrize(
    "row",
    [
        lambda t, q, tau: f'{t},"[{q[0]}, {q[1]}]","[{tau[0]}, {tau[1]}]"',
        lambda t, q, tau: f"{t},[{q[0]}  {q[1]}],[{tau[0]} {tau[1]}]",
        lambda t, q, tau: f"{t},[{q[0]}, {q[1]}],[[{tau[0]}, {tau[1]}]]",
        lambda t, q, tau: f'{t},"array([{q[0]}, {q[1]}])","np.array([{tau[0]},\n {tau[1]}])"'.replace("\n", ""),
    ],
)
def test_lists_in_cells_are_channels(tmp_path: Path, row: Row) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,positions,efforts\n" + "\n".join(map(row, T, Q, TAU)) + "\n")
    found, _ = read(path)
    assert list(found) == ["time", "positions[1]", "positions[2]", "efforts[1]", "efforts[2]"]
    np.testing.assert_array_equal(np.stack([found["efforts[1]"], found["efforts[2]"]], axis=1), TAU)
    assert tomllib.loads(survey(path).table)["channels"]["position"]["joints"] == [1, 2]


@pytest.mark.parametrize(("joints", "late"), [(("hip", "knee"), 0.0), (("11", "12"), 0.001)])
def test_rows_of_joints_in_turn_are_one_row(tmp_path: Path, joints: tuple[str, str], late: float) -> None:
    """All rows were drafted as those of one joint."""
    path = tmp_path / "log.csv"
    rows = [f"{T[k] + j * late},{joint},{Q[k, j]},{TAU[k, j]}" for k in range(ROWS) for j, joint in enumerate(joints)]
    path.write_text("time,motor_id,pos,torque\n" + "\n".join(rows) + "\n")
    found, notes = read(path)
    np.testing.assert_array_equal(found["time"], T)
    np.testing.assert_array_equal(found[f"pos[{joints[1]}]"], Q[:, 1])
    assert f"2 joints in turn ({joints[0]}, {joints[1]})" in notes[0]
    assert [note for note in notes if "0.001 later" in note] == notes[1:]
    assert len(notes) == 1 + (late > 0)
    drafted = tomllib.loads(survey(path).table)["channels"]
    assert len(drafted["position"]["joints"]) == len(drafted["torque"]["joints"]) == 2
    path.write_text("time,motor_id,pos,torque\n" + "\n".join(np.delete(rows, 7)) + "\n")  # a joint that did not answer
    found, _ = read(path)
    assert np.isnan(found[f"pos[{joints[1]}]"][3])
    np.testing.assert_array_equal(found[f"pos[{joints[0]}]"], Q[:, 0])


def test_other_texts_stay_what_they_were() -> None:
    csv = "\n".join(f"{t},{q[0]},{q[1]}" for t, q in zip(T, Q, strict=True)).encode()
    blanks = csv.replace(b",", b" ")
    for head in (csv, b"t,q1,q2\n" + csv, blanks, b"t q1 q2\n" + blanks, b"time[1],q[1],q[2]\n" + csv,
                 b"id,q1,q2\n" + csv, b"mode 1\nrate: 250\n" + csv, b"arm " + blanks.replace(b"\n", b"\narm "),
                 b"", b"a: 1\nb: 2\nc: 3\n"):  # fmt: skip
        assert not is_labelled(head)
        assert not is_rearranged(head)


def test_records_that_are_cut_or_uneven(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    lines = [f"Position {q[0]} {q[1]}\nTorque {tau[0]} {tau[1]}" for q, tau in zip(Q, TAU, strict=True)]
    path.write_text("\n".join(lines) + "\nPosition 0.1 0.2\n")
    found, notes = read(path)
    assert found["Torque[1]"].size == ROWS
    assert notes == ["the last record has 1 labels of 2, as where it was cut: dropped"]
    lines[30] = lines[30].replace("Torque", "Torque 0.0")
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(errors.LogFileError, match="record 31: Torque has 3 numbers, before it had 2"):
        read(path)
    table = [f'{t},"[{q[0]}, {q[1]}]"' for t, q in zip(T, Q, strict=True)]
    table[40] = table[40].replace("]", ", 0.0]")
    (tmp_path / "log.csv").write_text("t,q\n" + "\n".join(table) + "\n")
    with pytest.raises(errors.LogFileError, match="row 41: q has 3 numbers, before it had 2"):
        read(tmp_path / "log.csv")


def test_a_struct_or_a_cell_for_each_sample(tmp_path: Path) -> None:
    """`log(k).q = q` in a loop was refused as no array of numbers."""
    kinds = [("t", "O"), ("q", "O"), ("tau", "O"), ("mode", "O")]
    samples = np.array([(T[k], Q[k], TAU[k], "run") for k in range(ROWS)], dtype=kinds)
    cells = np.empty(ROWS, dtype=object)
    cells[:] = list(Q)
    io.savemat(tmp_path / "log.mat", {"log": samples, "cells": cells})
    found, _ = read(tmp_path / "log.mat")
    assert sorted(found) == ["cells[1]", "cells[2]", "log.q[1]", "log.q[2]", "log.t", "log.tau[1]", "log.tau[2]"]
    np.testing.assert_array_equal(found["log.t"], T)
    np.testing.assert_array_equal(found["log.tau[2]"], TAU[:, 1])


@pytest.mark.parametrize("long", ["a" * 50_000, "a " + " " * 50_000 + "x", "a:" + "1" * 50_000 + "x", "a: 1 " * 20_000,
                                  "[" * 50_000, "[1," + " " * 50_000 + "x"])  # fmt: skip
def test_long_lines_take_no_time_that_grows_as_a_power(tmp_path: Path, long: str) -> None:
    """Twice the length may take twice the time; were it four times or more, one of these took minutes."""
    path = tmp_path / "log.txt"
    path.write_text("".join(f"t:{t} q:{q[0]}\n" for t, q in zip(T, Q, strict=True)) + long + "\n")
    with suppress(errors.LogError):
        read(path)
    is_rearranged(f"t,q\n{long}\n".encode() * 9)
