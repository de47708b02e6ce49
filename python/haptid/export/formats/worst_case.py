"""Worst-case execution time of the C functions: what a call does at most, as lines of the header's heading."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from haptid.export.expressions.emit import Function
from haptid.export.expressions.graph import LIBRARY, RUN, Graph

# Columns of a line: the name with its mark, then counts.
_NAME = 18
_HEAD = (
    "Worst-case execution time. In the functions of this table is no loop, no recursion and, in those without a mark,",
    "no branch that depends on data. A call does the operations of its line, each once, whatever its inputs, and calls",
    "nothing but the functions of the C library that are named:",
)
_TAIL = (
    "With the longest times of one addition, multiplication, division and call of the library, operands read from",
    "memory and results written to it, a call takes at most the sum of its line. A function of the library can take",
    "longer for some arguments: take the longest over the angles and velocities that occur. Angles beyond 1e8 rad in",
    "double precision, 120 rad in single, take a longer reduction in the GNU C library. All other functions call these",
    "and have loops over the coordinates at most.",
)
_STATUS = (
    "+ At the end a status, from comparisons, selects between outputs and what stands in for them. A divisor is",
    "compared with zero, in place of which the division is by one; the status is then 1.",
)
_UNGUARDED = (
    "* Divisors can be zero: at singular poses of loops, or where an expression of the device file divides by zero.",
)
# What stands in C for functions of LIBRARY that have another name there.
_IN_C = {"above": "fmax", "below": "fmin"}


class WorstCase(NamedTuple):
    """What one call of a function does.

    Attributes:
        additions, multiplications, divisions: subtractions count as additions, changes of sign as nothing.
        library: calls of functions of the C library, by their names in double precision; "sign" is two comparisons.
        status: whether it ends with a test of its outputs.
    """

    additions: int
    multiplications: int
    divisions: int
    library: dict[str, int]
    status: bool

    @staticmethod
    def of(graph: Graph, function: Function) -> WorstCase:
        """Operations on what changes from call to call; those on parameters alone are in the initialisation."""
        found = Counter(graph.nodes[node].op for node in graph.live(function.all) if graph.nodes[node].when == RUN)
        library = {_IN_C.get(name, name): found[name] for name in (*LIBRARY, "pow") if found[name]}
        return WorstCase(found["+"] + found["-"], found["*"], found["/"], library, bool(function.checks))


def worst_case_lines(graph: Graph, functions: Sequence[Function]) -> list[str]:
    """The table of all functions, with what it claims."""
    cases = {function.name: WorstCase.of(graph, function) for function in functions}
    lines = [*_HEAD, "", f"  {'function':{_NAME}}    add    mul    div  library"]
    for name, case in cases.items():
        mark = "+" if case.status else "*" if case.divisions else ""
        library = ", ".join(f"{count} {function}" for function, count in case.library.items()) or "none"
        counts = f"{case.additions:7}{case.multiplications:7}{case.divisions:7}"
        lines.append(f"  {name + ' ' + mark:{_NAME}}{counts}  {library}")
    lines += ["", *_TAIL]
    lines += _STATUS if any(case.status for case in cases.values()) else ()
    lines += _UNGUARDED if any(case.divisions and not case.status for case in cases.values()) else ()
    return lines
