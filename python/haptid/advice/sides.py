"""Assumptions with few alternatives, each tried as a whole: whose the channels are, and where gravity points.

`other_side` takes channels of motors as those of joints, or the other way round; `other_mounting` takes gravity along
the other axes of the base frame, as on a wall or under a ceiling.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.edits import Edit
from haptid.advice.rows import TrialRows, trial_rows
from haptid.advice.search import LEAST_SE, finer, large_enough, relative_squares, weights_of
from haptid.advice.trial import Bench, Gain, Setting, Trial, gain
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.inference.diagnosis.finding import SIGNIFICANCE, joined_names
from haptid.inference.diagnosis.subsample import MOST_SAMPLES
from haptid.log.log import Log, Side
from haptid.motion.motion import Motion, treat

# Share of the error that has to be left at most: a wrong side is no matter of a few per cent.
MOST_LEFT = 0.7
# Cosine of the angle to gravity from which an axis of the base frame is the one along which gravity points.
_SAME_AXIS = 0.9


@dataclass(frozen=True, eq=False)
class OtherAssumption:
    """An assumption about the whole log, with a lower error on unseen blocks.

    Attributes:
        gain: of squared relative errors, the mean of the motors.
        before, after, se: unseen errors, per cent, and the paired standard error of their difference.
        blocks: unseen time blocks.
    """

    gain: Gain
    before: float
    after: float
    se: float
    blocks: int

    def proven(self, tried: int) -> bool:
        """Whether the gain is significant, corrected for the number of assumptions tried, and large."""
        rare = self.gain.p * tried < SIGNIFICANCE
        return rare and large_enough(self.gain) and self.after < MOST_LEFT * self.before


@dataclass(frozen=True, eq=False)
class OtherSide(OtherAssumption):
    """Sides of positions and torques.

    Attributes:
        position, torque: whose they are; None where that of the study stays.
    """

    position: Side | None
    torque: Side | None

    @property
    def words(self) -> str:
        """What is whose."""
        sides = {"positions": self.position, "torques": self.torque}
        wanted = {side for side in sides.values() if side}
        return " and ".join(
            f"the {joined_names([name for name, own in sides.items() if own == side])} as those of the {side}s"
            for side in sorted(wanted)
        )

    @property
    def edits(self) -> tuple[Edit, ...]:
        """Of the study."""
        sides = {"position": self.position, "torque": self.torque}
        return tuple(Edit("study", "set", ("channels", key, "side"), side) for key, side in sides.items() if side)


def other_side(model: DynamicModel, motions: Sequence[Motion], beta: Array, zero: Sequence[int]) -> OtherSide | None:
    """The sides of the largest proven gain; None where none is proven, or sides are the same for this device.

    Args:
        motions: treated signals of the fit.
        beta: base parameters, (p,), SI.
        zero: those parameters that are fixed at zero.
    """
    if any(m.log is None for m in motions) or sum(map(len, motions)) > MOST_SAMPLES or not _differ(model):
        return None
    now = tuple(finer(motion) for motion in motions)
    rows = trial_rows(model, now, beta)
    tried = [one for sides in _others(now[0].log) if (one := _tried(model, now, rows, beta, zero, *sides)) is not None]
    return max((one for one in tried if one.proven(len(tried))), key=lambda one: one.gain.share, default=None)


def _differ(model: DynamicModel) -> bool:
    """Whether motors couple joints, or have gears: joint and motor side are then different quantities."""
    drives = [drive for drive in model.device.motors if not drive.sensor]
    single = all(np.count_nonzero(drive.row) == 1 and drive.row.max() == 1.0 for drive in drives)
    return not (single and all(drive.gear_ratio == 1.0 for drive in drives))


def _others(log: Log | None) -> Iterator[tuple[Side | None, Side | None]]:
    """Sides other than the log's: of positions and torques, None where it stays."""
    assert log is not None  # as the caller has checked
    now = log.channels.position.side, log.channels.torque.side
    sides: tuple[Side, ...] = ("joint", "motor")
    for position, torque in product(sides, sides):
        if (position, torque) != now:
            yield position if position != now[0] else None, torque if torque != now[1] else None


def _tried(
    model: DynamicModel,
    now: Sequence[Motion],
    rows: TrialRows,
    beta: Array,
    zero: Sequence[int],
    position: Side | None,
    torque: Side | None,
) -> OtherSide | None:
    """Other sides on the same times; None where the device or the units do not permit them."""
    try:
        made = [treat(_of(m.log, position, torque), m.treatment) for m in now if m.log is not None]
        there = trial_rows(model, made, beta, (), now)
    except HaptidError:
        return None
    if there.used.shape != rows.used.shape:
        return None
    kept = np.array([k for k in range(len(beta)) if k not in zero])
    _, figures = compared(model, (rows, there), (beta, beta), (kept, kept))
    return OtherSide(*figures, position, torque)


@dataclass(frozen=True, eq=False)
class OtherMounting(OtherAssumption):
    """Gravity along another axis of the base frame.

    Attributes:
        gravity: in the base frame, m/s^2, (3,).
        rivals: other directions that predict unseen blocks as well, such as up in place of down, m/s^2, (3,) each.
        by_bodies: whether the device file's bodies tell it from them.
    """

    gravity: tuple[float, ...]
    rivals: tuple[tuple[float, ...], ...] = ()
    by_bodies: bool = False

    @property
    def edits(self) -> tuple[Edit, ...]:
        """Of the device."""
        return (Edit("device", "set", ("gravity",), [*self.gravity]),)


def other_mounting(
    model: DynamicModel, motions: Sequence[Motion], beta: Array, zero: Sequence[int]
) -> OtherMounting | None:
    """Gravity along the axis of the base frame with the largest proven gain; None where none is proven.

    Gravity along an axis and against it are told apart by the first moments in the torque of inertia alone: those in
    the torque of gravity take any sign. Slow motion does not tell them apart; the device file's bodies do.

    Args:
        motions: treated signals of the fit.
        beta: base parameters, (p,), SI.
        zero: those parameters that are fixed at zero.
    """
    magnitude = float(np.linalg.norm(model.device.gravity))
    if not magnitude or zero or sum(map(len, motions)) > MOST_SAMPLES:
        return None
    now = tuple(finer(motion) for motion in motions)
    rows, tried, trials = trial_rows(model, now, beta), list[OtherMounting](), list[Trial]()
    agreements = list[float]()
    for axis in (*np.eye(3), *-np.eye(3)):
        if -axis @ model.device.gravity > _SAME_AXIS * magnitude:
            continue
        turned = model.with_gravity(-magnitude * axis)
        start = np.zeros(len(turned.base))
        there = trial_rows(turned, now, start)
        kept = np.arange(len(beta)), np.arange(len(start))
        trial, figures = compared(model, (rows, there), (beta, start), kept)
        tried.append(OtherMounting(*figures, tuple((0.0 - magnitude * axis).tolist())))
        trials.append(trial)
        agreements.append(agreement(turned, there))
    held = [k for k, one in enumerate(tried) if one.proven(len(tried))]
    best = max(held, key=lambda k: tried[k].gain.share, default=None)
    if best is None:
        return None
    losses = {k: gain(trial, trials[best]) for k, trial in enumerate(trials) if k != best}
    alike = [best, *(k for k, loss in losses.items() if loss.share <= LEAST_SE * loss.se)]
    if len(alike) == len(tried):  # the weight is where it seems to be in none: the error has another cause
        return None
    chosen = max((k for k in alike if k in held), key=lambda k: (agreements[k], k == best))
    rivals = tuple(tried[k].gravity for k in alike if k != chosen)
    return replace(tried[chosen], rivals=rivals, by_bodies=any(agreements))


def agreement(model: DynamicModel, rows: TrialRows) -> float:
    """Mean cosine between the torques of motors and those of the device file's bodies; 0 where it has none."""
    told = np.where(rows.used, rows.W[:, :, : len(model.base)] @ model.prior_beta, 0.0)
    y = np.where(rows.used, rows.y, 0.0)
    sizes = np.linalg.norm(told, axis=1) * np.linalg.norm(y, axis=1)
    return float(np.mean((told * y).sum(axis=1) / np.where(sizes > 0, sizes, np.inf)))


def compared(
    model: DynamicModel,
    rows: tuple[TrialRows, TrialRows],
    start: tuple[Array, Array],
    kept: tuple[np.ndarray, np.ndarray],
) -> tuple[Trial, tuple[Gain, float, float, float, int]]:
    """The second trial on the rows of both, and of these gain, unseen errors, their paired standard error and blocks.

    Errors are before and after, per cent.
    """
    trials, parts = [], []
    for bench, trial in trials_of(rows, start, kept):
        parts.append(relative_squares(model, bench, trial))
        trials.append(_relative(bench, trial))
    errors = [100 * float(np.sqrt(part.sum())) for part in parts]
    difference = parts[0] - parts[1]
    se = 1e4 * float(np.sqrt(len(difference)) * difference.std(ddof=1)) / max(sum(errors), 1e-300)
    return trials[1], (gain(*trials), errors[0], errors[1], se, len(difference))


def trials_of(
    rows: tuple[TrialRows, TrialRows], start: tuple[Array, Array], kept: tuple[np.ndarray, np.ndarray]
) -> Iterator[tuple[Bench, Trial]]:
    """The fit of all columns on those rows of each that are used in both, with what judges it."""
    both, same = rows[0].used & rows[1].used, np.eye(len(rows[0].y))
    for one, beta, columns in zip(rows, start, kept, strict=True):
        bench = Bench({"used": one.grams(both)}, len(beta), columns, weights_of(one, len(beta), beta), same)
        yield bench, bench.run(Setting())


def _relative(bench: Bench, trial: Trial) -> Trial:
    """Errors over each motor's squared torque, over the number of motors: torques of other sides have other sizes."""
    own = np.maximum(bench.sizes(trial), np.finfo(float).tiny)
    return replace(trial, errors=trial.errors / bench.weights**2 / own / bench.motors)


def _of(log: Log, position: Side | None, torque: Side | None) -> Log:
    """The log with other sides."""
    channels = log.channels
    if position:
        channels = replace(channels, position=replace(channels.position, side=position))
    if torque:
        channels = replace(channels, torque=replace(channels.torque, side=torque))
    return replace(log, channels=channels)
