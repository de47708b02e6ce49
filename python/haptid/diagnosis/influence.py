"""Which second of the log decides, and whether its first half agrees with its last."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from haptid._values import Array
from haptid.comparison import compare
from haptid.diagnosis.finding import LEVEL, Finding, Status, listed
from haptid.diagnosis.widened import stack
from haptid.errors import EstimationError
from haptid.estimators import WLS, Estimate, estimate

# A block that moves an estimate by more than one deviation of all the others' doing deserves a look; beyond three, the
# estimate is that block's word against theirs (after Belsley, Kuh and Welsch 1980, section 2.1).
LOOK, DECIDES = 1.0, 3.0
# Halves of a log with fewer blocks are not compared.
FEWEST_BLOCKS = 8
# Half of the estimate changed is a drift that matters.
MATTERS = 0.5


def shifts(made: Estimate) -> Array:
    """How the estimate moves without each block of all motors together, (blocks, p), SI; infinite if it cannot be."""
    observation, p = made.observation, len(made.beta)
    whole = stack(observation.motors, made.weights, p)
    R = whole[:-1, :-1]
    inverse, beta = linalg.solve_triangular(R, np.eye(p)), linalg.solve_triangular(R, whole[:-1, -1])
    blocks = len(observation.blocks)
    A, b = np.zeros((blocks, p, p)), np.zeros((blocks, p))
    for motor, weight in zip(observation.motors, made.weights, strict=True):
        T = motor.triangles * weight
        U = T[:, :, :-1] @ inverse[motor.columns]
        e = T[:, :, -1] - T[:, :, :-1] @ beta[motor.columns]
        A += U.transpose(0, 2, 1) @ U
        b += np.einsum("bij,bi->bj", U, e)
    values, vectors = np.linalg.eigh(A)
    with np.errstate(divide="ignore"):
        scale = 1.0 / np.maximum(1.0 - values, 0.0)
    moved = np.einsum("bij,bj->bi", vectors.transpose(0, 2, 1), b) * np.minimum(scale, 1e12)
    return np.asarray(-np.einsum("bij,bj->bi", vectors, moved) @ inverse.T)


def influence(made: Estimate) -> Finding:
    """The block without which an estimate moves most, beside what all other blocks do to it."""
    moved = shifts(made)
    power = (moved**2).sum(axis=0)
    others = np.sqrt(np.maximum(power - moved**2, np.finfo(float).tiny))
    ratio = np.abs(moved) / others
    b, k = (int(i) for i in np.unravel_index(int(np.argmax(ratio)), ratio.shape))
    block, most = made.observation.blocks[b], float(ratio[b, k])
    name = made.base.names[k]
    figures = {"deviations": most, "start": block.start, "stop": block.stop, "shift": moved[b, k]}
    status: Status = "bad" if most > DECIDES else "doubt" if most > LOOK else "ok"
    where = f"{block.start:.1f} to {block.stop:.1f} s"
    if status == "ok":
        text = f"No stretch decides alone: the most is {most:.2g} deviations of {name}, {where} (limit {LOOK:g})."
        return Finding("influence", status, figures, text)
    text = (
        f"Without {where}, {name} moves by {most:.1f} deviations that all other stretches give it (limit {LOOK:g}): "
        f"look at the log there for a touch, an end stop or a jump; if nothing is wrong, record more such motion."
    )
    return Finding("influence", status, figures, text)


def drift(made: Estimate) -> Finding:
    """First half of the rows against the last, parameter by parameter (Welch's test, Holm's correction)."""
    blocks = len(made.observation.blocks)
    if blocks < 2 * FEWEST_BLOCKS:
        return Finding("drift", "ok", {"blocks": blocks}, f"{blocks} blocks are too few to look for a drift.")
    index = np.arange(blocks)
    halves = [made.observation.pick(index[index * 2 // blocks == half]) for half in (0, 1)]
    try:
        first, last = (estimate(half, WLS()) for half in halves)
        found = compare(first, last, confidence=1 - LEVEL)
    except EstimationError:
        return Finding("drift", "ok", {}, "Half of the log alone does not tell the parameters: no drift can be seen.")
    least = float(found.holm.min())
    if not found.differs:
        text = f"First and last half agree in all {len(found.names)} parameters (p = {least:.2g}, limit {LEVEL:g})."
        return Finding("drift", "ok", {"p": least}, text)
    k = int(np.argmin(found.p))
    share = float(np.abs(found.difference[k]) / max(abs(found.first[k]), abs(found.second[k])))
    figures = {"p": least, "first": found.first[k], "second": found.second[k], "share": share}
    text = (
        f"{listed(found.differs)} changed along the log: {found.names[k]} from {found.first[k]:.3g} to "
        f"{found.second[k]:.3g} {found.units[k]} (p = {least:.1e}, limit {LEVEL:g}). Warm the device up, check that "
        f"nothing slipped, and identify warm and cold apart."
    )
    return Finding("drift", "bad" if share > MATTERS else "doubt", figures, text)
