"""Regressor and reduction beside peers that do the same work, and how far both are from the machine's own limits.

A 7-joint arm with 43 base columns. One thread, in a process of its own, since threads are counted once; then the same
on two. Operations of the regressor are those of CasADi's code for the same recursion; those of the reduction are of a
Householder reflection of p + 1 columns below a triangle, 2 (p + 1)^2 for every row.
"""

from __future__ import annotations

import json
import os
import time

import numpy as np
from scipy import linalg

from arm import ALONE, IN_CACHE, SAMPLES, Arm
from closed_chain import Closed
from compare_peers import alone, compared
from limits import limits
from stopwatch import Work

THREADS = 2
# Regressors that peers store, of the same samples; see `peers/common.py`.
MANY = 2048
ROBOTS = ("Pinocchio C++", "Pinocchio Python", "CasADi C", "iDynTree", "figaroh")
ALGEBRA = ("NumPy", "NumPy by blocks", "SciPy")


def run() -> dict[str, float]:
    """Microseconds per sample, ratios to the peers, and shares of the limits."""
    one, more = alone(__file__, 1), alone(__file__, THREADS)
    for work in (work for work in more if work in one):
        name, _, _ = work.partition(": ")
        one[f"{name}, {THREADS} threads: haptid, us"] = more[work]
        one[f"{name}, {THREADS} threads: one thread over haptid"] = one[work] / more[work]
    return one | shares(one)


def shares(found: dict[str, float]) -> dict[str, float]:
    """Operations and bytes in a second, and their shares of the limits, per cent; where CasADi counted them."""
    made: dict[str, float] = {}
    if "memory fill, GB/s" not in found:
        return made
    counted = found.get("regressor in cache: operations per sample")
    if counted is not None:
        both = counted + found["reduction: operations per sample"]
        for work, operations in (("regressor in cache", counted), (f"regressor and reduction of {SAMPLES}", both)):
            speed = 1e-3 * operations / found[f"{work}: haptid, us"]
            made[f"{work}: GF/s"] = speed
            made[f"{work}: share of the multiply-add peak, %"] = 100 * speed / found["multiply-add peak, GF/s"]
    speed = 1e-3 * found["regressor, stored: bytes per sample"] / found[f"regressor of {SAMPLES}, stored: haptid, us"]
    made["regressor, stored: GB/s"] = speed
    return made | {"regressor, stored: share of memory fill, %": 100 * speed / found["memory fill, GB/s"]}


def regressor(arm: Arm | Closed, samples: int) -> Work:
    """Into memory that is there, as an earlier call returned it."""
    motion = arm.motion(samples)
    out = arm.core.regressor(*motion, arm.columns)
    return Work(samples, lambda: arm.core.regressor(*motion, arm.columns, None, out), arm.wanted)


def reduction(arm: Arm, samples: int) -> Work:
    """All rows in one block, without filter; the inner products of W and the torque are compared."""
    tau, weights = np.ascontiguousarray(arm.tau[:, :samples]), np.ones((arm.n, samples))
    some = (*arm.motion(samples), tau, arm.columns, np.ones(1), 1, 0, samples, samples, weights)
    return Work(samples, lambda: arm.core.reduce(*some), lambda made: products(stacked(arm, made)))


def solution(arm: Arm, samples: int) -> Work:
    """The same, and the parameters from the triangles."""
    reduce = reduction(arm, samples)

    def solved() -> np.ndarray:
        R = linalg.qr(stacked(arm, reduce.run()), mode="r")[0]
        p = len(arm.columns)
        return np.asarray(linalg.solve_triangular(R[:p, :p], R[:p, p]))

    return Work(samples, solved)


def stacked(arm: Arm, made: list[tuple[list[int], np.ndarray]]) -> np.ndarray:
    """All motors' triangles over all columns, one below the other."""
    p, parts = len(arm.columns), []
    for reached, triangles in made:
        wide = np.zeros((len(reached) + 1, p + 1))
        wide[:, [*reached, p]] = triangles[0]
        parts.append(wide)
    return np.concatenate(parts)


def products(R: np.ndarray) -> np.ndarray:
    """Inner products of the columns."""
    return R.T @ R


def observation(arm: Arm, samples: int) -> np.ndarray:
    """W and the torques beside it, as a user would stack them."""
    Y = arm.core.regressor(*arm.motion(samples), arm.columns)
    return np.column_stack([np.concatenate([*Y.transpose(0, 2, 1)]), arm.tau[:, :samples].ravel()])


def closed_chain() -> dict[str, float]:
    """Regressors of a chain with loops; those of peers are of its tree, the projection left to be done."""
    chain = Closed()
    ours = {"regressor in cache": regressor(chain, IN_CACHE), "regressor, stored": regressor(chain, MANY)}
    found = compared(chain.case(), ours, ("Pinocchio C++", "Pinocchio Python", "figaroh"))
    return {f"closed chain, {name}": figure for name, figure in found.items()}


def main() -> None:
    """With the threads that this process has; JSON."""
    arm = Arm()
    long = {
        f"regressor of {SAMPLES}, stored": regressor(arm, SAMPLES),
        f"regressor and reduction of {SAMPLES}": reduction(arm, SAMPLES),
    }
    figures = {f"{work}: haptid, us": one.microseconds(time.perf_counter) for work, one in long.items()}
    if os.environ["RAYON_NUM_THREADS"] == "1":
        ours = {
            "regressor in cache": regressor(arm, IN_CACHE),
            "regressor, stored": regressor(arm, MANY),
            "regressor and reduction": reduction(arm, ALONE),
            "regressor to solution": solution(arm, ALONE),
        }
        figures |= compared(arm.case() | {"W": observation(arm, ALONE)}, ours, (*ROBOTS, *ALGEBRA)) | limits()
        figures |= closed_chain()
        figures["regressor, stored: bytes per sample"] = 8.0 * arm.reached.sum()
        figures["reduction: operations per sample"] = float(2 * ((arm.reached.sum(axis=1) + 1) ** 2).sum())
        figures["base columns"] = float(len(arm.columns))
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
