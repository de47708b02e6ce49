"""Variables of a controller as text of IEC 61131-3."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from haptid import errors
from haptid.log.file_format import format_of
from haptid.log.formats import assignments
from haptid.log.survey import survey

T = np.arange(0.0, 4.0, 0.004)
Q, TAU = np.sin(3.0 * T) + 0.2 * np.cos(8.0 * T), np.cos(5.0 * T)


def listed(name: str, values: np.ndarray, bounds: str = "") -> str:
    return f"{name} : ARRAY[{bounds or f'1..{values.size}'}] OF REAL := [{', '.join(map(str, values.ravel()))}]; \n"


def read(path: Path) -> dict[str, np.ndarray]:
    kind = format_of(path)
    return kind.columns(path, kind.names(path))


def test_arrays_are_channels_and_settings_are_none(tmp_path: Path) -> None:
    path = tmp_path / "data.txt"
    path.write_text(
        "sample_time : LREAL := 0.004;\n"
        + listed("q_1", Q)
        + listed("tau_1", TAU).replace(", ", ",\n  ", 3)
        + listed("both", np.stack((Q, TAU)), f"1..2, 0..{Q.size - 1}")
        + f"still : ARRAY[1..{Q.size}] OF LREAL := [2(0.5), {Q.size - 2}(0.25)];\n"
    )
    found = read(path)
    assert list(found) == ["q_1", "tau_1", "both[1]", "both[2]", "still"]
    for name, values in (("q_1", Q), ("tau_1", TAU), ("both[1]", Q), ("both[2]", TAU)):
        np.testing.assert_array_equal(found[name], values)
    assert (found["still"][1], found["still"][2]) == (0.5, 0.25)
    assert tomllib.loads(survey(path).table)["channels"]["position"]["channels"] == ["q_1"]


def test_elements_one_by_one_also_of_structs_and_in_hexadecimal_too(tmp_path: Path) -> None:
    path = tmp_path / "dump.csv"
    lines = [f"q[{k}]:={value}F16#{'-' if value < 0 else ''}3F30A3DH-{k % 16:X}" for k, value in enumerate(Q)]
    lines += [f"arm[{k}].torque := REAL#{value};" for k, value in enumerate(TAU, 1) if k != 3]
    path.write_text("(* dump of a controller *)\n" + "\n".join(lines))
    found = read(path)
    np.testing.assert_array_equal(found["q"], Q)
    assert np.isnan(found["arm.torque"][2])
    np.testing.assert_array_equal(np.delete(found["arm.torque"], 2), np.delete(TAU, 2))


def test_texts_are_no_channels_and_repetitions_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "data.txt"
    path.write_text("on : BOOL := TRUE;\n" + listed("q", Q) + "word : ARRAY[1..2] OF STRING := ['a', 'b'];\n")
    assert list(read(path)) == ["q"]
    path.write_text("on : BOOL := TRUE;\nq : ARRAY[1..9] OF REAL := [99999999999999(0.5)];\n")
    with pytest.raises(errors.LogFileError, match="more memory than"):
        read(path)


def test_a_folder_of_dumps_is_one_log(tmp_path: Path) -> None:
    for name, values in (("theta1", Q), ("theta2", 2.0 * Q), ("torque1", TAU), ("torque2", 3.0 * TAU)):
        lines = [f"Output.Data[{k}]:={value}" for k, value in enumerate(values)]
        (tmp_path / f"Output_{name}.txt").write_text("\n".join(lines))
    channels = tomllib.loads(survey(tmp_path).table)["channels"]
    assert channels["position"]["channels"] == ["Output_theta1", "Output_theta2"]
    assert channels["torque"]["channels"] == ["Output_torque1", "Output_torque2"]


def test_numbers_of_thousands_of_digits_are_no_places(tmp_path):
    """Found by fuzzing: an index that no integer of NumPy holds, and numbers that Python refuses to convert."""
    many = "1" * 5000
    text = f"q[{many}] := 1.0;\nq[1] := 2.0;\nq[2] := 3.0;\nb : ARRAY[1..{many}] OF REAL := [{many}(0.0), 2.0];\n"
    (tmp_path / "a.txt").write_text(text)
    assert assignments.names(tmp_path / "a.txt") == ["q"]
    np.testing.assert_array_equal(assignments.columns(tmp_path / "a.txt", ["q"])["q"], [2.0, 3.0])


@pytest.mark.parametrize("long", ["9" * 20_000, "1" + " " * 20_000 + "x", "1(" + " " * 20_000, ".e" * 10_000])
def test_long_words_take_no_time_that_grows_as_a_power(tmp_path, long):
    """Found by fuzzing: a cell of 5000 digits took more than 20 s, a name of 20 000 points 45 s."""
    (tmp_path / "a.txt").write_text(
        f"{'a.' * 20_000}\nq : ARRAY[1..2] OF REAL := [1.0, {long}];\ntau : ARRAY[1..2] OF REAL := [1, 2];\n"
    )
    assert "tau" in assignments.names(tmp_path / "a.txt")
