"""A piece of work, and the time of the fastest of many short runs: ours and the peers' are taken alike."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

# Runs go on for so long, and there are at least so many.
LONG, FEW = 0.5, 3
# Shorter work is repeated until it takes so long: the processor's clock is not fine enough for microseconds.
SHORT = 1e-3
# Of a process with one thread the processor's time, which others on the machine disturb less.
CLOCK = time.process_time if os.environ.get("RAYON_NUM_THREADS") == "1" else time.perf_counter


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

    def microseconds(self, clock: Callable[[], float] = CLOCK) -> float:
        """Per sample, of the fastest run."""
        return fastest(self.run, clock=clock) / self.samples * 1e6


def fastest(
    run: Callable[[], object], seconds: float = LONG, few: int = FEW, clock: Callable[[], float] = CLOCK
) -> float:
    """Seconds of the fastest of the runs that fit into so many seconds; of short work, of a few in a row."""
    taken: list[float] = []
    begin = time.perf_counter()
    run()
    row = max(1, round(SHORT / (time.perf_counter() - begin)))
    end = time.perf_counter() + seconds
    while len(taken) < few or time.perf_counter() < end:
        begin = clock()
        for _ in range(row):
            run()
        taken.append((clock() - begin) / row)
    return min(taken)
