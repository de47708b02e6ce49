"""Influential blocks (deletion diagnostics), and drift between the halves of the log."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.errors import EstimationError
from haptid.estimation import WLS, Estimate, Restricted, estimate
from haptid.estimation.block_moments import ALONE
from haptid.estimation.least_squares import solve
from haptid.inference.diagnosis.finding import SIGNIFICANCE, Finding, joined_names
from haptid.uncertainty.distributions import t_tail

# Shift of an estimate without a block, in standard errors due to all other blocks: worth a look, and too large.
LOOK, DECIDES = 1.0, 2.0
# Smallest sum of squares used as a divisor.
_TINY = float(np.finfo(float).tiny)
# Halves of a log with fewer blocks are not compared.
_FEWEST_BLOCKS = 8
# Relative change of a parameter along the log: below the first it is ignored, above the second it is large.
SMALL, MATTERS = 0.02, 0.5


@dataclass(frozen=True, eq=False)
class Deletions:
    """Effect of deleting each block of all motors.

    Attributes:
        shift: of the estimate, (blocks, p), SI.
        expected: variance of that shift for homogeneous rows, up to one factor for each parameter, (blocks, p).
    """

    shift: Array
    expected: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "shift", "expected")

    @property
    def ratio(self) -> Array:
        """Each shift in standard errors due to all other blocks, (blocks, p)."""
        return np.asarray(np.abs(self.shift) / np.sqrt(_others(self.shift**2)))

    @property
    def p(self) -> Array:
        """p-value of each shift by itself: Student's t, deletion by deletion, (blocks, p)."""
        rest = _others(self.expected)
        variance = self.expected * _others(self.shift**2) / rest
        dof = np.maximum(rest**2 / _others(self.expected**2) - 1.0, 1.0)
        return np.asarray(2 * t_tail(np.abs(self.shift) / np.sqrt(np.maximum(variance, _TINY)), dof))


def _others(values: Array) -> Array:
    """Sum over all other blocks, (blocks, p)."""
    return np.asarray(np.maximum(values.sum(axis=0) - values, _TINY))


def deletions(fitted: Estimate) -> Deletions:
    """Delete each block of all motors (Belsley, Kuh and Welsch 1980, section 2.1, for blocks of rows)."""
    observation = fitted.observation
    solution = solve(observation, fitted.weights, fitted.zero)
    k, blocks = len(solution.R), len(observation.blocks)
    A, b = np.zeros((blocks, k, k)), np.zeros((blocks, k))
    for motor, weight in zip(observation.motors, fitted.weights, strict=True):
        T = motor.r_factors * weight
        U = T[:, :, :-1] @ solution.root[motor.columns]
        e = T[:, :, -1] - T[:, :, :-1] @ solution.beta[motor.columns]
        A += U.transpose(0, 2, 1) @ U
        b += np.einsum("bij,bi->bj", U, e)
    # Without the block: (I - U'U)^-1 U'e, whose variance is U'U (I - U'U)^-1 for homogeneous rows.
    values, vectors = np.linalg.eigh(A)
    values = np.clip(values, 0.0, ALONE)
    shape = solution.root @ vectors
    moved = np.einsum("bij,bi->bj", vectors, b) / (1.0 - values)
    return Deletions(-np.einsum("bij,bj->bi", shape, moved), np.einsum("bij,bj->bi", shape**2, values / (1.0 - values)))


def influence(fitted: Estimate) -> Finding:
    """The block whose deletion shifts an estimate more than the other blocks explain."""
    without = deletions(fitted)
    ratio, p = without.ratio, np.minimum(without.p * without.p.size, 1.0)
    odd = (p < SIGNIFICANCE) & (ratio > LOOK)
    b, k = (int(i) for i in np.unravel_index(int(np.argmax(np.where(odd, ratio, ratio * 1e-9))), ratio.shape))
    block, most, name = fitted.observation.blocks[b], float(ratio[b, k]), fitted.base.names[k]
    figures = {"standard_errors": most, "p": p[b, k], "start": block.start, "stop": block.stop}
    block_times = f"{block.start:.1f} to {block.stop:.1f} s"
    if not odd.any():
        text = (
            f"No single influential block: the largest shift is {most:.2g} standard errors of {name}, {block_times} "
            f"(limit {LOOK:g}; p = {p[b, k]:.2g}, limit {SIGNIFICANCE:g})."
        )
        return Finding("influence", "ok", figures, text)
    text = (
        f"Influential block: without {block_times}, {name} shifts by {most:.1f} standard errors due to all other "
        f"blocks (limit {LOOK:g}; p = {p[b, k]:.1e}, limit {SIGNIFICANCE:g}). Look at the log there for a contact, an "
        f"end stop or a jump, and cut it out; if nothing is wrong, record more such motion."
    )
    return Finding("influence", "bad" if most > DECIDES else "doubt", figures, text)


def parameter_drift(fitted: Estimate) -> Finding:
    """Do the parameters of the first and last half differ (Welch's test, Holm's correction)?"""
    blocks = len(fitted.observation.blocks)
    if blocks < 2 * _FEWEST_BLOCKS:
        return Finding("drift", "ok", {"blocks": blocks}, f"{blocks} blocks are too few for a test of drift.")
    index = np.arange(blocks)
    halves = [fitted.observation.pick(index[index * 2 // blocks == half]) for half in (0, 1)]
    method = WLS() if isinstance(fitted.method, Restricted) else fitted.method
    try:
        first, last = (estimate(half, method) for half in halves)
        # A comparison needs the tests of missing terms from this room.
        from haptid.inference.comparison import compare

        comparison = compare(first, last, confidence=1 - SIGNIFICANCE, joint=False)
    except EstimationError:
        return Finding("drift", "ok", {}, "The parameters are not identifiable from half of the log: no test of drift.")
    least = float(comparison.holm.min())
    if not comparison.differs:
        count = len(comparison.names)
        text = f"First and last half agree in all {count} parameters (p = {least:.2g}, limit {SIGNIFICANCE:g})."
        return Finding("drift", "ok", {"p": least}, text)
    k = int(np.argmin(comparison.p))
    share = float(np.abs(comparison.difference[k]) / max(abs(comparison.first[k]), abs(comparison.second[k])))
    figures = {"p": least, "first": comparison.first[k], "second": comparison.second[k], "share": share}
    if share < SMALL:
        changed = f"{100 * share:.1g} % only (limit {100 * SMALL:g} %)"
        text = f"{joined_names(comparison.differs)} changed along the log, but by {changed}."
        return Finding("drift", "ok", figures, text)
    text = (
        f"{joined_names(comparison.differs)} changed along the log: {comparison.names[k]} from "
        f"{comparison.first[k]:.4g} to {comparison.second[k]:.4g} {comparison.units[k]} (p = {least:.1e}, limit "
        f"{SIGNIFICANCE:g}). Warm the device up, check that nothing slipped, and identify warm and cold separately."
    )
    return Finding("drift", "bad" if share > MATTERS else "doubt", figures, text)
