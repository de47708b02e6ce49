"""Whole commands when a file-system call fails, in the middle and towards the end; all calls: fuzz/failing_calls.py."""

from __future__ import annotations

import os
import sys

import pytest
from fuzz import failing_calls
from fuzz.failing_calls import failures, once, prepare


@pytest.mark.skipif(sys.platform == "win32", reason="folders in use cannot be renamed")
def test_outputs_are_whole_or_absent(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path)
    monkeypatch.setattr(failing_calls.identification, "identify", once(failing_calls.identification.identify))
    for command, every in (("identify", 101), ("export", 41), ("report", 16)):
        found = failures(command, tmp_path, every)
        assert found["failed"] > 0
        assert found["findings"] == []
        for path in tmp_path.glob("out*"):
            os.replace(path, tmp_path / f"of-{command}-{path.name}")
