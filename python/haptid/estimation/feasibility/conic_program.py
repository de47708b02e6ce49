"""Small cone programmes: quadratic objective, conditions that are numbers or semidefinite matrices, by Clarabel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from haptid._internal.arrays import Array
from haptid.errors import UnsolvedError

# Tolerances of the solver on numbers near one; where rounding lets it come no further, what is still an answer.
TIGHT = 1e-11
ENOUGH = 1e-7
SOLVED = ("Solved", "AlmostSolved")


@dataclass(frozen=True, eq=False)
class Condition:
    """F v + f in a cone.

    Attributes:
        F, f: (rows, variables) and (rows,).
        matrix: whether the rows are the entries of a matrix that is to be positive semidefinite, or numbers that are
            not to be negative.
    """

    F: Array
    f: Array
    matrix: bool = False


def minimise(P: Array, q: Array, conditions: Sequence[Condition]) -> tuple[Array, tuple[Array, ...]]:
    """The v that minimises v'P v / 2 + q'v under conditions, and the multiplier of each condition.

    Source: Goulart and Chen (2024), Clarabel: an interior-point solver for conic programs with quadratic objectives.

    Args:
        P: positive semidefinite, (variables, variables).
        q: (variables,).
        conditions: at least one.

    Raises:
        UnsolvedError: the solver stopped before it had an answer.
    """
    cones = [clarabel.PSDTriangleConeT(4) if c.matrix else clarabel.NonnegativeConeT(len(c.f)) for c in conditions]
    A = sparse.csc_matrix(np.concatenate([-c.F for c in conditions]))
    b = np.concatenate([c.f for c in conditions])
    # On the border of what is possible the solver may get stuck in one scaling of the rows, and not in the other.
    for equilibrate in (True, False):
        solver = clarabel.DefaultSolver(sparse.csc_matrix(np.triu(P)), q, A, b, cones, settings(equilibrate))
        answer = solver.solve()
        if str(answer.status) in SOLVED:
            ends = np.cumsum([len(c.f) for c in conditions])[:-1]
            return np.array(answer.x), tuple(np.split(np.array(answer.z), ends))
    raise UnsolvedError(str(answer.status), answer.iterations)


def settings(equilibrate: bool) -> clarabel.DefaultSettings:
    """Silent, on one thread, tight where it can be; with rows and columns scaled to one size or as they are."""
    made = clarabel.DefaultSettings()
    made.verbose = False
    made.max_threads = 1
    made.equilibrate_enable = equilibrate
    made.tol_gap_abs = made.tol_gap_rel = made.tol_feas = TIGHT
    made.reduced_tol_gap_abs = made.reduced_tol_gap_rel = made.reduced_tol_feas = ENOUGH
    return made
