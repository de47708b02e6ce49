"""Multivariate Horner forms of small models: polynomials in sines, cosines and rates, with a search for cheap orders.

Recursions repeat products in ways that local factoring rules do not find. The polynomial's normal form, with
s^2 = 1 - c^2 or c^2 = 1 - s^2, does not; Horner's rule then factors out atoms one by one, in an order that is searched.
"""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Mapping, Sequence

from haptid._internal.late import dataclass
from haptid.export.expressions.factoring import factored
from haptid.export.expressions.graph import RUN, Expr, Graph, cost

# Product of atoms (node indices), sorted, with repetition.
Monomial = tuple[int, ...]
Polynomial = dict[Monomial, Expr]
# Of outputs, by their nodes and signs: the cheaper of them as they are and factored, and its cost.
Factorings = dict[tuple[tuple[int, int], ...], tuple[int, list[Expr]]]
# Number of monomials of all outputs above which the recursion is cheaper.
_LARGEST = 150
# Number of angles above which there are too many normal forms: two ways to write the squares of each.
_MOST_ANGLES = 4
# Orders that are tried, and factors by which an atom's weight in the order is varied.
TRIALS = 16
WEIGHTS = (0.5, 0.8, 1.0, 1.25, 1.6, 2.2, 3.0)


class _TooLargeError(Exception):
    """The polynomial has more monomials than LARGEST."""


def cheapest(graph: Graph, outputs: Sequence[Expr], trials: int = TRIALS) -> list[Expr] | None:
    """The outputs in the cheapest Horner form found, or None where they are not small polynomials.

    Args:
        graph: the store.
        outputs: sums and products of names, sines and cosines.
        trials: number of orders tried, by a search with a fixed seed.
    """
    pairs = _pairs(graph, outputs)
    if len(pairs) > _MOST_ANGLES:
        return None
    try:
        forms = [
            _normal_form(graph, outputs, {pair[k]: pair[1 - k] for pair, k in zip(pairs, choice, strict=True)})
            for choice in itertools.product((0, 1), repeat=len(pairs))
        ]
    except _TooLargeError:
        return None
    return _search(graph, forms, trials)


def _pairs(graph: Graph, outputs: Sequence[Expr]) -> list[tuple[int, int]]:
    """Sine and cosine nodes of every angle that has both."""
    found: dict[int, dict[str, int]] = {}
    for node in sorted(graph.live(outputs)):
        op = graph.nodes[node].op
        if op in ("sin", "cos"):
            found.setdefault(graph.operands(node)[0], {})[op] = node
    return [(both["sin"], both["cos"]) for both in found.values() if len(both) == 2]


def _normal_form(graph: Graph, outputs: Sequence[Expr], squares: Mapping[int, int]) -> list[Polynomial]:
    """Every output as a polynomial; `squares` maps s to c where s^2 is replaced by 1 - c^2, and conversely."""
    known: dict[int, Polynomial] = {}
    made = []
    for out in outputs:
        polynomial = _expanded(graph, out.node, squares, known)
        made.append(polynomial if out.sign > 0 else {m: -k for m, k in polynomial.items()})
    if sum(map(len, made)) > _LARGEST:
        raise _TooLargeError
    return made


def _expanded(graph: Graph, node: int, squares: Mapping[int, int], known: dict[int, Polynomial]) -> Polynomial:
    if node in known:
        return known[node]
    op, _, when = graph.nodes[node]
    made: Polynomial = {}
    if when < RUN:
        made = {(): graph.at(node)}
    elif op in ("+", "-"):
        left, right = (_expanded(graph, arg, squares, known) for arg in graph.operands(node))
        made = dict(left)
        for monomial, factor in right.items():
            _collect(made, monomial, factor if op == "+" else -factor)
    elif op == "*":
        left, right = (_expanded(graph, arg, squares, known) for arg in graph.operands(node))
        for (a, x), (b, y) in itertools.product(left.items(), right.items()):
            for monomial, factor in _reduced(tuple(sorted(a + b)), x * y, squares):
                _collect(made, monomial, factor)
    else:
        made = {(node,): graph.number(1.0)}
    if len(made) > _LARGEST:
        raise _TooLargeError
    known[node] = made
    return made


def _collect(into: Polynomial, monomial: Monomial, factor: Expr) -> None:
    total = into[monomial] + factor if monomial in into else factor
    if total.value == 0:
        into.pop(monomial, None)
    else:
        into[monomial] = total


def _reduced(monomial: Monomial, factor: Expr, squares: Mapping[int, int]) -> list[tuple[Monomial, Expr]]:
    """The monomial with squares replaced by those of the other function of the angle."""
    for atom, other in squares.items():
        if monomial.count(atom) > 1:
            k = monomial.index(atom)
            rest = monomial[:k] + monomial[k + 2 :]
            squared = tuple(sorted((*rest, other, other)))
            return _reduced(rest, factor, squares) + _reduced(squared, -factor, squares)
    return [(monomial, factor)]


def _search(graph: Graph, forms: Sequence[list[Polynomial]], trials: int) -> list[Expr]:
    """Local search: every normal form once, then random changes of the order in the two best ones."""
    rng = random.Random(0)  # a fixed seed: the same code every time
    factorings: Factorings = {}
    first = [_HornerForm.of(graph, form, {}, factorings) for form in forms]
    best = sorted(first, key=lambda one: one.size)[:2]
    for trial in range(trials):
        k = trial % len(best)
        candidate = _HornerForm.of(graph, best[k].form, _varied(rng, best[k]), factorings)
        best[k] = min(candidate, best[k], key=lambda one: one.size)
    return min(best, key=lambda one: one.size).outputs


@dataclass(frozen=True)
class _HornerForm:
    """Horner form of the outputs for one order of the atoms.

    Attributes:
        form: the polynomials.
        weights: of atoms in the order in which they are factored out; 1 by default.
        outputs: as nested products.
        size: their cost.
    """

    form: list[Polynomial]
    weights: Mapping[int, float]
    outputs: list[Expr]
    size: int

    @staticmethod
    def of(graph: Graph, form: list[Polynomial], weights: Mapping[int, float], factorings: Factorings) -> _HornerForm:
        """Horner's rule for every polynomial of a form, then common factors: once where orders have one result."""
        known: dict[frozenset[tuple[Monomial, int, int]], Expr] = {}
        made = [_horner(graph, polynomial, weights, known) for polynomial in form]
        key = tuple((out.node, out.sign) for out in made)
        if key not in factorings:
            sizes = [(cost(graph, outputs), outputs) for outputs in (made, factored(graph, made))]
            factorings[key] = min(sizes, key=lambda one: one[0])
        size, outputs = factorings[key]
        return _HornerForm(form, weights, outputs, size)


def _varied(rng: random.Random, current: _HornerForm) -> dict[int, float]:
    """The weights with up to three of them drawn again."""
    atoms = sorted({atom for polynomial in current.form for monomial in polynomial for atom in monomial})
    made = dict(current.weights)
    for atom in rng.sample(atoms, min(len(atoms), rng.randint(1, 3))):
        made[atom] = rng.choice(WEIGHTS)
    return made


def _horner(
    graph: Graph,
    polynomial: Polynomial,
    weights: Mapping[int, float],
    known: dict[frozenset[tuple[Monomial, int, int]], Expr],
) -> Expr:
    """atom * (cofactor) + remainder, the most frequent atom first."""
    if not any(polynomial):
        return polynomial.get((), graph.number(0.0))
    key = frozenset((monomial, factor.node, factor.sign) for monomial, factor in polynomial.items())
    if key in known:
        return known[key]
    seen = Counter(atom for monomial in polynomial for atom in set(monomial))
    best = max(seen, key=lambda atom: (seen[atom] * weights.get(atom, 1.0), atom))
    inside: Polynomial = {}
    outside: Polynomial = {}
    for monomial, factor in polynomial.items():
        if best in monomial:
            k = monomial.index(best)
            inside[monomial[:k] + monomial[k + 1 :]] = factor
        else:
            outside[monomial] = factor
    common = {factor.node for factor in inside.values()}
    if len(common) == 1 and len(inside) > 1:
        node = common.pop()
        plain = {monomial: graph.number(factor.sign) for monomial, factor in inside.items()}
        made = graph.at(node) * (graph.at(best) * _horner(graph, plain, weights, known))
    else:
        made = graph.at(best) * _horner(graph, inside, weights, known)
    if outside:
        made = _horner(graph, outside, weights, known) + made
    known[key] = made
    return made
