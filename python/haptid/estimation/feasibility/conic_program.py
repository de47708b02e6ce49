"""Small convex cone programmes: quadratic objective, linear and semidefinite constraints, solved by Clarabel."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import clarabel
import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import ConvergenceError

# Tolerances of the solver on numbers near one, and those of an answer accepted where rounding stops it short of them.
TIGHT = 1e-11
ENOUGH = 1e-7
SOLVED = ("Solved", "AlmostSolved")
# Static regularisations of the linear systems, tried in turn; the first is the solver's own.
REGULARISATIONS = (1e-8, 1e-7, 1e-6)
# Magnitude whose square is no number any more.
_OVERFLOWS = 1e150


@dataclass(frozen=True, eq=False)
class ConeCondition:
    """A constraint: F v + f in a cone.

    Attributes:
        F, f: (rows, variables) and (rows,).
        matrix: whether the rows are the entries of a positive semidefinite matrix, or non-negative numbers.
    """

    F: Array
    f: Array
    matrix: bool = False


def cones_of(conditions: Sequence[ConeCondition]) -> list[Any]:
    """The cone of each condition, as the solver names it."""
    return [clarabel.PSDTriangleConeT(4) if c.matrix else clarabel.NonnegativeConeT(len(c.f)) for c in conditions]


def unsolved(status: str, iterations: int) -> ConvergenceError:
    """The error for a solver that stopped with a status other than solved."""
    return ConvergenceError(
        f"the search for feasible parameters stopped after {iterations} iterations without a solution ({status}).",
        found=status,
        advice="Check that no parameter is off by orders of magnitude, such as by a unit; or estimate with WLS.",
    )


def minimise(P: Array, q: Array, conditions: Sequence[ConeCondition]) -> tuple[Array, tuple[Array, ...]]:
    """The v that minimises v'P v / 2 + q'v under conditions, and the multiplier of each condition.

    Source: Goulart and Chen (2024), Clarabel: an interior-point solver for conic programs with quadratic objectives.

    Args:
        P: positive semidefinite, (variables, variables).
        q: (variables,).
        conditions: at least one.

    Raises:
        ConvergenceError: the solver stopped without a solution.
    """
    A = np.concatenate([-c.F for c in conditions])
    x, z = solved(P, q, A, np.concatenate([c.f for c in conditions]), cones_of(conditions))
    return x, tuple(np.split(z, np.cumsum([len(c.f) for c in conditions])[:-1]))


def solved(
    P: Array, q: Array, A: Array, b: Array, cones: Sequence[Any], tolerance: float = TIGHT
) -> tuple[Array, Array]:
    """The v that minimises v'P v / 2 + q'v with b - A v in the cones, and the multipliers of all rows.

    Raises:
        ConvergenceError: the solver stopped without a solution.
    """
    from scipy import sparse  # slow to import, and most estimates need no program

    triangle, rows = sparse.csc_matrix(np.triu(P)), sparse.csc_matrix(A)
    # On the boundary of the feasible set the solver may stall in one scaling or regularisation, and not in another.
    for regularisation, equilibrate in product(REGULARISATIONS, (True, False)):
        answer = attempt((triangle, q, rows, b, list(cones)), settings(equilibrate, regularisation, tolerance))
        if answer.status in SOLVED:
            return answer.x, answer.z
    raise unsolved(answer.status, answer.iterations)


@dataclass(frozen=True, eq=False)
class Answer:
    """What the solver stopped with.

    Attributes:
        status: its word for it.
        iterations: number of them.
        x, z: variables and multipliers.
    """

    status: str
    iterations: int
    x: Array
    z: Array


def attempt(problem: Sequence[Any], options: clarabel.DefaultSettings) -> Answer:
    """The solver's answer to a problem (P, q, A, b, cones).

    A decomposition that does not converge is a panic of its Rust code; here it is one more status that is not solved.
    Numbers whose squares overflow are not handed to it: it panics, and prints a trace.
    """
    P, q, A, b, _ = problem
    largest = max((float(np.abs(part).max(initial=0.0)) for part in (P.data, q, A.data, b)), default=0.0)
    if not largest < _OVERFLOWS:
        return Answer("numbers that overflow", 0, np.zeros(0), np.zeros(0))
    try:
        answer = clarabel.DefaultSolver(*problem, options).solve()
    except BaseException as panic:
        if type(panic).__name__ != "PanicException":
            raise
        return Answer(str(panic), 0, np.zeros(0), np.zeros(0))
    return Answer(str(answer.status), answer.iterations, np.array(answer.x), np.array(answer.z))


def settings(equilibrate: bool, regularisation: float, tolerance: float = TIGHT) -> clarabel.DefaultSettings:
    """Solver settings: silent, one thread, tight tolerances; scaling of rows and columns, static regularisation."""
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.max_threads = 1
    options.equilibrate_enable = equilibrate
    options.static_regularization_constant = regularisation
    options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = tolerance
    options.reduced_tol_gap_abs = options.reduced_tol_gap_rel = options.reduced_tol_feas = ENOUGH
    return options
