"""Variance of errors that repeat with a periodic motion, which clusters of time blocks treat as independent.

An encoder's ripple and its rounding, the sampling of reversals and what the model lacks depend on the state. Where the
motion is periodic they are the same in every period: their effect does not fall with the number of periods, and the
scatter of time blocks does not show it. Scores are therefore summed over all periods, phase by phase. Their scatter
over the phases, beyond what the scores of single periods explain, is variance that time blocks lack.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.estimation.block_moments import Adjustment
from haptid.motion.motion import Motion
from haptid.motion.periods import motion_period
from haptid.observation.augmented import ResidualContext
from haptid.observation.rows import Chunk, chunks_of
from haptid.treatment_choice.delay_columns import delay_columns
from haptid.treatment_choice.delay_estimate import Delays, delay_prior
from haptid.treatment_choice.first_fit import residual_memory
from haptid.treatment_choice.nuisance_problem import NuisanceColumn

# Parts of a period, at least and at most; groups of periods, at most.
_FEWEST, _PHASES, _GROUPS = 6, 48, 32
# Random signs of the scores, and the standard deviations above their mean from which on errors count as repeated.
_SIGNS, _BEYOND = 40, 2.0
# Numbers (rows times columns, of all motors) of a motion that are used, at most.
_ENOUGH = 1 << 21


@dataclass(frozen=True, eq=False)
class _Scores:
    """Scores of a motion's rows by part of the period and by period.

    Coordinates are those of the fit, in which the information of its parameters is the unit matrix, and the delays.

    Attributes:
        s: sums over the rows of a part in a group of periods, (phases, groups, k).
        G: information of each part, (phases, k, k).
        rows: share of the motion's rows that they are of.
    """

    s: Array
    G: Array
    rows: float

    @property
    def repeated(self) -> bool:
        """Whether scores of one part of different periods add up beyond chance."""
        rng = np.random.default_rng(0)
        signs = rng.choice([-1.0, 1.0], size=(_SIGNS, *self.s.shape[:2]))
        chance = [float(np.sum(np.einsum("pn,pnk->pk", sign, self.s) ** 2)) for sign in signs]
        return bool(np.sum(self.s.sum(axis=1) ** 2) > np.mean(chance) + _BEYOND * np.std(chance))

    def shifts(self, root: Array, prior: Array) -> Array:
        """Shift of the parameters and delays by the errors of each part, (phases, p + delays), SI.

        Args:
            root: parameters from the fit's coordinates, (p, coordinates of the fit).
            prior: inverse of the delays' prior covariance, (delays, delays), s^-2.
        """
        own, k = root.shape[1], self.G.shape[1]
        seen = self.G.sum(axis=0) / self.rows
        # Other rows have the rest of the fit's information. These may be too few to tell it, and show more than all.
        values, vectors = linalg.eigh(np.eye(own) - seen[:own, :own])
        rest = (vectors * np.maximum(values, 0.0)) @ vectors.T
        information = seen + (linalg.block_diag(rest, prior) if k > own else rest)
        joint = linalg.inv(linalg.cholesky(information))  # lower: its rows are the joint coordinates
        adjustment = Adjustment.of(joint.T @ self.G @ joint / self.rows)
        move = np.concatenate([root @ joint[:own], joint[own:]])
        single, summed = self.s @ joint, self.s.sum(axis=1) @ joint
        by_chance = ((single @ move.T) ** 2).sum(axis=(0, 1))
        whole = ((summed @ move.T) ** 2).sum(axis=0)
        beyond = 1 - np.divide(by_chance, whole, out=np.ones_like(whole), where=whole > 0)
        return np.asarray(adjustment.times(summed) @ move.T * np.sqrt(np.maximum(beyond, 0.0)) / self.rows)


def repeated_errors(estimate: Estimate, delays: Delays | None) -> Array | None:
    """By how much errors of each part of the period move the estimates, (parts, p + delays), SI; None without any.

    Delays that were estimated from the same rows take part: the parameters move with them.

    Args:
        estimate: of rows of logs.
        delays: of the torque channels, as estimated; None where they were given.
    """
    observation, root = estimate.observation, estimate.fit.solution.root
    shared = delays is not None and delays.accepted and observation.change is None
    prior = (
        linalg.inv(delay_prior(len(delays.seconds), delays.dt)) if delays is not None and shared else np.zeros((0, 0))
    )
    found = []
    for motion in observation.motions:
        length = motion_period(motion)
        if length is None:
            continue
        many = len(prior) if not motion.treatment.momentum else 0
        scores = _scores(estimate, motion, length, many, delays.noise_hz if delays is not None else np.inf)
        if scores is not None and scores.repeated:
            found.append(scores.shifts(root, prior))
    return np.concatenate(found) if found else None


def _scores(estimate: Estimate, motion: Motion, length: float, delays: int, noise_hz: float) -> _Scores | None:
    """Those of one motion with a period, s; None where a period is too short to be divided."""
    memory = residual_memory(estimate.model, [motion], estimate.free)
    phases = int(min(length / max(memory, motion.dt * motion.treatment.decimation), _PHASES))
    if phases < _FEWEST:
        return None
    start, seconds = float(motion.t0), len(motion) * motion.dt
    groups = max(1, min(_GROUPS, int(seconds / length)))
    k = estimate.fit.solution.root.shape[1] + delays
    observation = estimate.observation
    # Parts of a log between gaps have one name.
    end = float(motion.times(np.array([len(motion) - 1]))[0])
    middles = [(block.log, 0.5 * (block.start + block.stop)) for block in observation.blocks]
    blocks = np.array([j for j, (log, middle) in enumerate(middles) if log == motion.name and start <= middle <= end])
    if not blocks.size:
        return None
    numbers = k * sum(int(motor.rows[blocks].sum()) for motor in observation.motors)
    some = blocks[: max(1, int(len(blocks) * min(1.0, _ENOUGH / max(numbers, 1))))]
    s, G = np.zeros((phases, groups, k)), np.zeros((phases, k, k))
    columns = delay_columns(estimate.model, motion, noise_hz=noise_hz) if delays else []
    for chunk in chunks_of(observation.pick(some)):
        turns = (chunk.t - start) / length
        part = (turns % 1 * phases).astype(int) % phases
        group = np.minimum((turns * length / seconds * groups).astype(int), groups - 1)
        cell = part * groups + group
        order = np.argsort(cell, kind="stable")
        cells, first = np.unique(cell[order], return_index=True)
        edges = np.searchsorted(part[order], np.arange(phases + 1))
        for U, e in _weighted(chunk, estimate, columns, delays):
            ordered = U[order]
            s.reshape(-1, k)[cells] += np.add.reduceat(ordered * e[order][:, None], first, axis=0)
            for one, (low, high) in enumerate(pairwise(edges)):
                G[one] += ordered[low:high].T @ ordered[low:high]
    return _Scores(s, G, len(some) / len(blocks))


def _weighted(
    chunk: Chunk, estimate: Estimate, columns: list[NuisanceColumn], delays: int
) -> list[tuple[Array, Array]]:
    """Weighted rows (rows, k) and residual (rows,) of each motor."""
    W, e = chunk.W @ estimate.fit.solution.root, chunk.residual(estimate.free)
    if delays:
        low, high = chunk.plan.window(chunk.start, chunk.stop)
        context = ResidualContext(chunk.plan, raw_parameters(estimate.model, estimate.free), low, high, chunk.signals)
        D = np.zeros((*W.shape[:2], delays))
        for channel, column in columns:
            D[:, :, channel] += chunk.treated(column.weights[:, None] * column.values(context)) * chunk.used
        W = np.concatenate([W, D], axis=2)
    return [(w * own, w * error) for w, own, error in zip(estimate.weights, W, e, strict=True)]
