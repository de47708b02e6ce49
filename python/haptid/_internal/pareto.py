"""Pareto fronts of two figures that are to be small."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

_One = TypeVar("_One")


def pareto_front(
    points: Iterable[_One], figures: Callable[[_One], tuple[float, float]], margin: float = 0.0
) -> tuple[_One, ...]:
    """Points that no other one beats in both figures, the one with the least first figure first.

    Args:
        points: to choose from.
        figures: of a point, both better where smaller.
        margin: by which the second figure has to fall from one point to the next.
    """
    front: list[_One] = []
    for point in sorted(points, key=figures):
        if not front or figures(point)[1] < figures(front[-1])[1] - margin:
            front.append(point)
    return tuple(front)
