"""Suspicions of a wrong unit, gear, sign or clock: torque beside that of the bodies the device file knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array
from haptid.device.parameters import INERTIAL
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import Extra, Widened
from haptid.inference.diagnosis.context import ResidualContext, torque_of
from haptid.inference.diagnosis.finding import LEVEL, Finding, Status, listed

# Factors that units make, and what each means.
UNITS = {
    1000.0: "milli- for whole units",
    1e-3: "whole for milli-units",
    1e6: "milliseconds for seconds, or mm^2 for m^2",
    1e-6: "microseconds or um^2",
    180 / np.pi: "degrees for radians",
    np.pi / 180: "radians for degrees",
    9.80665: "kilograms for newtons",
    1 / 9.80665: "newtons for kilograms",
}
# A factor within this share of a named one is that one; one within this range of 1 is what priors are good for.
NAMED, GOOD = 0.15, 2.0
# A factor is told where its deviation is below this share of it.
TOLD = 0.25
# Parameters that cannot be negative, by kind.
POSITIVE = ("FV", "FC", "IA")


@dataclass(frozen=True, eq=False)
class Known:
    """Base parameters of bodies that the device file knows.

    Attributes:
        inertial: indices of the base parameters of bodies, (k,).
        beta: their prior values, the others zero, (p,), SI.
    """

    inertial: tuple[int, ...]
    beta: Array


def known(model: DynamicModel) -> Known | None:
    """What the device file knows of its bodies; None where it does not know them all."""
    kinds = [model.device.parameters.kinds[k] for k in model.base.independent_columns]
    inertial = tuple(k for k, kind in enumerate(kinds) if kind in INERTIAL)
    prior = [model.base_prior[k] for k in inertial]
    if not inertial or any(value is None for value in prior):
        return None
    beta = np.zeros(len(model.base))
    beta[list(inertial)] = [value[0] for value in prior if value is not None]
    return Known(inertial, beta) if beta.any() else None


def expected(model: DynamicModel, rows: Sequence[int], bodies: Known) -> tuple[Extra, ...]:
    """For every row the torque of the known bodies: that of motion, and that of gravity.

    Only the first is judged: of a balanced device, gravity is a small difference that no prior tells.
    """
    chi = raw_parameters(model, bodies.beta)

    @lru_cache(maxsize=1)  # torque comes for all rows at once
    def torques(sight: ResidualContext) -> Array:
        c = sight.motion[0]
        weight = torque_of(model, chi, c, np.zeros_like(c), np.zeros_like(c))
        return np.array([sight.torque(chi) - weight, weight])

    units = np.eye(len(model.device.drives))
    return tuple(
        Extra(units[row], 1, lambda sight, r=row, k=kind: torques(sight)[k, [r]])  # type: ignore[misc]
        for row in rows
        for kind in (0, 1)
    )


@dataclass(frozen=True)
class Factor:
    """How many times what the known bodies need to move a motor's torque is.

    Attributes:
        motor: "motor 2".
        value, se: and the deviation.
        half: of the 95 % interval.
    """

    motor: str
    value: float
    se: float
    half: float


def factors(widened: Widened, which: Sequence[int], bodies: Known, labels: Sequence[str]) -> tuple[Factor, ...]:
    """Of every motor that tells it, gravity and all but the bodies being free."""
    made: list[Factor] = []
    for m, label in enumerate(labels):
        motion, weight = which[2 * m : 2 * m + 2]
        for tried in ((motion, weight), (motion,)):
            added = widened.test(tried, bodies.inertial, only=m)
            if added is not None:
                value, se = float(added.gamma[0]), float(added.se[0])
                made.append(Factor(label, value, se, float(stats.t.ppf(0.975, added.dof)) * se))
                break
    return tuple(factor for factor in made if factor.se < TOLD * abs(factor.value))


def cause(factor: float, gears: Sequence[float]) -> str | None:
    """What makes such a factor; None for nothing that has a name."""
    named = dict(UNITS)
    for gear in gears:
        if abs(np.log(abs(gear))) > np.log(GOOD):
            named |= {abs(gear): "a gear ratio left out", 1 / abs(gear): "a gear ratio counted twice"}
            named |= {gear**2: "a gear ratio squared", gear**-2: "a gear ratio squared"}
    near = [(abs(np.log(abs(factor) / value)), words) for value, words in named.items()]
    distance, words = min(near)
    return words if distance < NAMED else None


def suspicion(made: Estimate, found: Sequence[Factor]) -> Finding:
    """Factors that have a name, signs that cannot be, and clocks with jitter."""
    figures = {f"factor {factor.motor}": factor.value for factor in found}
    gears = [motor.gear for motor in made.model.device.motors] + [
        motor.gear * motor.gain for motor in made.model.device.motors
    ]
    bad, doubt = [], []
    for factor in found:
        size = f"The torque of {factor.motor} is {factor.value:.3g} times what moves the bodies in the device file"
        words = cause(factor.value, gears)
        if factor.value < 0:
            bad.append(f"{size}: a sign is wrong; turn the channel of torque or of position round.")
        elif words and not 1 / GOOD < factor.value < GOOD:
            bad.append(f"{size}: as {words} would make it. Check unit, gear and gain.")
        elif not 1 / GOOD < factor.value + np.sign(1 - factor.value) * factor.half < GOOD:
            doubt.append(f"{size} (limit {GOOD:g}): check unit, gear, gain and the device file's bodies.")
    negative = _negative(made)
    if negative:
        doubt.append(f"{listed(negative)} cannot be negative: check signs, the torque's delay and filters.")
    notes = [note for motion in made.observation.motions if motion.log for note in motion.log.notes]
    doubt += [note for note in notes if "jitter" in note][:1]
    status: Status = "bad" if bad else "doubt" if doubt else "ok"
    if status != "ok":
        return Finding("units and signs", status, figures, " ".join([*bad, *doubt][:3]))
    text = "Torques are of the size that the device file's bodies need" if found else "No prior bodies to compare with"
    return Finding("units and signs", status, figures, f"{text}, and no friction is negative.")


def _negative(made: Estimate) -> list[str]:
    """Friction and rotor parameters that are below zero beyond chance, all taken together (Bonferroni)."""
    kinds = [made.model.device.parameters.kinds[k] for k in made.base.independent_columns]
    names = []
    for k, kind in enumerate(kinds):
        if kind in POSITIVE and made.beta[k] < 0:
            p = stats.t.cdf(made.beta[k] / made.se[k], made.dof[k])
            if p * len(kinds) < LEVEL:
                names.append(made.base.names[k])
    return names
