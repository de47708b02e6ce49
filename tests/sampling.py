"""How far a statistic of draws may be from its expectation: four deviations, which one seed in 16000 exceeds."""

from __future__ import annotations

import numpy as np

FAR = 4.0


def of_share(p: float, draws: int) -> float:
    """Of the share of independent draws that have something with probability p."""
    return float(FAR * np.sqrt(p * (1 - p) / draws))


def of_deviation(draws: int) -> float:
    """Of a standard deviation of normal draws, relative."""
    return float(FAR / np.sqrt(2 * (draws - 1)))


def of_mean(values: np.ndarray) -> float:
    """Of the mean of these independent draws, by their own scatter."""
    return float(FAR * np.std(values, ddof=1) / np.sqrt(len(values)))
