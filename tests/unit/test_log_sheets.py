"""Tables as sheets and loggers export them: merged cells, dates of several countries, a quantity for each joint."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import haptid
import small_study
from haptid import errors
from haptid.log.file_format import format_of
from haptid.log.formats.dates import nanoseconds
from haptid.log.request import Request
from haptid.log.survey import survey
from haptid.study.draft import draft_study

T = 0.002 * np.arange(2000)
Q = np.column_stack([np.sin(w * T) for w in (1.1, 2.3, 3.7)])
TAU = np.column_stack([np.cos(w * T) for w in (1.7, 2.1, 3.1)])
START = datetime(2026, 2, 28, 23, 59, 58)
HEAD = "time,q1,q2,q3,tau1,tau2,tau3"


def written(folder: Path, head: str, times: list[str] | None = None, separator: str = ",") -> Path:
    """A table with these lines above it."""
    cells = [[f"{value:.6f}" for value in row] for row in np.column_stack((Q, TAU))]
    stamps = times or [f"{t:.3f}" for t in T]
    lines = [separator.join((stamp, *row)) for stamp, row in zip(stamps, cells, strict=True)]
    (folder / "run.csv").write_text("\n".join((head, *lines)) + "\n")
    return folder / "run.csv"


def test_names_over_several_columns_are_of_all_of_them(tmp_path: Path) -> None:
    """Cells that a sheet merged have their name in the first column: the first joint was left out of the draft."""
    path = written(tmp_path, "Time,Position,,,Torque,,\ns,deg,deg,deg,Nmm,Nmm,Nmm")
    channels = tomllib.loads(survey(path).table)["channels"]
    assert channels["position"] == {"channels": [f"Position ({k})" for k in (1, 2, 3)], "unit": "deg"}
    assert channels["torque"] == {"channels": [f"Torque ({k})" for k in (1, 2, 3)], "unit": "mN m"}


def test_a_column_without_a_name_belongs_to_no_other(tmp_path: Path) -> None:
    path = written(tmp_path, "t,q1,q2,q3,tau1,,tau3")
    assert format_of(path).names(path) == ["t", "q1", "q2", "q3", "tau1", "column 6", "tau3"]


@pytest.mark.parametrize(
    ("form", "separator"),
    [
        (lambda now: now.strftime("%d.%m.%Y %H:%M:%S,%f"), ";"),
        (lambda now: now.strftime("%d/%m/%Y %H:%M:%S.%f"), ","),
        (lambda now: now.strftime("%m/%d/%Y %I:%M:%S.%f %p"), ","),
        (lambda now: now.strftime("%m/%d/%Y %H:%M:%S.%f"), ","),
        (lambda now: now.strftime("%Y-%m-%d %H:%M:%S.%f"), ","),
        (lambda now: now.isoformat(timespec="microseconds") + "Z", ","),
        (lambda now: now.strftime("%H:%M:%S.%f"), ","),
        (lambda now: f"{(now - START).seconds // 60}:{(now - START).seconds % 60:02d}.{now.microsecond:06d}", ","),
    ],
)
def test_times_as_loggers_write_them(tmp_path: Path, form: Callable[[datetime], str], separator: str) -> None:
    """Across midnight at the end of February."""
    times = [form(START + timedelta(microseconds=2000 * k)) for k in range(T.size)]
    head = separator.join(("time", "q1", "q2", "q3", "tau1", "tau2", "tau3"))
    path = written(tmp_path, head, times, separator)
    read = format_of(path).columns(path, ["time", "q3"], Request())
    np.testing.assert_allclose(read["time"], T, atol=1e-9)
    np.testing.assert_allclose(read["q3"], Q[:, 2], atol=1e-6)
    assert survey(path).topics[0].rate_hz == pytest.approx(500.0)


def test_days_with_slashes_are_told_by_what_fits() -> None:
    day = 86400 * 10**9
    assert nanoseconds("02/01/2026 00:00:00") - nanoseconds("01/01/2026 00:00:00") == day
    assert nanoseconds("2/1/2026 12:00:00 AM") - nanoseconds("1/1/2026 12:00:00 AM") == 31 * day
    assert nanoseconds("1/13/2026 00:00:00") == nanoseconds("13/1/2026 00:00:00")
    assert nanoseconds("1/1/2026 12:30:00 PM") - nanoseconds("1/1/2026 12:30:00 AM") == day // 2
    with pytest.raises(ValueError, match="no date"):
        nanoseconds("12:30")


@pytest.mark.parametrize("form", ["%m/%d/%Y %H:%M:%S.%f", "%d/%m/%Y %H:%M:%S.%f"])
@pytest.mark.parametrize("start", [datetime(2026, 3, 12, 23, 59, 58), datetime(2026, 2, 28, 23, 59, 58)])
def test_the_order_of_day_and_month_is_that_of_the_column(tmp_path: Path, form: str, start: datetime) -> None:
    """3/12 was the 3rd of December before 3/13, and 3/1 the 3rd of January behind 2/28."""
    path = written(tmp_path, HEAD, [(start + timedelta(microseconds=2000 * k)).strftime(form) for k in range(T.size)])
    read = format_of(path).columns(path, ["time"], Request())
    np.testing.assert_allclose(read["time"], T, atol=1e-9)


def test_dates_of_which_either_number_may_be_the_day(tmp_path: Path) -> None:
    """Within a day it does not matter; over midnight a month would be lost or found."""

    def times(start: datetime) -> list[str]:
        return [(start + timedelta(microseconds=2000 * k)).strftime("%m/%d/%Y %H:%M:%S.%f") for k in range(T.size)]

    path = written(tmp_path, HEAD, times(datetime(2026, 3, 4, 12)))
    np.testing.assert_allclose(format_of(path).columns(path, ["time"], Request())["time"], T, atol=1e-9)
    path = written(tmp_path, HEAD, times(datetime(2026, 3, 4, 23, 59, 58)))
    with pytest.raises(errors.LogFileError, match="of the 2 dates in time, as 3/4/2026 and 3/5/2026, the day or the"):
        format_of(path).columns(path, ["time"], Request())
    path = written(tmp_path, HEAD, [*times(datetime(2026, 3, 14))[:-1], "14/03/2026 00:00:04"])
    with pytest.raises(errors.LogFileError, match="some have the day first and others the month"):
        format_of(path).columns(path, ["time"], Request())


def test_torques_of_each_joint_in_a_quantity_of_its_own(tmp_path: Path) -> None:
    """A motor without a sensor logs its current: the draft had the torques of two joints of three."""
    path = written(tmp_path, "t,q1,q2,q3,torque1 [Nmm],current2 [mA],F3 (N)")
    channels = tomllib.loads(survey(path, [("1",), ("2",), ("3",)]).table)["channels"]
    assert channels["torque"] == {
        "channels": ["torque1 [Nmm]", "current2 [mA]", "F3 (N)"], "unit": ["mN m", "mA", "N"]
    }  # fmt: skip


def test_a_current_beside_each_torque_is_of_the_same_joint(tmp_path: Path) -> None:
    path = written(tmp_path, "t,q1,q2,torque1 [Nm],torque2 [Nm],current1 [A],current2 [A]")
    channels = tomllib.loads(survey(path).table)["channels"]
    assert channels["torque"]["channels"] == ["torque1 [Nm]", "torque2 [Nm]"]


def test_positions_of_motors_that_turn_far_are_before_their_gears(tmp_path: Path) -> None:
    """Taken as the joints', they gave inertias a ten thousandth of the true ones, without a word."""
    (tmp_path / "device.toml").write_text(small_study.DEVICE)
    columns = np.column_stack((T, 100 * np.rad2deg(Q[:, :2]), TAU[:, :2] / 100))
    head = "t,motor_pos1,motor_pos2,motor_torque1,motor_torque2"
    np.savetxt(tmp_path / "run.csv", columns, delimiter=",", header=head, comments="")
    device = haptid.read_device(tmp_path / "device.toml")
    text, found = draft_study([tmp_path / "run.csv"], device, str(tmp_path / "device.toml"), tmp_path)
    channels = tomllib.loads(text)["channels"]
    assert channels["position"]["side"] == channels["torque"]["side"] == "motor"
    assert any("no gear ratio above 1: write `gear_ratio`" in note for note in found.notes)
    geared = '[[motors]]\nname = "1"\ngear_ratio = 100\n[[motors]]\nname = "2"\ngear_ratio = 100\n'
    (tmp_path / "device.toml").write_text(small_study.DEVICE + geared)
    device = haptid.read_device(tmp_path / "device.toml")
    _, found = draft_study([tmp_path / "run.csv"], device, str(tmp_path / "device.toml"), tmp_path)
    assert not any("gear ratio" in note for note in found.notes)
    np.savetxt(tmp_path / "run.csv", columns / (1, 100, 100, 1, 1), delimiter=",", header=head, comments="")
    assert "side" not in tomllib.loads(survey(tmp_path / "run.csv").table)["channels"]["position"]
