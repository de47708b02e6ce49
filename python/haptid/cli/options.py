"""Parsing of numbers in options: comma-separated numbers, NAME=LOW:HIGH, NAME=NUMBER."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from haptid.errors import OptionError


def wrong_option(option: str, found: str, wanted: str) -> OptionError:
    """The error for the value of an option."""
    return OptionError(f"{option} is {found!r}; write {wanted}.", where=option, found=found, limit=wanted)


def numbers(option: str, text: str, what: str, count: int) -> tuple[float, ...]:
    """A given count of finite numbers, separated by commas.

    Args:
        option: its name on the command line.
        text: its value.
        what: meaning of the numbers, for the error.
        count: required count.

    Raises:
        OptionError: they are not.
    """
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count or not all(map(math.isfinite, found)):
        raise wrong_option(option, text, f"{count} {'number' if count == 1 else 'numbers'} with commas between: {what}")
    return found


def spread(option: str, text: str, what: str, count: int) -> tuple[float, ...]:
    """One number for all, or one for each."""
    return numbers(option, text, what, count) if "," in text else numbers(option, text, what, 1) * count


def ranges(option: str, texts: Iterable[str]) -> dict[str, tuple[float, float]]:
    """`NAME=LOW:HIGH` each, by name.

    Raises:
        OptionError: one that is not so.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, pair = text.partition("=")
        if not equals or pair.count(":") != 1:
            raise wrong_option(option, text, "NAME=LOW:HIGH, such as 2=-0.5:1.2")
        low, high = numbers(option, pair.replace(":", ","), "the lower limit, the higher one", 2)
        found[name] = (low, high)
    return found


def named(option: str, texts: Sequence[str]) -> Mapping[str, float]:
    """`NAME=NUMBER` each, by name.

    Raises:
        OptionError: one that is not so.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise wrong_option(option, text, "NAME=NUMBER, such as 2=1.5")
        found[name] = numbers(option, value, "a number", 1)[0]
    return found
