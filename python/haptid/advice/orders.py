"""Channels in another order of the joints than the device file's: each order is tried as a whole.

Files and columns in the order of the alphabet, or from the hand to the base, put every joint's position and torque to
another joint. No single change of a channel mends that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.edits import Edit
from haptid.advice.rows import trial_rows
from haptid.advice.search import finer
from haptid.advice.sides import OtherAssumption, compared
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.inference.diagnosis.finding import joined_names
from haptid.inference.diagnosis.subsample import MOST_SAMPLES
from haptid.motion.motion import Motion, with_delay

# The most joints of which every order is tried; of more, exchanges of two, rotations and the reverse.
_ALL_ORDERS = 4


@dataclass(frozen=True, eq=False)
class OtherOrder(OtherAssumption):
    """An order of the channels.

    Attributes:
        order: the joint whose channels each joint takes, by index among the active ones.
        joints: names of the active joints.
    """

    order: tuple[int, ...]
    joints: tuple[str, ...]

    @property
    def places(self) -> tuple[str, ...]:
        """The joints that take the channels of others."""
        return tuple(f"joint {self.joints[k]}" for k, own in enumerate(self.order) if k != own)

    @property
    def words(self) -> str:
        """Whose channels they take."""
        taken = [f"joint {self.joints[own]}" for k, own in enumerate(self.order) if k != own]
        return f"{joined_names(self.places, most=8)} those that are now of {joined_names(taken, most=8)}"

    @property
    def edits(self) -> tuple[Edit, ...]:
        """Of the study: exchanges that lead to the order."""
        return tuple(
            Edit("study", "exchange", ("channels", key), [*pair])
            for key in ("position", "torque")
            for pair in _exchanges(self.order)
        )


def other_order(model: DynamicModel, motions: Sequence[Motion], beta: Array, zero: Sequence[int]) -> OtherOrder | None:
    """The order of the largest proven gain; None where none is proven, or joints and motors are not one to one.

    Args:
        motions: treated signals of the fit.
        beta: base parameters, (p,), SI.
        zero: those parameters that are fixed at zero.
    """
    if sum(map(len, motions)) > MOST_SAMPLES or not one_to_one(model, motions):
        return None
    now = [undelayed(finer(motion)) for motion in motions]
    rows, start = trial_rows(model, now, beta), np.zeros(len(beta))
    kept = np.array([k for k in range(len(beta)) if k not in zero])
    joints = tuple(model.device.joints[k].name for k in model.device.active)
    tried = []
    for order in _orders([model.device.joints[k].prismatic for k in model.device.active]):
        try:
            there = trial_rows(model, [_reordered(motion, order) for motion in now], start, (), now)
        except HaptidError:
            continue
        if there.used.shape == rows.used.shape:
            _, figures = compared(model, (rows, there), (beta, start), (kept, kept))
            tried.append(OtherOrder(*figures, order, joints))
    return max((one for one in tried if one.proven(len(tried))), key=lambda one: one.gain.share, default=None)


def one_to_one(model: DynamicModel, motions: Sequence[Motion]) -> bool:
    """Whether there are several joints, each with a channel of position and one of torque of its own motor."""
    count = len(model.device.active)
    rows = [np.flatnonzero(motor.row).tolist() for motor in model.device.motors]
    own = rows == [[k] for k in model.device.active] and len(model.measured_rows) == count
    return count > 1 and own and all(m.q.shape[1] == m.tau.shape[1] == count for m in motions)


def _orders(prismatic: Sequence[bool]) -> Iterator[tuple[int, ...]]:
    """Orders other than the present one in which angles stay angles."""
    count = len(prismatic)
    every: dict[tuple[int, ...], None] = {}
    if count <= _ALL_ORDERS:
        every = dict.fromkeys(permutations(range(count)))
    else:
        for i, j in combinations(range(count), 2):
            one = list(range(count))
            one[i], one[j] = j, i
            every[tuple(one)] = None
        every |= {tuple((k + by) % count for k in range(count)): None for by in range(1, count)}
        every[tuple(reversed(range(count)))] = None
    for order in every:
        if order != tuple(range(count)) and [prismatic[k] for k in order] == list(prismatic):
            yield order


def _exchanges(order: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Exchanges of two entries that bring a list into this order, one after the other."""
    now = list(range(len(order)))
    for k, wanted in enumerate(order):
        at = now.index(wanted)
        if at != k:
            now[k], now[at] = now[at], now[k]
            yield k, at


def undelayed(motion: Motion) -> Motion:
    """The motion with the delay of a command that is held, the log's torques: that of a wrong model is none."""
    return motion if motion.log is None else with_delay(motion, 0.5 * motion.dt)


def _reordered(motion: Motion, order: Sequence[int]) -> Motion:
    """The motion with positions, torques and the speeds that count as slow in another order."""
    made = undelayed(motion)
    index, slow = list(order), np.asarray(motion.treatment.reversal_speed)
    if slow.ndim:
        made = replace(made, treatment=replace(made.treatment, reversal_speed=tuple(slow[index].tolist())))
    rates = made.rates and (made.rates[0][:, index], made.rates[1][:, index])
    return replace(made, q=np.array(made.q)[:, index], tau=np.array(made.tau)[:, index], rates=rates, _shared={})
