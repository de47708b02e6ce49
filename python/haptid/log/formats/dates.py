"""Dates and times of day in the cells of a text table."""

from __future__ import annotations

import re
from datetime import date
from pathlib import Path

from haptid.errors import LogFileError

# ISO 8601; dates with points, day first, or with slashes; times of day with or without AM and PM; and minutes and
# seconds, which have a fraction.
DATE = re.compile(
    r"(?:(?P<date>\d{4}[-/]\d\d?[-/]\d\d?|\d\d?\.\d\d?\.\d{4}|\d\d?/\d\d?/\d{4})(?:[T ]|,\s*))?"
    r"(?:(?P<hours>\d\d?):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)(?:[.,](?P<part>\d{1,9})\d*)?"
    r"|(?P<only_minutes>\d{1,3}):(?P<their_seconds>[0-5]\d)[.,](?P<their_part>\d{1,9})\d*)"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?",
    re.ASCII,
)


# Of a year: a larger number in a date is a day.
_MONTHS = 12


class DayOrder:
    """Whether the day or the month is first in a column's dates with slashes, by all of them.

    A number above 12 is a day, and where no date has one, the month is first beside AM or PM.

    Args:
        month_first: None where it is to be found out: dates are then read by those so far.
    """

    def __init__(self, month_first: bool | None = None) -> None:
        self.month_first, self.given = month_first, month_first is not None
        self.found: set[tuple[int, int, int]] = set()
        self.taken: set[bool] = set()
        self.halves = False

    def day(self, first: int, second: int, third: int, half: bool) -> date:
        """The day of one date, and what it says of the others."""
        if not self.given and ((first, second, third) not in self.found or half > self.halves):
            self.found.add((first, second, third))
            self.halves |= half
            days, months = (any(found[k] > _MONTHS for found in self.found) for k in (0, 1))
            self.month_first = months if days or months else self.halves or None
        now = second > _MONTHS or (bool(self.month_first) and first <= _MONTHS)
        self.taken.add(now)
        return date(third, first, second) if now else date(third, second, first)

    def settled(self, path: Path, name: str) -> bool:
        """Whether all dates were read in the order that all of them say.

        Args:
            path, name: of the file and of the column.

        Raises:
            LogFileError: some dates have the day first and others the month, or either would give other times.
        """
        numbers = sorted(self.found)
        both = [any(found[k] > _MONTHS for found in numbers) for k in (0, 1)]
        unknown = self.month_first is None and len(numbers) > 1 and _apart(numbers, 0, 1) != _apart(numbers, 1, 0)
        if all(both) or unknown:
            shown = " and ".join("/".join(map(str, found)) for found in (numbers[0], numbers[-1]))
            raise LogFileError(
                f"{path}: of the {len(numbers)} dates in {name}, as {shown}, "
                + ("some have the day first and others the month." if all(both) else "the day or the month is first."),
                where=name,
                found=shown,
                advice="Write dates as 2026-02-28, or times in s from the start.",
            )
        return not self.found or self.month_first is None or self.taken == {self.month_first}


def _apart(numbers: list[tuple[int, int, int]], month: int, day: int) -> list[int]:
    """Days from the first to each of some dates, with these places of the month and the day."""
    days = [date(found[2], found[month], found[day]).toordinal() for found in numbers]
    return [own - days[0] for own in days]


def nanoseconds(cell: str, order: DayOrder | None = None) -> int:
    """Of a date and time since the year 1, or of a time of day since midnight.

    Args:
        cell: the text.
        order: of day and month in dates with slashes; None for one date by itself.

    Raises:
        ValueError: the cell is neither.
    """
    found = DATE.fullmatch(cell)
    if found is None:
        raise ValueError(f"{cell} is no date and time")
    days = _day(found["date"], bool(found["half"]), order or DayOrder()).toordinal() if found["date"] else 0
    zone = found["zone"] or "Z"
    offset = 0 if zone == "Z" else int(zone[0] + "1") * (int(zone[1:3]) * 60 + int(zone[-2:]))
    hours = int(found["hours"] or 0)
    if found["half"]:
        hours = hours % 12 + 12 * (found["half"].lower() == "pm")
    minutes = (days * 24 + hours) * 60 + int(found["minutes"] or found["only_minutes"]) - offset
    seconds, part = found["seconds"] or found["their_seconds"], found["part"] or found["their_part"] or "0"
    return (minutes * 60 + int(seconds)) * 10**9 + int(part.ljust(9, "0"))


def _day(text: str, half: bool, order: DayOrder) -> date:
    """The day of a date, beside AM or PM or not."""
    first, second, third = (int(n) for n in re.split("[-/.]", text))
    if first > 31:
        return date(first, second, third)
    return order.day(first, second, third, half) if "/" in text else date(third, second, first)
