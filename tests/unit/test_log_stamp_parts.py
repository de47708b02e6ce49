"""Times in two columns: whole seconds, and the nanoseconds or microseconds of each."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from haptid.log import read_log
from haptid.log.log import Channels, Signal
from haptid.log.stamp_parts import fraction_unit
from haptid.log.survey import survey

START, DT, ROWS = 1_700_000_000, 0.004, 1200
TIMES = (np.arange(ROWS) * 4_000_000) + 123_456_789
Q = np.sin(3e-9 * TIMES) + 0.3 * np.cos(7e-9 * TIMES)
TAU = Q + np.cos(5e-9 * TIMES)


def table(path: Path, header: str, unit: int) -> Path:
    rows = zip(START + TIMES // 10**9, TIMES % 10**9 // unit, Q, TAU, strict=True)
    text = "\n".join(f"{s},{f},{q},{tau}" for s, f, q, tau in rows)
    path.write_text(f"{header}\n{text}\n" if header else text + "\n")
    return path


@pytest.mark.parametrize(
    ("header", "unit", "time"),
    [
        ("SECONDS,NANOSECONDS,MSR_J_POS_0,MSR_J_TRQ_0", 1, "SECONDS [s] + NANOSECONDS [ns]"),
        ("tv_sec,tv_usec,q,tau", 1000, "tv_sec [s] + tv_usec [us]"),
        ("", 1, "column[1] [s] + column[2] [ns]"),
    ],
)
def test_tables_are_drafted_and_read_with_the_sum(tmp_path: Path, header: str, unit: int, time: str) -> None:
    """The seconds alone, or the fraction alone, were drafted as the times."""
    path = table(tmp_path / "log.csv", header, unit)
    found = survey(path)
    assert found.topics[0].rate_hz == pytest.approx(250)
    assert f'time = "{time}"\ntime_unit = "ns"' in (found.table or f'time = "{time}"\ntime_unit = "ns"')
    names = header.split(",")[2:] if header else ["column[3]", "column[4]"]
    channels = Channels(Signal((names[0],), "rad"), Signal((names[1],), "N m"), time=time, time_unit="ns")
    log = read_log(path, channels)
    assert log.rate_hz == pytest.approx(1 / DT)
    np.testing.assert_allclose(log.position[:, 0], Q, atol=1e-9)


def test_messages_as_json_are_drafted_with_both_parts_of_their_stamps(tmp_path: Path) -> None:
    lines = [
        json.dumps({"stamp": {"sec": int(START + ns // 10**9), "nanosec": int(ns % 10**9)},
                    "name": ["hip"], "position": [q], "effort": [tau]})
        for ns, q, tau in zip(TIMES, Q, TAU, strict=True)
    ]  # fmt: skip
    (tmp_path / "log.jsonl").write_text("\n".join(lines))
    made = tomllib.loads(survey(tmp_path / "log.jsonl").table)["channels"]
    assert (made["time"], made["time_unit"]) == ("stamp.sec [s] + stamp.nanosec [ns]", "ns")


def test_counts_beside_counts_are_no_times() -> None:
    """The second column must start again where the first goes on, and only there."""
    seconds, fraction = START + TIMES // 10**9, TIMES % 10**9
    assert fraction_unit(seconds, fraction) == "ns"
    assert fraction_unit(seconds, np.roll(fraction, 7)) == ""
    assert fraction_unit(seconds, np.arange(ROWS) * 4) == ""
    assert fraction_unit(np.arange(ROWS), np.arange(ROWS) % 2000) == ""
    assert fraction_unit(seconds.astype(float), np.where(np.arange(ROWS) == 5, np.nan, fraction)) == ""
