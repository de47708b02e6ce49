"""Root of a function of one variable in a bracket: Brent's method, without the 0.2 s that importing SciPy's takes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_MOST = 100


def bracketed_root(function: Callable[[float], float], low: float, high: float, xtol: float) -> float:
    """Where a continuous function is zero, within xtol, by secants and inverse quadratics, or else by halving.

    Source: Brent (1973), Algorithms for Minimization without Derivatives, chapter 4, with the steps of
    `scipy.optimize.brentq`.

    Args:
        function: of opposite signs at the ends.
        low, high: ends of the bracket.
        xtol: error of the root; its rounding error is added.

    Raises:
        ValueError: the signs at the ends are the same.
    """
    before, x = low, high
    f_before, f = function(before), function(x)
    if f_before * f > 0:
        raise ValueError(f"no change of sign between {low:g} and {high:g}: {f_before:g} and {f:g}")
    if f_before == 0:
        return before
    other, f_other, step, last = before, 0.0, 0.0, 0.0  # the other end of the bracket
    for _ in range(_MOST):
        if f == 0:
            return x
        if f_before * f < 0:
            other, f_other = before, f_before
            last = step = x - before
        if abs(f_other) < abs(f):
            before, x, other = x, other, x
            f_before, f, f_other = f, f_other, f
        near, half = 0.5 * (xtol + 4 * np.finfo(float).eps * abs(x)), 0.5 * (other - x)
        if abs(half) < near:
            return x
        tried = np.inf
        if abs(last) > near and abs(f) < abs(f_before):
            if before == other:
                tried = -f * (x - before) / (f - f_before)
            else:
                a, b = (f_before - f) / (before - x), (f_other - f) / (other - x)
                tried = -f * (f_other * b - f_before * a) / (b * a * (f_other - f_before))
        good = 2 * abs(tried) < min(abs(last), 3 * abs(half) - near)
        last, step = (step, tried) if good else (half, half)
        before, f_before = x, f
        x += step if abs(step) > near else float(np.copysign(near, half))
        f = function(x)
    return x
