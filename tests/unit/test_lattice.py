"""Density of the errors of rounding: white of fast motion, more in the band of slow motion, with one mean square."""

from __future__ import annotations

import numpy as np

from haptid.log.lattice import rounding_density

STEP, DT, WHITE = 1e-3, 1e-3, 2e-3 / 12 * 1e-6


def density(speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and density for a sine of 2 Hz; `speed` is its root mean square speed in steps per sample."""
    t = DT * np.arange(20_000)
    amplitude = speed * STEP / DT * np.sqrt(2) / (4 * np.pi)
    f, power = rounding_density((amplitude * np.sin(4 * np.pi * t))[:, None], np.array([STEP]), DT)
    return f, power[0]


def test_rounding_of_fast_motion_is_white():
    f, power = density(20.0)
    assert abs(power[(f > 1) & (f < 400)].mean() / WHITE - 1) < 0.1


def test_rounding_of_slow_motion_is_in_the_band_of_the_motion():
    f, power = density(0.05)
    assert power[(f > 1) & (f < 50)].mean() > 1.5 * WHITE
    assert abs(power.sum() * (f[1] - f[0]) / (STEP**2 / 12) - 1) < 0.1


def test_channels_without_a_step_have_no_rounding():
    assert not rounding_density(np.sin(np.arange(3000.0))[:, None], np.zeros(1), DT)[1].any()
