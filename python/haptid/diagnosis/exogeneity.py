"""Are there errors in W? The test of Durbin, Wu and Hausman, as Janot, Vandanjon and Gautier revised it for robots.

Source: Janot, Vandanjon and Gautier (2016), Control Engineering Practice 48, 52-62: rows are fitted with W and with
what instruments do not explain of W; if that helps, the errors of W and the residual belong together, and least squares
is biased. Here the instruments are W made from the same positions through a narrower filter, which shares the motion
but hardly the noise. What they leave of W is folded into two columns a motor by the estimate itself, the torque of the
bodies and that of the other terms, and the F-test is by blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from haptid._values import Array
from haptid.device import Device
from haptid.diagnosis.finding import LEVEL, Finding, holm
from haptid.diagnosis.sight import Sight, torque_of
from haptid.diagnosis.widened import Extra, Widened
from haptid.dynamics import rigid
from haptid.proposal import ABOVE_MOTION, bandwidth
from haptid.signals import coordinates
from haptid.treatment import Motion, treat

# Errors that move no parameter by more than this many of its deviations are harmless; beyond the second, its interval
# no longer holds the truth as often as it says.
HARMLESS, BIASED = 0.5, 1.0
# Least deviation that is divided by.
TINY = float(np.finfo(float).tiny)


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
    device: Device, rows: Sequence[int], chi: Array, smooth: Sequence[tuple[Motion, Motion]]
) -> tuple[Extra, ...]:
    """For every row, torque of the motion less torque of the instrument: of bodies, and of other terms.

    Args:
        device: the mechanism.
        rows: its rows.
        chi: the estimate's parameters of the core's columns, (r,), SI.
        smooth: every motion, and its instrument.
    """
    of = {id(motion): calm for motion, calm in smooth}
    parts = [part for part in (rigid(device, chi), chi - rigid(device, chi)) if part.any()]

    @lru_cache(maxsize=1)  # torque comes for all rows at once
    def differences(sight: Sight) -> Array:
        calm = coordinates(device, of[id(sight.plan.motion)], sight.low, sight.high)
        return np.array([sight.torque(part) - torque_of(device, part, *calm) for part in parts])

    units = np.eye(len(device.drives))
    return tuple(
        Extra(units[row], len(parts), lambda sight, r=row: differences(sight)[:, r])  # type: ignore[misc]
        for row in rows
    )


def exogeneity(widened: Widened, which: Sequence[int], labels: Sequence[str]) -> Finding:
    """Do the errors of W show in the residual, motor by motor, and how far do they move the parameters?"""
    made = widened.estimate
    found = [widened.test([e]) for e in which]
    told = [(label, one) for label, one in zip(labels, found, strict=True) if one is not None]
    if not told:
        return Finding("errors in W", "ok", {}, "A narrower filter of the positions changes nothing.")
    p = holm([one.p for _, one in told])
    first = int(np.argmin(p))
    label, explained = told[first][0], float(told[first][1].explained.max())
    kept = list(made.kept)
    moved = np.abs(told[first][1].moved) / np.maximum(made.sd[kept], TINY)
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
        text = f"No noise of the positions (errors in W) shows in the residual ({test})."
        return Finding("errors in W", "ok", figures, text)
    text = (
        f"Noise of the positions (errors in W) shows in the residual of {label}: {100 * explained:.1f} % of its "
        f"power goes with what a narrower filter takes from the positions (Durbin-Wu-Hausman, p = {p[first]:.1e}, "
        f"limit {LEVEL:g}), and {worst} is biased by {most:.2g} deviations (limit {HARMLESS:g}). "
        f"Leave the cut-offs out of the study file, or call propose in Python, so that they are found from the logs; "
        f"or drop more rows near standstill (low_speed)."
    )
    return Finding("errors in W", "bad" if most > BIASED else "doubt", figures, text)
