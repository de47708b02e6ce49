"""Are there errors in W? The test of Durbin, Wu and Hausman, as Janot, Vandanjon and Gautier revised it for robots.

Source: Janot, Vandanjon and Gautier (2016), Control Engineering Practice 48, 52-62: rows are fitted with W and with
what instruments do not explain of W; if that helps, the errors of W and the residual belong together, and least squares
is biased. The instruments are W at the motion of the model under the controller that moved the device, where that is
known: they have no noise at all, so noise of the torque that comes back through the controller is seen too. Where it
is not known they are W made from the same positions through a narrower filter, which shares the motion but hardly the
noise. What they leave of W is folded into two columns a motor by the estimate itself, the torque of the bodies and that
of the other terms, and the F-test is by blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import rigid
from haptid.dynamics.model import DynamicModel
from haptid.errors import MissingAccelerationError, SettingError, SimulationError
from haptid.estimation import IV, Estimate, Method
from haptid.estimation.methods.simulating import ClosedLoop, treated_as
from haptid.inference.diagnosis.added_variable import Extra, Widened
from haptid.inference.diagnosis.context import ResidualContext, torque_of
from haptid.inference.diagnosis.finding import LEVEL, Finding, holm
from haptid.motion.channels import coordinates
from haptid.motion.treatment import Motion, treat
from haptid.simulation import PID, smooth
from haptid.treatment_choice.propose import ABOVE_MOTION, bandwidth

# Errors that move no parameter by more than this many of its deviations are harmless; beyond the second, its interval
# no longer holds the truth as often as it says.
HARMLESS, BIASED = 0.5, 1.0
FILTER_ADVICE = (
    "Leave the cut-offs out of the study file, or call propose in Python, so that they are found from the logs; or "
    "drop more rows near standstill (reversal_speed)."
)
LOOP_ADVICE = (
    "Take instruments (IV) or DIDIM, which this does not bias; or leave the cut-offs out of the study file, so "
    "that they are found from the logs."
)
# Least deviation that is divided by.
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Instruments:
    """Other motions than the measured one, whose columns share its movement and not its noise.

    Attributes:
        motions: of each of an estimate's motions; None where there is none.
        left: what they leave of W, in words.
        advice: what to do where that shows.
    """

    motions: tuple[Motion | None, ...]
    left: str
    advice: str

    def pairs(self, motions: Sequence[Motion]) -> list[tuple[Motion, Motion]] | None:
        """Every motion and its instrument; None where one has none."""
        made = [(motion, own) for motion, own in zip(motions, self.motions, strict=True) if own is not None]
        return made if len(made) == len(motions) else None


def instruments(estimate: Estimate, controller: PID | None = None) -> Instruments:
    """Motions of the model under the controller that moved the device; without it, the log's through a narrower filter.

    Args:
        estimate: whose motions.
        controller: that moved the device; that of the estimate's method where None.
    """
    motions = estimate.observation.motions
    law = controller or known(estimate.method)
    made = simulated(estimate, law) if law is not None and not any(m.treatment.momentum for m in motions) else None
    if made is not None:
        return Instruments(made, "what the simulated closed loop does not explain of W", LOOP_ADVICE)
    return filtered(estimate)


def filtered(estimate: Estimate) -> Instruments:
    """The log's own motions through a narrower filter."""
    narrow = tuple(instrument(motion) for motion in estimate.observation.motions)
    return Instruments(narrow, "what a narrower filter takes from the positions", FILTER_ADVICE)


def known(method: Method) -> PID | None:
    """The controller of a method that simulates the closed loop, or is around one that does; None of others."""
    inner = method if isinstance(method, ClosedLoop) else getattr(method, "weighting", None)
    return inner.controller if isinstance(inner, ClosedLoop) else None


def simulated(estimate: Estimate, law: PID) -> tuple[Motion, ...] | None:
    """What the estimate does along every motion, treated the same; None where it cannot be simulated."""
    loop, model, seen = IV(controller=law), estimate.model, estimate.observation
    try:
        courses = loop.courses(seen, smooth(model, seen.motions, loop.friction), estimate.beta)
    except (SimulationError, SettingError, MissingAccelerationError):
        return None
    return tuple(treated_as(model, course) for course in courses)


def instrument(motion: Motion) -> Motion | None:
    """The same log through a position filter just above its motion; None where there is no narrower one.

    Args:
        motion: treated, from a log.
    """
    if motion.log is None or motion.treatment.momentum:
        return None
    narrow = ABOVE_MOTION * bandwidth(motion.log)
    used = motion.treatment.cutoff_hz
    if not 0 < narrow < 0.5 / motion.dt * 0.9 or (used is not None and narrow > 0.9 * used):
        return None
    return treat(motion.log, replace(motion.treatment, cutoff_hz=narrow))


def errors_in_columns(
    model: DynamicModel, rows: Sequence[int], chi: Array, smooth: Sequence[tuple[Motion, Motion]]
) -> tuple[Extra, ...]:
    """For every row, torque of the motion less torque of the instrument: of bodies, and of other terms.

    Args:
        model: the dynamic model.
        rows: its rows.
        chi: the estimate's parameters of the core's columns, (r,), SI.
        smooth: every motion, and its instrument.
    """
    of = {id(motion): calm for motion, calm in smooth}
    parts = [part for part in (rigid(model, chi), chi - rigid(model, chi)) if part.any()]

    @lru_cache(maxsize=1)  # torque comes for all rows at once
    def differences(sight: ResidualContext) -> Array:
        calm = coordinates(model.device, of[id(sight.plan.motion)], sight.low, sight.high)
        return np.array([sight.torque(part) - torque_of(model, part, *calm) for part in parts])

    units = np.eye(len(model.device.drives))
    return tuple(
        Extra(units[row], len(parts), lambda sight, r=row: differences(sight)[:, r])  # type: ignore[misc]
        for row in rows
    )


def exogeneity(widened: Widened, which: Sequence[int], labels: Sequence[str], by: Instruments) -> Finding:
    """Do the errors of W show in the residual, motor by motor, and how far do they move the parameters?"""
    made = widened.estimate
    found = [widened.test([e]) for e in which]
    told = [(label, one) for label, one in zip(labels, found, strict=True) if one is not None]
    if not told:
        return Finding("errors in W", "ok", {}, "The instruments leave nothing of W.")
    p = holm([one.p for _, one in told])
    first = int(np.argmin(p))
    label, explained = told[first][0], float(told[first][1].explained.max())
    kept = list(made.kept)
    moved = np.abs(told[first][1].moved) / np.maximum(made.se[kept], TINY)
    worst, most = made.base.names[kept[int(np.argmax(moved))]], float(moved.max())
    figures = {
        "p": float(p[first]),
        "explained": explained,
        "moved": most,
        **{f"p {name}": one.p for name, one in told},
    }
    if p[first] < LEVEL and most <= HARMLESS:
        text = (
            f"Noise of the positions (errors in W) shows in the residual of {label} (Durbin-Wu-Hausman, "
            f"p = {p[first]:.1e}, limit {LEVEL:g}) but does no harm: {worst} moves by {most:.2g} deviations (limit "
            f"{HARMLESS:g}), the others by less."
        )
        return Finding("errors in W", "ok", figures, text)
    if p[first] >= LEVEL:
        test = f"Durbin-Wu-Hausman, p = {p[first]:.2g}, limit {LEVEL:g}"
        text = f"Nothing of {by.left} shows in the residual ({test}): no errors in W."
        return Finding("errors in W", "ok", figures, text)
    text = (
        f"Noise of the positions (errors in W) shows in the residual of {label}: {100 * explained:.1f} % of its "
        f"power goes with {by.left} (Durbin-Wu-Hausman, p = {p[first]:.1e}, limit {LEVEL:g}), and least squares of "
        f"{worst} is biased by {most:.2g} deviations (limit {HARMLESS:g}). {by.advice}"
    )
    return Finding("errors in W", "bad" if most > BIASED else "doubt", figures, text)
