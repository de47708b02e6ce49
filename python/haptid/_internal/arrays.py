"""Validation helpers for frozen dataclasses: shapes, read-only arrays, numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haptid.errors import ShapeError

Array = NDArray[np.float64]


def freeze(array: Array) -> Array:
    """The same array made read-only; only for arrays that no caller holds."""
    array.flags.writeable = False
    return array


def read_only(array: ArrayLike) -> Array:
    """The array as read-only float64; copied if the caller could still write to it."""
    view = np.asarray(array, dtype=np.float64)
    return freeze(view.copy(order="K")) if view.flags.writeable else view


def cross_product(a: Array, b: Array) -> Array:
    """Cross products over the last axis, as `numpy.cross`, which takes twice as long for few vectors."""
    made = np.empty(np.broadcast_shapes(a.shape, b.shape))
    (a0, a1, a2), (b0, b1, b2) = ((x[..., 0], x[..., 1], x[..., 2]) for x in (a, b))
    made[..., 0] = a1 * b2 - a2 * b1
    made[..., 1] = a2 * b0 - a0 * b2
    made[..., 2] = a0 * b1 - a1 * b0
    return made


def expect(name: str, got: tuple[int, ...], wanted: tuple[int | None, ...]) -> None:
    """Raise ShapeError unless `got` fits `wanted`, in which None is any length."""
    if got == wanted:
        return
    if len(got) != len(wanted) or any(w is not None and g != w for g, w in zip(got, wanted, strict=True)):
        shown = tuple("any" if n is None else n for n in wanted)
        raise ShapeError(f"{name} has shape {got}; {shown} is required.", where=name, found=got, limit=wanted)


def freeze_fields(held: object, /, *names: str, **shapes: tuple[int | None, ...]) -> None:
    """Make array fields of a frozen dataclass read-only float64, and check the shapes that are given; None stays None.

    Raises:
        ShapeError: a field has another shape.
    """
    for name in (*names, *shapes):
        if (value := getattr(held, name)) is not None:
            array = read_only(value)
            expect(name, array.shape, shapes.get(name, array.shape))
            object.__setattr__(held, name, array)


def whole(value: object) -> bool:
    """Whether a value is an integer (booleans are not)."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def positive(value: Any) -> bool:
    """Whether a value is a finite number above zero."""
    return (whole(value) or isinstance(value, float)) and 0 < value < np.inf
