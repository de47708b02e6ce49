"""Dates and times of day in the cells of a text table."""

from __future__ import annotations

import re
from datetime import date

# ISO 8601; dates with points, day first, or with slashes; times of day with or without AM and PM; and minutes and
# seconds, which have a fraction.
DATE = re.compile(
    r"(?:(?P<date>\d{4}[-/]\d\d?[-/]\d\d?|\d\d?\.\d\d?\.\d{4}|\d\d?/\d\d?/\d{4})(?:[T ]|,\s*))?"
    r"(?:(?P<hours>\d\d?):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)(?:[.,](?P<part>\d{1,9})\d*)?"
    r"|(?P<only_minutes>\d{1,3}):(?P<their_seconds>[0-5]\d)[.,](?P<their_part>\d{1,9})\d*)"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?",
    re.ASCII,
)


def nanoseconds(cell: str) -> int:
    """Of a date and time since the year 1, or of a time of day since midnight.

    Raises:
        ValueError: the cell is neither.
    """
    found = DATE.fullmatch(cell)
    if found is None:
        raise ValueError(f"{cell} is no date and time")
    days = _day(found["date"], bool(found["half"])).toordinal() if found["date"] else 0
    zone = found["zone"] or "Z"
    offset = 0 if zone == "Z" else int(zone[0] + "1") * (int(zone[1:3]) * 60 + int(zone[-2:]))
    hours = int(found["hours"] or 0)
    if found["half"]:
        hours = hours % 12 + 12 * (found["half"].lower() == "pm")
    minutes = (days * 24 + hours) * 60 + int(found["minutes"] or found["only_minutes"]) - offset
    seconds, part = found["seconds"] or found["their_seconds"], found["part"] or found["their_part"] or "0"
    return (minutes * 60 + int(seconds)) * 10**9 + int(part.ljust(9, "0"))


def _day(text: str, american: bool) -> date:
    """The day of a date: with slashes the day is first, but beside AM or PM, or where only the other order fits."""
    first, second, third = (int(n) for n in re.split("[-/.]", text))
    if first > 31:
        return date(first, second, third)
    if "/" in text and ((american and first <= 12) or second > 12):
        return date(third, first, second)
    return date(third, second, first)
