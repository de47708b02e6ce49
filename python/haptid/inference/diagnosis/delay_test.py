"""Delay test: is the torque late relative to the motion? To first order a delay d adds d * dtau/dt to the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid.inference.diagnosis.added_variable import AugmentedRows
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding, Status
from haptid.uncertainty.multiple_testing import holm_adjusted
from haptid.uncertainty.quantities import half_width

# Shares of the sampling period: below the first the bias is negligible, above the second viscous friction is biased.
NEGLIGIBLE, LARGE = 0.05, 0.25


def time_delay(augmented: AugmentedRows, candidates: Sequence[int], labels: Sequence[str]) -> Finding:
    """The delay of every motor's torque, with its confidence interval."""
    motion = augmented.estimate.observation.motions[0]
    tests = augmented.each(candidates, labels)
    if not tests:
        return Finding("time delay", "ok", {}, "The torque's delay is not identifiable from this motion.")
    p = holm_adjusted(np.array([test.p for _, test in tests]))
    figures: dict[str, float] = {}
    for label, test in tests:
        half = float(half_width(test.se[0], test.dof))
        figures |= {f"delay {label}": test.values[0], f"half_width {label}": half}
    first = int(np.argmin(p))
    label, dt = tests[first][0], float(motion.dt)
    delay, half = figures[f"delay {label}"], figures[f"half_width {label}"]
    figures |= {"p": p[first]}
    direction = "late" if delay > 0 else "early"
    size = f"{1e3 * abs(delay):.3g} ms (95 % interval +- {1e3 * half:.2g} ms, sampling period {1e3 * dt:.3g} ms)"
    if p[first] >= SIGNIFICANCE or abs(delay) < NEGLIGIBLE * dt:
        text = (
            f"No torque delay that matters: {label} {direction} by {size}, p = {p[first]:.2g}, limit {SIGNIFICANCE:g}."
        )
        return Finding("time delay", "ok", figures, text)
    status: Status = "bad" if abs(delay) > LARGE * dt else "doubt"
    text = (
        f"The torque of {label} is {direction} by {size}, p = {p[first]:.1e}, limit {SIGNIFICANCE:g}: viscous friction "
        f"is biased."
    )
    return Finding("time delay", status, figures, text)
