"""Exact groupings: time of each device's, and whether 200 draws all give the same."""

from __future__ import annotations

import time

import numpy as np

import haptid
from haptid.device.toml.reader import shipped_devices
from haptid.dynamics.symbolic import regroupings

SEEDS = 200


def run() -> dict[str, float]:
    """Least, median and longest processor time, ms, and failures or differences in all seeds, by device."""
    figures: dict[str, float] = {}
    for name in shipped_devices():
        model = haptid.DynamicModel(haptid.read_device(name))
        first, times, failures = model.regroupings, [], 0
        for seed in range(SEEDS):
            start = time.process_time()
            try:
                failures += regroupings(model, seed).coefficients != first.coefficients
            except haptid.errors.RegroupingError:
                failures += 1
            times.append(1e3 * (time.process_time() - start))
        figures[f"{name}, base parameters"] = len(first)
        figures[f"{name}, least ms"] = min(times)
        figures[f"{name}, median ms"] = float(np.median(times))
        figures[f"{name}, longest ms"] = max(times)
        figures[f"{name}, failures in {SEEDS} seeds"] = failures
    return figures
