"""A piece of work, and the time of the fastest of many short runs: ours and the peers' are taken alike."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# Runs go on for so long, and there are at least so many.
LONG, FEW = 0.5, 3


@dataclass(frozen=True)
class Work:
    """Work over so many samples, all that it needs made beforehand.

    Attributes:
        samples: that it is about; times are told per sample.
        run: does it once.
        shaped: values to compare, from what a run returns: the same of all who do this work. It is not timed.
    """

    samples: int
    run: Callable[[], Any]
    shaped: Callable[[Any], np.ndarray] = np.asarray

    def values(self) -> np.ndarray:
        """What it makes, apart from what later runs write to."""
        return np.array(self.shaped(self.run()))

    def microseconds(self, seconds: float = LONG) -> float:
        """Per sample."""
        return fastest(self.run, seconds) / self.samples * 1e6


def fastest(run: Callable[[], object], seconds: float = LONG, few: int = FEW) -> float:
    """Seconds of the fastest of the runs that fit into so many seconds."""
    taken: list[float] = []
    end = time.perf_counter() + seconds
    while len(taken) < few or time.perf_counter() < end:
        begin = time.perf_counter()
        run()
        taken.append(time.perf_counter() - begin)
    return min(taken)
