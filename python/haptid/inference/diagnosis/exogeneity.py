"""Exogeneity: the Durbin-Wu-Hausman test for errors in variables, as revised for robots.

Source: Janot, Vandanjon and Gautier (2016), Control Engineering Practice 48, 52-62: the rows are fitted with W and with
the part of W that instruments do not explain; if the latter is significant, the errors of W are correlated with the
residual, and least squares is biased. Where the controller is known, the instruments are W at the motion of the
simulated closed loop, which is free of noise, so that torque noise fed back through the controller is detected too.
Otherwise they are W computed from the same positions through a narrower filter, which has the motion but little of the
noise. The unexplained part of W is combined into two columns per motor, the torque of the bodies and that of the other
terms at the estimate, and the F-test is cluster-robust.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import rigid
from haptid.dynamics.model import DynamicModel
from haptid.errors import MissingAccelerationError, SettingError, SimulationError
from haptid.estimation import IV, Estimate, Method
from haptid.estimation.methods.simulation_based import ClosedLoop, treated_as
from haptid.inference.diagnosis.added_variable import AugmentedRows
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding
from haptid.log.spectrum import bandwidth
from haptid.motion.channels import coordinates
from haptid.motion.motion import Motion, treat
from haptid.observation.augmented import CandidateColumns, ResidualContext, torque_of
from haptid.simulation import PID, smooth
from haptid.uncertainty.multiple_testing import holm_adjusted

# Bias of a parameter in standard errors: harmless up to the first; beyond the second its interval undercovers.
HARMLESS, BIASED = 0.5, 1.0
# Cut-off of the narrow position filter over the bandwidth of the motion.
_ABOVE_MOTION = 3.0
# Smallest standard error used as a divisor.
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Instruments:
    """Instrument motions: their columns are correlated with the measured ones, but not with their noise.

    Attributes:
        motions: for each of an estimate's motions; None where there is none.
        left: the part of W that they do not explain, in words.
    """

    motions: tuple[Motion | None, ...]
    left: str

    def pairs(self, motions: Sequence[Motion]) -> list[tuple[Motion, Motion]] | None:
        """Every motion with its instrument; None where one has none."""
        pairs = [(motion, own) for motion, own in zip(motions, self.motions, strict=True) if own is not None]
        return pairs if len(pairs) == len(motions) else None


def instruments(estimate: Estimate, controller: PID | None = None) -> Instruments:
    """Motions of the simulated closed loop; without a known controller, the log's through a narrower filter.

    Args:
        estimate: whose motions.
        controller: that moved the device; that of the estimate's method where None.
    """
    motions = estimate.observation.motions
    law = controller or controller_of(estimate.method)
    simulation = (
        simulated(estimate, law) if law is not None and not any(m.treatment.momentum for m in motions) else None
    )
    if simulation is not None:
        return Instruments(simulation, "the part of W that the simulated closed loop does not explain")
    return filtered_columns(estimate)


def filtered_columns(estimate: Estimate) -> Instruments:
    """The log's own motions through a narrower filter."""
    narrow = tuple(narrowly_filtered(motion) for motion in estimate.observation.motions)
    return Instruments(narrow, "the part of the positions that a narrower filter removes")


def controller_of(method: Method) -> PID | None:
    """The controller of a method that simulates the closed loop, or wraps one that does; None of others."""
    inner = method if isinstance(method, ClosedLoop) else getattr(method, "weighting", None)
    return inner.controller if isinstance(inner, ClosedLoop) else None


def simulated(estimate: Estimate, law: PID) -> tuple[Motion, ...] | None:
    """Simulated motions of the estimate, with the same treatment; None where it cannot be simulated."""
    loop, model, observation = IV(controller=law), estimate.model, estimate.observation
    try:
        courses = loop.courses(observation, smooth(model, observation.motions, loop.friction), estimate.beta)
    except (SimulationError, SettingError, MissingAccelerationError):
        return None
    return tuple(treated_as(model, course) for course in courses)


def narrowly_filtered(motion: Motion) -> Motion | None:
    """The same log through a position filter just above its bandwidth; None where the filter is no narrower.

    Args:
        motion: treated, from a log.
    """
    if motion.log is None or motion.treatment.momentum:
        return None
    narrow = _ABOVE_MOTION * bandwidth(motion.log)
    used = motion.treatment.cutoff_hz
    if not 0 < narrow < 0.5 / motion.dt * 0.9 or (used is not None and narrow > 0.9 * float(np.min(used))):
        return None
    return treat(motion.log, replace(motion.treatment, cutoff_hz=narrow))


def unexplained_columns(
    model: DynamicModel, rows: Sequence[int], chi: Array, pairs: Sequence[tuple[Motion, Motion]]
) -> tuple[CandidateColumns, ...]:
    """For every row, torque of the motion minus torque of the instrument: of bodies, and of other terms.

    Args:
        rows: its rows.
        chi: the estimate's parameters of the core's columns, (r,), SI.
        pairs: every motion with its instrument.
    """
    instrument_of = {id(motion): own for motion, own in pairs}
    parts = [part for part in (rigid(model, chi), chi - rigid(model, chi)) if part.any()]

    @lru_cache(maxsize=1)  # torque is computed for all rows at once
    def differences(context: ResidualContext) -> Array:
        own = coordinates(model.device, instrument_of[id(context.plan.motion)], context.low, context.high)
        return np.array([context.torque(part) - torque_of(model, part, *own, context.history) for part in parts])

    units = np.eye(len(model.device.active))
    return tuple(
        CandidateColumns(units[row], len(parts), lambda context, r=row: differences(context)[:, r])  # type: ignore[misc]
        for row in rows
    )


def exogeneity(
    augmented: AugmentedRows, candidates: Sequence[int], labels: Sequence[str], instruments: Instruments
) -> Finding:
    """Are errors in W correlated with the residual, motor by motor, and how large is the bias of the parameters?"""
    fitted = augmented.estimate
    tests = augmented.each(candidates, labels)
    if not tests:
        return Finding("errors in W", "ok", {}, "The instruments explain all of W.")
    p = holm_adjusted(np.array([test_here.p for _, test_here in tests]))
    first = int(np.argmin(p))
    label, test = tests[first]
    explained, free = float(test.explained.max()), list(fitted.free_parameters)
    bias = np.abs(test.shift) / np.maximum(fitted.se[free], _TINY)
    worst, most = fitted.base.names[free[int(np.argmax(bias))]], float(bias.max())
    figures = {"p": float(p[first]), "explained": explained, "bias": most}
    figures |= {f"p {name}": test_here.p for name, test_here in tests}
    if p[first] < SIGNIFICANCE and most <= HARMLESS:
        text = (
            f"Position noise (errors in variables) is significant in the residual of {label} (Durbin-Wu-Hausman, "
            f"p = {p[first]:.1e}, limit {SIGNIFICANCE:g}) but harmless: the bias of {worst} is {most:.2g} standard "
            f"errors (limit {HARMLESS:g}), that of the others less."
        )
        return Finding("errors in W", "ok", figures, text)
    if p[first] >= SIGNIFICANCE:
        text = (
            f"No sign of errors in variables: {instruments.left} is not significant in the residual "
            f"(Durbin-Wu-Hausman, p = {p[first]:.2g}, limit {SIGNIFICANCE:g})."
        )
        return Finding("errors in W", "ok", figures, text)
    text = (
        f"Position noise (errors in variables) biases the estimate: {instruments.left} explains {100 * explained:.1f} "
        f"% of the residual power of {label} (Durbin-Wu-Hausman, p = {p[first]:.1e}, limit {SIGNIFICANCE:g}), and the "
        f"bias of {worst} is {most:.2g} standard errors (limit {HARMLESS:g})."
    )
    return Finding("errors in W", "bad" if most > BIASED else "doubt", figures, text)
