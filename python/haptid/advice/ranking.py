"""Order of proven changes: by the error that is stated beside each, the simpler one first of those alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.search import LARGE_GAIN, LARGE_SE, LEAST_SE, Proven, Trials, TriedChange, paired, unseen_percent
from haptid.advice.trial import Bench, Trial, gain

# Share of the best gain that makes a simpler change the better one; without it, the most that it may leave, over what
# the best one leaves.
NEARLY, _LEAVES = 0.97, 1.25
# Share of a spring's gain with which a constant torque on the same joints comes before it: the spring's rest, which is
# fitted, has a constant torque in it, and lies outside of the motion's range, by 0.7 of its half, where so much is due
# to that.
_MOSTLY_CONSTANT = 0.9
# Changes of torque channels.
OF_TORQUE_CHANNELS = ("gain", "torque sign", "torque swap")
# The friction that others refine.
_PLAIN = {"load friction": "coulomb", "stribeck": "coulomb", "presliding": "coulomb", "bent viscosity": "viscous"}


@dataclass(frozen=True)
class Stated:
    """What a change does to the error on unseen blocks, as its sentence says it.

    Attributes:
        before, after: per cent.
        se: paired standard error of their difference.
        motor: whose error it is, an index; None for that of all.
    """

    before: float
    after: float
    se: float
    motor: int | None

    @property
    def size(self) -> tuple[bool, float]:
        """What changes are sorted by: those that show in the error of all, then by what the error falls by."""
        return self.motor is None, self.before - self.after


def stated(search: Trials, base: Trial, trial: Trial) -> Stated:
    """The error of all motors, or where the change does not show in it that of the motor that it helps.

    Changes are judged in units of each motor's residual: that of a small motor hardly shows in the error of all.
    """
    whole = _stated(search, base, trial, None)
    large = whole.after**2 < (1 - LARGE_GAIN) * whole.before**2
    if whole.before - whole.after >= (LARGE_SE if large else LEAST_SE) * whole.se:
        return whole
    own = _stated(search, base, trial, helped(base, trial))
    # That of all is a motor's own where there is no other.
    return own if (own.before - own.after) * whole.se > (whole.before - whole.after) * own.se else whole


def _stated(search: Trials, base: Trial, trial: Trial, motor: int | None) -> Stated:
    before, after = (unseen_percent(search.model, search.bench, one, motor) for one in (base, trial))
    return Stated(before, after, paired(search.model, search.bench, base, trial, motor), motor)


def helped(before: Trial, after: Trial) -> int:
    """The motor whose error falls most."""
    return int(np.argmax((before.errors - after.errors).sum(axis=0)))


def in_order(found: Sequence[tuple[Proven, Stated]]) -> list[Proven]:
    """By what is stated; of those that nearly have the gain of the best one, that with the fewest columns first."""
    left, made = sorted(found, key=lambda each: each[1].size, reverse=True), []
    while left:
        alike = [each for each in left if _within(left[0], each)]
        best, _ = min(alike, key=lambda each: (len(each[0].trial.whole.columns), -each[1].size[1]))
        plain = (one for one, _ in left if _refines(best.candidate, one.candidate))
        made.append(next(plain, best))
        left = [each for each in left if each[0] is not made[-1]]
    return made


def of_possible_bodies(found: Sequence[Proven], bench: Bench, below: Callable[[Array], int]) -> list[Proven]:
    """Without changes of torque channels that leave more motors of negative inertia than another of the same gain.

    Two motors that are coupled have their signs told apart up to that of both: the prediction is the same.

    Args:
        found: changes, in order.
        bench: of their trials.
        below: how many motors have a negative inertia by base parameters.
    """
    channels = [one for one in found if one.candidate.kind in OF_TORQUE_CHANNELS]
    counts = {id(one): below(bench.base_parameters(one.trial)) for one in channels}

    def worse(one: Proven) -> bool:
        return any(
            counts[id(other)] < counts[id(one)] and abs((loss := gain(other.trial, one.trial)).share) <= loss.se
            for other in channels
        )

    return [one for one in found if id(one) not in counts or not worse(one)]


def _refines(one: TriedChange, plain: TriedChange) -> bool:
    """Whether a friction term comes on top of another one, which its coordinate lacks: load, speed and history change
    dry friction, so that they explain much of it where there is none."""
    return _PLAIN.get(one.kind) == plain.kind and bool(set(one.places) & set(plain.places))


def _within(best: tuple[Proven, Stated], other: tuple[Proven, Stated]) -> bool:
    """Whether another has NEARLY all of the gain, or differs by less than a paired standard error and leaves little."""
    if best[1].motor != other[1].motor:
        return False
    worse = gain(other[0].trial, best[0].trial)
    little = other[0].trial.total <= _LEAVES * best[0].trial.total
    share = _MOSTLY_CONSTANT if little and _constant_part(best[0].candidate, other[0].candidate) else NEARLY
    return (worse.share <= worse.se and little) or other[1].size[1] > share * best[1].size[1]


def _constant_part(spring: TriedChange, offset: TriedChange) -> bool:
    """Whether the second is the constant torque that the first, a spring, has in it, on the same joints."""
    return (spring.kind, offset.kind) == ("spring", "offset") and set(spring.places) <= set(offset.places)
