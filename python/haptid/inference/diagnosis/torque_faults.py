"""Faults of the recorded torque that no residual names: a command at its limit now and then, and one that chatters.

Rows in which a command is clipped have a torque that did not act as commanded, and its filter carries it to their
neighbours. A controller that switches from sample to sample (sliding mode, friction compensation by the sign of a noisy
velocity) has torque far above the motion, which amplifiers follow in part only, and which excites what is elastic.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.inference.diagnosis.finding import Finding, Status, joined_names, worst
from haptid.motion.motion import Motion

# Samples in a row at its extreme from which on a torque is clipped there, and how many times as many samples it must
# have at the extremes as next to them: at the crest of a coarse sine there are few more.
CLIPPED_RUN, _RARER = 3, 4
# A torque chatters where it steps back and forth by this share of its root mean square or more, one step after the
# other, in this share of the samples.
_STEP, _OFTEN = 0.5, 0.005
# Share of the samples from which on a clipped torque is bad; noise chatters too, and is no fault of the model.
_MUCH_CLIPPED = 0.01
# Lengths of these steps, samples, and their share of the period of the parallel filter's cut-off at most: no motion
# turns within two of them, and what vibrates turns within more.
_LENGTHS, _OF_PERIOD = (1, 2), 1 / 12
# Samples of a log that are looked at, at most.
_ENOUGH = 1 << 20


def torque_faults(estimate: Estimate) -> Finding:
    """Clipped and chattering torque channels of the logs of an estimate."""
    faults, figures, grades = list[str](), dict[str, float](), list[Status]()
    logs = [(motion, motion.log) for motion in estimate.observation.motions if motion.log is not None]
    every = [np.asarray(log.torque[:_ENOUGH]).T for _, log in logs]
    for k, label in enumerate(logs[0][1].channels.torque.channels if logs else ()):
        torques = [channels[k] for channels in every]
        shares = [(clipped(tau).mean(), chatter(tau, m)) for tau, (m, _) in zip(torques, logs, strict=True)]
        at_limit, flips = (float(share) for share in np.max(shares, axis=0))
        figures |= {f"clipped {label}": at_limit, f"chatter {label}": flips}
        if at_limit > 0:
            grades.append("bad" if at_limit > _MUCH_CLIPPED else "doubt")
            top = float(max(np.abs(tau).max() for tau in torques))
            faults.append(
                f"{label} stays at its limit ({top:.3g}) in {100 * at_limit:.2g} % of the samples (move slower or with "
                f"less load, or leave these parts out with `exclude`)"
            )
        if flips > _OFTEN:
            grades.append("doubt")
            faults.append(
                f"{label} steps back and forth by half of its rms or more in {100 * flips:.2g} % of the samples (a "
                f"controller that chatters, or noise: soften the controller, or filter before sampling)"
            )
    sentence = f"{joined_names(faults)}." if faults else "No torque channel is clipped or chatters."
    return Finding("torque channels", worst(grades), figures, sentence)


def clipped(tau: Array) -> np.ndarray:
    """Samples in which a torque, (n,), stays at its extreme; none where values next to it are about as frequent."""
    at_limit = runs(tau == tau.min(), CLIPPED_RUN) | runs(tau == tau.max(), CLIPPED_RUN)
    if not at_limit.any():  # as of most channels; to count all values takes longer
        return np.asarray(at_limit)
    values, count = np.unique(tau, return_counts=True)
    if len(values) <= CLIPPED_RUN:
        return np.zeros_like(at_limit)
    return at_limit if at_limit.sum() > _RARER * (count[1] + count[-2]) else np.zeros_like(at_limit)


def chatter(tau: Array, motion: Motion) -> float:
    """Share of a torque's samples, (n,), in which it steps back and forth: the greatest of several lengths of steps."""
    least = _STEP * float(np.sqrt(np.mean(tau**2)))
    cutoff = motion.treatment.parallel(motion.dt) or 0.5 / motion.dt
    shares = [0.0]
    for k in _LENGTHS:
        if (k == 1 or k * cutoff * motion.dt <= _OF_PERIOD) and 2 * k < len(tau) and least > 0:
            step = tau[k:] - tau[:-k]
            first, second = step[:-k], step[k:]
            flips = (first * second < 0) & (np.minimum(np.abs(first), np.abs(second)) > least)
            shares.append(float(flips.mean()))
    return max(shares)


def runs(true: np.ndarray, least: int) -> np.ndarray:
    """Samples within runs of True of at least `least`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], true.astype(int), [0]]))).reshape(-1, 2)
    in_run = np.zeros(len(true), dtype=bool)
    for start, stop in edges[np.diff(edges)[:, 0] >= least]:
        in_run[start:stop] = True
    return in_run
