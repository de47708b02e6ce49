"""Figures as text, to two digits of their standard error."""

from __future__ import annotations

import math

import numpy as np


def per_cent(value: float, digits: int = 2) -> str:
    """A percentage rounded to `digits` significant digits, never with an exponent: 3.0 %, 0.38 %, 124 %."""
    if not np.isfinite(value):
        return "an unknown share"
    rounded = float(f"{value:.{digits - 1}e}")
    places = digits - 1 - math.floor(math.log10(abs(rounded))) if rounded else 0
    return f"{value:.{max(places, 0)}f} %"


def relative_se_cell(se: float, value: float) -> str:
    """Relative standard error, per cent, for a table: as `per_cent` without its unit; above 100 only its order."""
    percent = 100 * se / abs(value) if value else math.inf
    return per_cent(percent).removesuffix(" %") if percent < 99.5 else ("> 100" if percent < 1000 else "> 1000")


def with_digits(value: float, se: float) -> str:
    """A value to two digits of its standard error: 1416.0 with 192 is 1420."""
    if not (np.isfinite(se) and np.isfinite(value) and abs(value) < 1e6 and se > 1e-9):
        return f"{value:.6g}"
    decimals = 1 - math.floor(math.log10(se))
    return f"{round(value, decimals):z.{max(decimals, 0)}f}" if decimals <= 12 else f"{value:.6g}"
