"""More excitation: which further motion, and how long, makes wide intervals narrow; predicted from the model's columns.

The information of a motion is that of the columns at its states, so that it is known before the motion is recorded.
The noise of the rows, and what its serial correlation adds to an interval, are those of the log.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.regressor import regressor_columns
from haptid.errors import HaptidError
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import device_rows
from haptid.inference.diagnosis.excitation import torque_shares
from haptid.inference.diagnosis.finding import joined_names
from haptid.inference.diagnosis.subsample import MOST_SAMPLES
from haptid.inference.diagnosis.verdict import QUOTABLE
from haptid.motion.channels import coordinates
from haptid.motion.motion import Motion

# Motions that are compared: the log's path with its strokes and its speed by these factors.
_MOTIONS = ((1.0, 1.0), (1.0, 1.5), (1.0, 2.0), (1.0, 0.5), (1.5, 1.0))
# States that are evaluated, over all logs; parameters that are named; longest motion that is proposed, over the log.
_STATES, _NAMED, _LONGEST = 1500, 3, 20.0
# Another motion is proposed where it needs this share of the time of more of the same.
_SHORTER = 0.7
# Largest torque of a motion that is proposed, over that of the log.
_TORQUE = 2.5
# Parameters whose torque is a smaller share than this of the estimate's are as good as zero.
_WORTH = 0.005


@dataclass(frozen=True)
class MoreMotion:
    """A further motion, and the intervals that are predicted with it.

    Attributes:
        stroke, speed: of the log's motion, by which it differs.
        seconds: of it.
        same: seconds of more of the same motion that would do as well; inf beyond `_LONGEST` logs.
        torque: largest torque of the motion over that of the log, of the motor where it grows most.
        names: of the parameters.
        before, after: half widths of their 95 % intervals in per cent of their values.
    """

    stroke: float
    speed: float
    seconds: float
    same: float
    torque: float
    names: tuple[str, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]

    @property
    def sentence(self) -> str:
        """What to record, the predicted intervals, and what they depend on."""
        parts = [
            f"{name} +-{a:.3g} instead of +-{b:.3g} %"
            for name, b, a in zip(self.names, self.before, self.after, strict=True)
        ]
        how = {
            (1.0, 1.0): "of the same motion",
            (1.0, 0.5): "of the same path at half the speed",
            (1.5, 1.0): "of the same motion with strokes larger by half, if the device has the room",
        }.get((self.stroke, self.speed), f"of the same path at {self.speed:g} times the speed")
        peak = f" (largest torque {self.torque:.2g} times that of the log)" if self.torque > 1.05 else ""
        seconds, widths = _rounded(self.seconds), joined_names(parts)
        text = f"For narrower intervals, record {seconds} s more {how}{peak}: predicted {widths}"
        if (self.stroke, self.speed) == (1.0, 1.0):
            return f"{text}, with the noise of this log."
        more = f"{_rounded(self.same)} s" if np.isfinite(self.same) else f"more than {_LONGEST:g} times the log"
        return f"{text}, with the noise of this log; the same motion would take {more}."

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "stroke": self.stroke,
            "speed": self.speed,
            "seconds": self.seconds,
            "same_motion_seconds": self.same if np.isfinite(self.same) else None,
            "torque": self.torque,
            "parameters": list(self.names),
            "before_percent": list(self.before),
            "after_percent": list(self.after),
            "sentence": self.sentence,
        }


def more_motion(estimate: Estimate) -> MoreMotion | None:
    """The motion that brings the widest intervals to `QUOTABLE` per cent of standard error soonest.

    None where no parameter that matters has a wider one, or where no motion of `_LONGEST` logs would do. Torque that is
    not modelled, and a noise that grows with speed, are not foreseen.
    """
    poor = _poor(estimate)
    if not poor:
        return None
    model, motions = estimate.model, estimate.observation.motions
    seconds = sum((m.usable[1] - m.usable[0]) * m.dt for m in motions)
    tried = list(_informations(estimate, motions))
    first = tried[0][2]
    names = [model.base.names[k] for k in poor]
    beta, se = np.abs(estimate.beta[poor]), estimate.se[poor]
    # What the noise's serial correlation, and misfit, add to the standard errors of these rows.
    factor = se / np.maximum(_se(first * seconds, poor), np.finfo(float).tiny)
    target = QUOTABLE / 100 * beta

    def reached(J: Array, T: float) -> bool:
        return bool((factor * _se(first * seconds + J * T, poor) <= target).all())

    same = _time(partial(reached, first), seconds)
    best, shortest = tried[0], same
    for other in tried[1:]:
        J, torque = other[2:]
        longest = min(shortest, _LONGEST * seconds)
        if torque < _TORQUE and reached(J, longest) and (time := _time(partial(reached, J), seconds)) < shortest:
            best, shortest = other, time
    if shortest > _SHORTER * same:
        best, shortest = tried[0], same
    if not np.isfinite(shortest):
        return None
    stroke, speed, J, torque = best
    after = factor * _se(first * seconds + J * shortest, poor)
    half = np.diff(estimate.conf_int(), axis=1)[poor, 0] / 2
    widths = (tuple((100 * half / beta).tolist()), tuple((100 * half / beta * after / se).tolist()))
    return MoreMotion(stroke, speed, shortest, same, torque, tuple(names), *widths)


def _poor(estimate: Estimate) -> list[int]:
    """Parameters with standard errors above QUOTABLE per cent whose torque matters, the widest first."""
    shares = torque_shares(estimate)
    relative = 100 * estimate.se / np.maximum(np.abs(estimate.beta), np.finfo(float).tiny)
    wide = np.isfinite(relative) & (relative > QUOTABLE) & (shares > _WORTH)
    there = [k for k in estimate.free_parameters if wide[k]]
    return sorted(there, key=lambda k: -relative[k])[:_NAMED]


def _informations(estimate: Estimate, motions: Sequence[Motion]) -> Iterator[tuple[float, float, Array, float]]:
    """Of every motion its factors, information per second up to a constant, (p, p), and its largest torque."""
    model, free = estimate.model, list(estimate.free_parameters)
    base = model.device.parameters.S[:, list(model.base.independent_columns)]
    rows, stride = device_rows(estimate), max(1, sum(map(len, motions)) // _STATES)
    weights, peaks = np.asarray(estimate.weights), np.zeros(len(rows))
    states = []
    for motion in motions:
        for part in motion.usable_parts(MOST_SAMPLES // len(motions)):
            states.append([x[:, ::stride] for x in coordinates(model.device, motion, *part)])
    c, cd, cdd = (np.concatenate(each, axis=1) for each in zip(*states, strict=True))
    middle = 0.5 * (c.min(axis=1, keepdims=True) + c.max(axis=1, keepdims=True))
    for stroke, speed in _MOTIONS:
        try:
            at = middle + stroke * (c - middle), stroke * speed * cd, stroke * speed**2 * cdd
            W = regressor_columns(model, *at, base).swapaxes(1, 2)[rows]
        except HaptidError:  # outside the workspace of a closed chain
            continue
        torque = np.abs(W @ estimate.beta).max(axis=1)
        if not peaks.any():
            peaks = np.maximum(torque, np.finfo(float).tiny)
        own = (W[:, :, free] * weights[:, None, None]).reshape(-1, len(free))
        A = np.zeros((len(estimate.beta), len(estimate.beta)))
        A[np.ix_(free, free)] = own.T @ own / c.shape[1]
        if np.isfinite(A).all():
            yield stroke, speed, A, float((torque / peaks).max())


def _se(information: Array, which: Sequence[int]) -> Array:
    """Standard errors of some parameters up to a constant, (n,)."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
    kept = np.abs(values) > 1e-12 * np.abs(values).max()
    variance = vectors[list(which)][:, kept] ** 2 @ (1 / values[kept])
    return np.asarray(scale[list(which)] * np.sqrt(np.maximum(variance, 0.0)))


def _time(reached: Any, seconds: float) -> float:
    """The shortest time at which a condition holds, s; inf beyond `_LONGEST` times so many seconds."""
    low, high = 0.0, _LONGEST * seconds
    if not reached(high):
        return np.inf
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high


def _rounded(x: float) -> str:
    """Two digits, never with an exponent."""
    return f"{float(f'{x:.2g}'):g}"
