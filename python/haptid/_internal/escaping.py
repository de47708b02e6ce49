"""Text from users' files as it is written out: one function for each format in which it could mean something else.

HTML is escaped by the templates (jinja2, autoescape), XML attributes by the standard library.
"""

from __future__ import annotations

import csv
import json
import re
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

# Special characters of LaTeX.
_LATEX = {c: rf"\{c}" for c in "#$%&_{}"} | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\^{}"}
# First characters that a spreadsheet takes for a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def printable(text: str, keep: str = "") -> str:
    r"""Text without control characters, direction marks and broken code points: these as \x1b, \u202e, \udc80.

    Args:
        text: of any origin.
        keep: characters to leave as they are, such as a line end.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if c in keep or _shown(c) else c.encode("unicode_escape").decode("ascii") for c in text)


def _shown(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"


def one_line(text: str) -> str:
    """Printable text on one line, as in a comment up to the end of a line."""
    return printable(" ".join(text.split()))


def c_comment(text: str) -> str:
    """Text on one line that can neither end a comment in C nor begin one, nor continue on the next line."""
    return one_line(text).replace("\\", "/").replace("*/", "* /").replace("/*", "/ *")


def xml_comment(text: str) -> str:
    """Text of several lines that cannot end a comment in XML."""
    return re.sub("-(?=-)", "- ", printable(text, keep="\n"))


def latex_text(text: str) -> str:
    """Text on one line with LaTeX's special characters escaped."""
    return "".join(_LATEX.get(character, character) for character in one_line(text))


def json_text(value: Any) -> str:
    """JSON over several lines, readable in any language; characters that a terminal would act on are escaped."""
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    for character in set(text) - {"\n"}:
        if not _shown(character):
            text = text.replace(character, json.dumps(character)[1:-1])
    return text + "\n"


def csv_cell(value: object) -> object:
    """A cell: a text that a spreadsheet would take for a formula begins with an apostrophe; numbers stay."""
    if not isinstance(value, str):
        return value
    return f"'{printable(value)}" if value.startswith(_FORMULA) and not _is_number(value) else printable(value)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_csv(path: Path, rows: Iterable[Sequence[object]]) -> None:
    """Write a table, its first row the headings."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([csv_cell(value) for value in row] for row in rows)
