"""Identifications in threads and other processes at once are those of one call; longer: fuzz/long_runs.py."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from fuzz.interruptions import study
from fuzz.long_runs import by_all_ways, many


@pytest.mark.skipif(sys.platform != "linux", reason="no fork, no /proc")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_threads_processes_and_many_calls(tmp_path: Path) -> None:
    path = study(tmp_path)
    assert by_all_ways(path) == {"8 threads": 0, "fork": 0, "spawn": 0}
    assert many(path, 4)[1] == 0
