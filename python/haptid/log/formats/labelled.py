"""Text in which numbers have labels: `q1:0.25 tau1:-8.3`, lines `Position 0.1 0.2`, messages as `ros2 topic echo`.

A record begins where its first label comes again; the numbers of a label, in one line or in a list below it, are one
channel each.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid.errors import LogFileError
from haptid.log.formats.encoding import encoding_of, opened_text
from haptid.log.formats.sniff import Budget, RawChannel, array_columns, array_names, opened_file
from haptid.log.request import Request

_KIND = "labelled text"
# Lines at the top of a file that tell it, records in them at least, and share of the lines that have the form.
_LINES, _RECORDS, _SHARE = 400, 3, 0.9
_NUMBER = r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|nan|inf)(?![\w.])"
# A word, what separates it from its numbers, and these; a colon or an equals sign, or blanks alone.
_PART = re.compile(
    r"(?<![\w./])(?P<label>[^\W\d][\w./]*)['\"]?(?P<mark>\s*[:=]\s*|\s+)"
    rf"(?P<numbers>[\[(]?\s*{_NUMBER}(?:[\s,;]+{_NUMBER})*\s*[\])]?)?"
)
# Arrays as Python prints them.
_ARRAY = re.compile(r"(?<![\w.])(?:np\.|numpy\.)?(?:array|tensor)\(\s*(?:'\w',\s*)?\[")
_ITEM = re.compile(rf"-\s+(?P<number>{_NUMBER})?")
_ALONE = re.compile(r"(?P<label>[^\W\d][\w./]*)\s*:(?:\s+[^\s\d].*|\s*\[.*\])?")
_SKIPPED = re.compile(r"\s*(?:#.*|%.*|//.*|---+|\.\.\.)?\s*")
# Characters of a line by which it is known.
_LONGEST = 2000


def is_labelled(head: bytes) -> bool:
    """Whether a text with these first bytes is records of labelled numbers."""
    text = head.decode(encoding_of(head), errors="replace")
    lines = [line for line in text.splitlines()[:-1] if not _SKIPPED.fullmatch(line)][:_LINES]
    found = list(_labels(lines))
    formed = sum(bool(_form(line)) for line in lines)
    counts = Counter(label for label, numbers, _ in found if numbers)
    marked = any(mark for _, numbers, mark in found if numbers)
    first = next((label for label, numbers, _ in found if numbers), "")
    return formed >= _SHARE * len(lines) and counts[first] > _RECORDS and (marked or len(counts) > 1)


def names(path: Path) -> list[str]:
    """A channel for each number of a label, `position[1]`, or the label where it has one."""
    return array_names(path, _arrays(path)[0], "labels")


def columns(path: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted channels that the file has, each (n,) float64; NaN in records without their label."""
    arrays, notes = _arrays(path)
    made = array_columns(wanted, arrays)
    request.notes.extend(notes if made else ())
    return made


def _arrays(path: Path) -> tuple[dict[str, Array], tuple[str, ...]]:
    return _parsed(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=16)
def _parsed(path: Path, _written: int) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Numbers of each label, (records,) or (records, numbers), and what is to be said of them."""
    with opened_file(path, _KIND):
        Budget(path).take(_KIND, 4 * path.stat().st_size)
        with opened_text(path) as file:
            records = list(_records(line.rstrip("\r\n") for line in file))
    notes = []
    if len(records) > 1 and len(records[-1]) < len(records[-2]):
        notes.append(
            f"the last record has {len(records[-1])} labels of {len(records[-2])}, as where it was cut: dropped"
        )
        del records[-1]
    sizes: dict[str, int] = {}
    for record in islice(records, _LINES):
        sizes |= {label: len(numbers) for label, numbers in record.items() if label not in sizes}
    made = {label: np.full((len(records), size), np.nan) for label, size in sizes.items()}
    for k, record in enumerate(records):
        for label, numbers in record.items():
            if label in made:
                if len(numbers) != sizes[label]:
                    raise _uneven(path, k, label, len(numbers), sizes[label])
                made[label][k] = numbers
    return {label: array[:, 0] if array.shape[1] == 1 else array for label, array in made.items()}, tuple(notes)


def _records(lines: Iterator[str]) -> Iterator[dict[str, list[float]]]:
    """Numbers by label, record by record; a label that comes several times in one goes on."""
    first, record = "", dict[str, list[float]]()
    for label, numbers, _ in _labels(lines):
        if numbers:
            if label == first and record:
                yield record
                record = {}
            first = first or label
            record.setdefault(label, []).extend(numbers)
    if record:
        yield record


def _labels(lines: Sequence[str] | Iterator[str]) -> Iterator[tuple[str, list[float], str]]:
    """Labels with their numbers, and the colon or equals sign between them; items of a list are of the label above."""
    above = ""
    for line in lines:
        text = _ARRAY.sub("[", line.strip())
        if item := _ITEM.match(text):
            if above and item["number"]:
                yield above, [float(item["number"])], ":"
            continue
        for part in _PART.finditer(text):
            numbers = [float(n) for n in re.findall(_NUMBER, part["numbers"] or "")]
            yield part["label"], numbers, part["mark"].strip()
        alone = _ALONE.fullmatch(text)
        above = alone["label"] if alone else ""


def _form(line: str) -> bool:
    """Whether a line is nothing but labelled numbers, an item of a list, or a label alone."""
    text = _ARRAY.sub("[", line.strip()[:_LONGEST])
    if _ITEM.match(text) or _ALONE.fullmatch(text):
        return True
    parts = list(_PART.finditer(text))
    between = [text[a.end() : b.start()] for a, b in pairwise(parts)]
    return (
        bool(parts)
        and all(part["numbers"] for part in parts)
        and not text[: parts[0].start()].strip("{'\" ")
        and not "".join([*between, text[parts[-1].end() :]]).strip("}){'\",;| \t")
    )


def _uneven(path: Path, record: int, label: str, found: int, usual: int) -> LogFileError:
    return LogFileError(
        f"{path}, record {record + 1}: {label} has {found} numbers, before it had {usual}.",
        where=(record + 1, label),
        found=found,
        limit=usual,
        advice="Correct the record, or end the log before it.",
    )
