"""Angles counted from other zeros, or in other directions, than the device file's: quarter turns, joint by joint.

A controller's zero is often a quarter turn from that of the robot's description, such as upright in place of stretched
out, and its axis may point the other way. The torque is then that of another arm, which no small correction mends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, product

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.edits import Edit
from haptid.advice.orders import one_to_one, undelayed
from haptid.advice.rows import TrialRows, trial_rows
from haptid.advice.search import LARGE_GAIN, LEAST_SE, finer, large_enough
from haptid.advice.sides import OtherAssumption, agreement, compared, trials_of
from haptid.advice.trial import Gain, Trial, gain
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.inference.diagnosis.finding import SIGNIFICANCE, joined_names
from haptid.motion.motion import Motion, treat
from haptid.treatment_choice.motion_filters import HIGHEST, HIGHEST_PARALLEL

# Samples of the log that a trial passes over, and rows of it, at most: there are dozens of trials.
_SAMPLES, _ROWS = 20_000, 4000
# Cut-off of the parallel filter, at least, over the bandwidth of the motion.
_PASSED = 3.0
# Steps of a search, at most.
_MOST_STEPS = 6

# Direction, 1 or -1, and quarter turns of one joint.
Count = tuple[int, int]
_SAME: Count = (1, 0)


@dataclass(frozen=True, eq=False)
class OtherCounts(OtherAssumption):
    """How the log counts the joints' positions.

    Attributes:
        counts: of each active joint: the device's angle is direction times the log's, plus quarter turns.
        joints: names of the active joints.
        rivals: what predicts unseen blocks as well.
        edits: of the study.
    """

    counts: tuple[Count, ...]
    joints: tuple[str, ...]
    rivals: tuple[str, ...]
    edits: tuple[Edit, ...]

    @property
    def places(self) -> tuple[str, ...]:
        """Joints that are counted otherwise."""
        return tuple(f"joint {name}" for name, count in zip(self.joints, self.counts, strict=True) if count != _SAME)

    @property
    def words(self) -> str:
        """What to do."""
        return _words(self.joints, self.counts)


@dataclass(frozen=True, eq=False)
class _Step:
    """A change of one joint or two, with its gain over what was chosen before."""

    counts: tuple[Count, ...]
    rows: TrialRows
    trial: Trial
    gain: Gain
    agreement: float

    @property
    def simplicity(self) -> tuple[float, int, int]:
        """What is chosen of those alike: the agreement with the bodies, fewer directions, smaller turns."""
        turned = sum(direction < 0 for direction, _ in self.counts)
        return round(self.agreement, 2), -turned, -sum(abs(_signed(turns)) for _, turns in self.counts)


def other_counts(
    model: DynamicModel, motions: Sequence[Motion], beta: Array, zero: Sequence[int], bandwidth_hz: float
) -> OtherCounts | None:
    """Zeros and directions of the joints with which unseen blocks are predicted; None where none is proven.

    Step by step one joint gets the change that is best with those before it; where none is proven, two neighbours do.

    Args:
        motions: treated signals of the fit.
        beta: base parameters, (p,), SI.
        zero: those parameters that are fixed at zero.
        bandwidth_hz: of the motion.
    """
    turning = [not model.device.joints[k].prismatic for k in model.device.active]
    sides = {m.log.channels.position.side for m in motions if m.log is not None}
    if zero or not sides <= {"joint"}:
        return None
    directed = one_to_one(model, motions)
    chosen: tuple[Count, ...] = (_SAME,) * len(turning)
    # Delayed once: each trial would compute all torques of a long log again.
    now = [_counted(undelayed(finer(with_all_motion(motion, bandwidth_hz))), chosen) for motion in motions]
    most = min(_SAMPLES, _ROWS * max(motion.treatment.decimation for motion in now))
    rows = first = trial_rows(model, now, beta, most=most)
    tried, rivals = 0, list[str]()
    names = tuple(model.device.joints[k].name for k in model.device.active)
    for _ in range(_MOST_STEPS):
        steps = list[_Step]()
        for changes in (_singles(chosen, turning, directed), _pairs(chosen, turning)):
            every = list(changes)
            tried += len(every)
            steps = _steps(model, now, rows, every, most)
            if steps:
                break
        if not steps:
            break
        best, alike = _best(steps)
        rivals = [_words(names, one.counts) for one in alike if not _adds_turns(one.counts, best.counts)]
        chosen, rows = best.counts, best.rows
    if rows is first:
        return None
    kept = np.arange(len(beta))
    _, figures = compared(model, (first, rows), (beta, np.zeros(len(beta))), (kept, kept))
    log = motions[0].log
    edits = tuple(_edits(chosen, log is not None and log.channels.velocity is not None))
    found = OtherCounts(*figures, chosen, names, tuple(rivals), edits)
    return found if found.proven(tried) else None


def _singles(chosen: Sequence[Count], turning: Sequence[bool], directed: bool) -> Iterator[tuple[Count, ...]]:
    """With another count of one joint."""
    for k, count in enumerate(chosen):
        for other in product((1, -1) if directed else (1,), range(4) if turning[k] else (0,)):
            if other != count:
                yield (*chosen[:k], other, *chosen[k + 1 :])


def _pairs(chosen: Sequence[Count], turning: Sequence[bool]) -> Iterator[tuple[Count, ...]]:
    """With other zeros of two neighbours: where one is turned back by the other, neither alone is right."""
    for i, j in pairwise(range(len(chosen))):
        if turning[i] and turning[j]:
            for turns in product((1, 2, 3), repeat=2):
                both = ((chosen[k][0], (chosen[k][1] + by) % 4) for k, by in zip((i, j), turns, strict=True))
                yield (*chosen[:i], *both, *chosen[j + 1 :])


def _steps(
    model: DynamicModel, now: Sequence[Motion], rows: TrialRows, changes: Sequence[tuple[Count, ...]], most: int
) -> list[_Step]:
    """Changes of a large, significant gain over rows, computed from at most `most` samples."""
    made, start = list[_Step](), np.zeros(len(model.base))
    for counts in changes:
        try:
            there = trial_rows(model, [_counted(motion, counts) for motion in now], start, (), now, most)
        except HaptidError:
            continue
        if there.used.shape == rows.used.shape:
            before, trial = _by_residual(rows, there, start)
            gained = gain(before, trial)
            large = gained.share > LARGE_GAIN and large_enough(gained)
            if large and gained.p * len(changes) < SIGNIFICANCE:
                made.append(_Step(counts, there, trial, gained, agreement(model, there)))
    return made


def _by_residual(rows: TrialRows, there: TrialRows, start: Array) -> tuple[Trial, Trial]:
    """The fits of two counts, with errors over each motor's before: a wrong wrist hides what a shoulder gains."""
    kept = np.arange(len(start))
    trials = [
        replace(trial, errors=trial.errors / bench.weights**2)
        for bench, trial in trials_of((rows, there), (start, start), (kept, kept))
    ]
    own = np.maximum(trials[0].errors.sum(axis=0), np.finfo(float).tiny) * rows.y.shape[0]
    return replace(trials[0], errors=trials[0].errors / own), replace(trials[1], errors=trials[1].errors / own)


def _best(steps: Sequence[_Step]) -> tuple[_Step, list[_Step]]:
    """The step of the largest gain, or a plainer one that predicts as well; and the others that do."""
    first = max(steps, key=lambda one: one.gain.share)
    losses = [(one, gain(one.trial, first.trial)) for one in steps if one is not first]
    alike = [first, *(one for one, loss in losses if loss.share <= LEAST_SE * loss.se)]
    best = max(alike, key=lambda one: one.simplicity)
    return best, [one for one in alike if one is not best]


def with_all_motion(motion: Motion, bandwidth_hz: float) -> Motion:
    """The motion behind filters that pass all of it: for a wrong model a lower one seems better."""
    now = motion.treatment
    if motion.log is None or now.cutoff_hz is None or not now.parallel_cutoff_hz:
        return motion
    position, torque = np.atleast_1d(now.cutoff_hz), now.parallel_cutoff_hz
    # Logs of a fit may have different rates: no wider than this one's carries.
    factor = min(_PASSED * bandwidth_hz, HIGHEST_PARALLEL / motion.dt) / torque
    factor = min(factor, HIGHEST / motion.dt / float(position.max()))
    if factor <= 1.0:
        return motion
    wider = tuple((factor * position).tolist())
    return treat(
        motion.log,
        replace(
            now,
            cutoff_hz=wider if len(wider) > 1 else wider[0],
            parallel_cutoff_hz=factor * torque,
            decimation=max(1, int(now.decimation / factor)),
        ),
    )


def _adds_turns(one: Sequence[Count], best: Sequence[Count]) -> bool:
    """Whether counts are the best ones with turns that other parameters absorb, such as those of the last joint."""
    return all(ours == (way, 0) or own == ours for own, ours, (way, _) in zip(one, best, one, strict=True))


def _counted(motion: Motion, counts: Sequence[Count]) -> Motion:
    """The motion with positions counted otherwise, and torques in the same directions."""
    direction = np.array([sign for sign, _ in counts], dtype=np.float64)
    turns = 0.5 * np.pi * np.array([quarters for _, quarters in counts])
    rates = motion.rates and (motion.rates[0] * direction, motion.rates[1] * direction)
    tau = np.asarray(motion.tau) if (direction > 0).all() else np.asarray(motion.tau) * direction
    return replace(motion, q=np.asarray(motion.q) * direction + turns, tau=tau, rates=rates, _shared={})


def _signed(turns: int) -> int:
    """Quarter turns between -1 and 2."""
    return turns - 4 if turns == 3 else turns


def _words(joints: Sequence[str], counts: Sequence[Count]) -> str:
    """What to do with the channels of each joint, the same of several joints together."""
    ways: dict[Count, list[str]] = {}
    for name, count in zip(joints, counts, strict=True):
        if count != _SAME:
            ways.setdefault(count, []).append(f"joint {name}")
    made = []
    for (direction, turns), places in ways.items():
        where, add = joined_names(places, most=8), f"add {90 * _signed(turns)} deg to"
        if direction > 0:
            made.append(f"{add} the position of {where}")
        else:
            made.append(f"reverse position and torque of {where}{f', and {add} the position' if turns else ''}")
    return joined_names(made, most=8)


def _edits(counts: Sequence[Count], velocity: bool) -> Iterator[Edit]:
    """Of the study.

    Args:
        velocity: whether it has channels of velocities.
    """
    for k, (direction, turns) in enumerate(counts):
        if direction < 0:
            signals = ("position", "torque", *(("velocity",) if velocity else ()))
            for signal, key in product(signals, ("gain", "offset")):
                yield Edit("study", "multiply", ("channels", signal, key), -1.0, k)
        if turns:
            yield Edit("study", "add", ("channels", "position", "offset"), 0.5 * np.pi * _signed(turns), k)
