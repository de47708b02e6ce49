"""Is the torque late beside the motion? Motor by motor: a delay adds itself times the rate of torque."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from haptid.dynamics.model import DynamicModel
from haptid.inference.diagnosis.added_variable import Extra, Widened
from haptid.inference.diagnosis.finding import LEVEL, Finding, Status, holm

# A delay below this share of the sampling period hardly biases anything; above the second, it biases viscous friction.
NEAR, FAR = 0.05, 0.25


def rates(model: DynamicModel, rows: Sequence[int]) -> tuple[Extra, ...]:
    """For every row, the rate of change of the model's torque."""

    def rate(row: int) -> Extra:
        return Extra(
            np.eye(len(model.device.drives))[row],
            1,
            lambda sight: np.gradient(sight.predicted[row], sight.plan.motion.dt)[None],
        )

    return tuple(rate(row) for row in rows)


def late(widened: Widened, which: Sequence[int], labels: Sequence[str]) -> Finding:
    """How late every motor's torque is, with its interval."""
    dt = float(widened.estimate.observation.motions[0].dt)
    found = [widened.test([e]) for e in which]
    told = [(label, one) for label, one in zip(labels, found, strict=True) if one is not None]
    if not told:
        return Finding("time delay", "ok", {}, "The motion does not tell how late the torque is.")
    p = holm([one.p for _, one in told])
    figures: dict[str, float] = {}
    for label, one in told:
        half = float(stats.t.ppf(0.975, one.dof) * one.se[0])
        figures |= {f"delay {label}": one.gamma[0], f"half_width {label}": half}
    first = int(np.argmin(p))
    label, one = told[first]
    delay, half = figures[f"delay {label}"], figures[f"half_width {label}"]
    figures |= {"p": p[first]}
    around = f"{1e3 * delay:.3g} ms (95 % interval +- {1e3 * half:.2g} ms, sampling period {1e3 * dt:.3g} ms)"
    if p[first] >= LEVEL or abs(delay) < NEAR * dt:
        text = f"The torque is on time: {label} is late by {around}, p = {p[first]:.2g}, limit {LEVEL:g}."
        return Finding("time delay", "ok", figures, text)
    status: Status = "bad" if abs(delay) > FAR * dt else "doubt"
    what = "late" if delay > 0 else "early"
    asked = widened.estimate.observation.motions[0].treatment.torque_delay_s + delay
    text = (
        f"The torque of {label} is {what} by {around}, p = {p[first]:.1e}, limit {LEVEL:g}: viscous friction is "
        f"biased. Write torque_delay_s = {asked:.2g} under [treatment] in the study file, or "
        f"Treatment(torque_delay_s={asked:.2g}) in Python, and estimate again."
    )
    return Finding("time delay", status, figures, text)
