"""Logs as one JSON line with the names of the channels and then float64, little-endian, row by row."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np


def names(path: Path) -> list[str]:
    """Every channel of the file."""
    with path.open("rb") as file:
        return json.loads(file.readline())["channels"]


def columns(path: Path, wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """Those wanted channels that the file has, each (rows,)."""
    known = names(path)
    with path.open("rb") as file:
        file.readline()
        table = np.frombuffer(file.read(), dtype="<f8").reshape(-1, len(known))
    return {name: table[:, known.index(name)].copy() for name in wanted if name in known}


def units(path: Path) -> dict[str, str]:
    """Units by channel, where the file states them; this function may be left out."""
    with path.open("rb") as file:
        return json.loads(file.readline()).get("units", {})
