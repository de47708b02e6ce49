"""Delay test: is the torque late relative to the motion? To first order a delay d adds d * dtau/dt to the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid.inference.diagnosis.added_variable import AugmentedRows
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding, Status
from haptid.uncertainty.multiple_testing import together
from haptid.uncertainty.quantities import half_width

# Shares of the sampling period: below the first the bias is negligible, above the second viscous friction is biased.
NEGLIGIBLE, LARGE = 0.05, 0.25


def time_delay(augmented: AugmentedRows, which: Sequence[int], labels: Sequence[str]) -> Finding:
    """The delay of every motor's torque, with its confidence interval."""
    motion = augmented.estimate.observation.motions[0]
    found = augmented.each(which, labels)
    if not found:
        return Finding("time delay", "ok", {}, "The torque's delay is not identifiable from this motion.")
    p = together(np.array([one.p for _, one in found]))
    figures: dict[str, float] = {}
    for label, one in found:
        half = float(half_width(one.se[0], one.dof))
        figures |= {f"delay {label}": one.values[0], f"half_width {label}": half}
    first = int(np.argmin(p))
    label, dt = found[first][0], float(motion.dt)
    delay, half = figures[f"delay {label}"], figures[f"half_width {label}"]
    figures |= {"p": p[first]}
    what = "late" if delay > 0 else "early"
    size = f"{1e3 * abs(delay):.3g} ms (95 % interval +- {1e3 * half:.2g} ms, sampling period {1e3 * dt:.3g} ms)"
    if p[first] >= SIGNIFICANCE or abs(delay) < NEGLIGIBLE * dt:
        text = f"No torque delay that matters: {label} {what} by {size}, p = {p[first]:.2g}, limit {SIGNIFICANCE:g}."
        return Finding("time delay", "ok", figures, text)
    status: Status = "bad" if abs(delay) > LARGE * dt else "doubt"
    text = (
        f"The torque of {label} is {what} by {size}, p = {p[first]:.1e}, limit {SIGNIFICANCE:g}: viscous friction is "
        f"biased."
    )
    return Finding("time delay", status, figures, text)
