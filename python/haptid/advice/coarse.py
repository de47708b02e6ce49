"""Coarse torque channels: what their steps add to the error, measured with steps three times as coarse."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.advice.search import LEAST_GAIN, LEAST_SE, Trials, TriedChange
from haptid.advice.trial import Setting, Trial
from haptid.log import OnDisk
from haptid.motion.motion import Motion, with_delay

KIND = "coarse torque"
# Factor of the steps that are tried. A lattice of a third of the steps is in it, so that it is what a recorder with
# such steps would have written.
COARSER = 3
# What the squared error rises by, over what the steps of the log make of it. Their error has a twelfth of their square,
# over frequencies up to the rate at which the torque crosses them, so that what passes a filter below that grows with
# their third power (Bennett 1948, Bell System Technical Journal 27); with the second where noise exceeds the steps or
# the filter passes all, so that this is the least that they make.
RISES = COARSER**3 - 1


def with_coarse_torques(search: Trials) -> Trials:
    """The search with finer torque channels as a candidate, where steps three times as coarse raise unseen errors."""
    steps = {(log, fault.channel): fault.size for log, fault in search.faults if fault.kind == KIND}
    on_disk = any(motion.log is None or isinstance(motion.q, OnDisk) for motion in search.motions)
    if not steps or on_disk or search.torques.scales is None or not search.rows.movable:
        return search
    bench, setting, base = search.bench, Setting(rows=KIND), search.base()
    y = search.rows.torque_of([_coarser(motion, steps, k) for k, motion in enumerate(search.motions)])
    coarser = bench.with_rows(KIND, replace(search.rows, y=y).grams()).run(setting)
    made = (coarser.errors - base.errors) / RISES
    coarse = {motor for _, channel in steps for motor in search.torques.motors(channel)}
    which = tuple(_rising(made, base.errors, coarse))
    if not which:
        return search
    trial = Trial(setting, np.maximum(base.errors - made, 0.0), base.whole)
    bench = replace(bench.with_rows(KIND, bench.grams["used"]), known=bench.known | {setting: trial})
    labels = [search.model.device.row_labels[row] for row in search.model.known_rows]
    one = TriedChange(KIND, tuple(labels[k] for k in which), setting, indices=which)
    return replace(search, bench=bench, candidates=(*search.candidates, one))


def _coarser(motion: Motion, steps: dict[tuple[int, int], float], log: int) -> Array:
    """The torque channels of a motion with steps three times as coarse, those that are coarse, (n, channels)."""
    assert motion.log is not None
    torque = np.array(motion.log.torque)
    for (number, channel), step in steps.items():
        if number == log:
            torque[:, channel] = COARSER * step * np.round(torque[:, channel] / (COARSER * step))
    coarse = replace(motion, log=replace(motion.log, torque=torque))
    return np.asarray(with_delay(coarse, motion.treatment.torque_delay_s).tau)


def _rising(made: Array, errors: Array, motors: set[int]) -> Iterator[int]:
    """Motors whose own error rises with their steps, from what these make of each block's error, (blocks, motors)."""
    spread = np.sqrt(len(made)) * made.std(axis=0, ddof=1)
    for k in sorted(motors):
        if made[:, k].sum() > max(LEAST_SE * spread[k], LEAST_GAIN * errors[:, k].sum()):
            yield k
