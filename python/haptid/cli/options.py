"""Parsing of numbers in options: comma-separated numbers, NAME=LOW:HIGH, NAME=NUMBER."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from haptid.errors import OptionError


def wrong_option(option: str, found: str, wanted: str) -> OptionError:
    """The error for the value of an option."""
    return OptionError(f"{option} is {found!r}; write {wanted}.", where=option, found=found, limit=wanted)


def numbers(option: str, text: str, quantity: str, count: int) -> tuple[float, ...]:
    """A given count of finite numbers, separated by commas.

    Args:
        option: its name on the command line.
        text: its value.
        quantity: meaning of the numbers, for the error.
        count: required count.

    Raises:
        OptionError: they are not.
    """
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise wrong_option(
            option, text, f"{count} {'number' if count == 1 else 'numbers'} with commas between: {quantity}"
        )
    return values


def one_or_each(option: str, text: str, quantity: str, count: int) -> tuple[float, ...]:
    """Numbers of an option as a tuple of `count`: one for each, or one that counts for all."""
    return numbers(option, text, quantity, count) if "," in text else numbers(option, text, quantity, 1) * count


def ranges(option: str, texts: Iterable[str]) -> dict[str, tuple[float, float]]:
    """`NAME=LOW:HIGH` each, by name.

    Raises:
        OptionError: one that is not so.
    """
    limits: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, pair = text.partition("=")
        if not equals or pair.count(":") != 1:
            raise wrong_option(option, text, "NAME=LOW:HIGH, such as 2=-0.5:1.2")
        low, high = numbers(option, pair.replace(":", ","), "the lower limit, the higher one", 2)
        limits[name] = (low, high)
    return limits


def named(option: str, texts: Sequence[str]) -> Mapping[str, float]:
    """`NAME=NUMBER` each, by name.

    Raises:
        OptionError: one that is not so.
    """
    values: dict[str, float] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise wrong_option(option, text, "NAME=NUMBER, such as 2=1.5")
        values[name] = numbers(option, value, "a number", 1)[0]
    return values
