"""Whole numbers in texts that nobody has checked."""

from __future__ import annotations


def whole_number(text: str, digits: int = 9) -> int | None:
    """The whole number that a text is; None for any other text, or one of more digits.

    `int` raises an error above 4300 digits, and for superscripts, which `str.isdigit` takes for digits.

    Args:
        text: with spaces around at most.
        digits: the most that are read.
    """
    text = text.strip()
    return int(text) if text.isdecimal() and len(text) <= digits else None
