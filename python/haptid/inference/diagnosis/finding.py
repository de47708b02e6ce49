"""One finding: what was looked at, what was found, how much, against which limit, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from haptid._internal.arrays import Array

Status = Literal["ok", "doubt", "bad"]
ORDER: tuple[Status, ...] = ("ok", "doubt", "bad")
# A test speaks up where chance alone would do so once in a hundred clean logs.
LEVEL = 0.01
# What explains more than this share of a motor's residual power is worth a term of its own.
LARGE = 0.1


@dataclass(frozen=True)
class Finding:
    """What one look at an estimate says.

    Attributes:
        name: of the look, such as "time delay".
        status: "ok", "doubt" or "bad".
        figures: what was measured, SI, by name.
        sentence: what was found, how much, what the limit is, and what to do.
    """

    name: str
    status: Status
    figures: Mapping[str, float]
    sentence: str

    def __post_init__(self) -> None:
        figures = {name: float(value) for name, value in self.figures.items()}
        object.__setattr__(self, "figures", MappingProxyType(figures))


def worst(statuses: Sequence[Status]) -> Status:
    """The worst of several; "ok" where there is none."""
    return max(statuses, key=ORDER.index, default="ok")


def graded(p: float, explained: float) -> Status:
    """By the probability of chance, and by how much there is to gain."""
    if p >= LEVEL:
        return "ok"
    return "bad" if explained > LARGE else "doubt"


def holm(p: Sequence[float] | Array) -> Array:
    """Probabilities of several tests taken together, (k,) (Holm 1979, Scandinavian J. Statistics 6)."""
    values = np.asarray(p, dtype=float)
    order = np.argsort(values)
    made = np.empty(len(values))
    made[order] = np.minimum(np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1)), 1.0)
    return made


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names as text, the first few of many."""
    shown = list(names[:most])
    if len(names) > most:
        return f"{', '.join(shown)} and {len(names) - most} more"
    return " and ".join([", ".join(shown[:-1]), shown[-1]]) if len(shown) > 1 else "".join(shown)
