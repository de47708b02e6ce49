"""Untrusted XML: elements with their lines and byte ranges; DTDs refused, depth and size bounded.

The standard library's expat gives line and byte of every element, which an edited file needs to stay as it was, byte
for byte, outside the edited elements. It expands no entity here: any DTD is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from haptid._internal.bounded_files import ROBOT_FILE, read_bounded
from haptid._internal.late import dataclass
from haptid.errors import RobotFileError

# Characters of a text that an error shows.
_SHOWN = 60
# Deepest nesting of elements: bodies of a chain are nested in MJCF.
DEEPEST = 400
# Most elements of one file.
MOST_ELEMENTS = 500_000
# Sizes of a gear ratio or of a unit in SI, far beyond any: their squares and products have to be numbers.
LEAST_RATIO, MOST_RATIO = 1e-9, 1e9
# Possessive: comments are told apart in one way only, or their number is the exponent of the time. The inner group is
# atomic, which is the same, because Python 3.11.0 to 3.11.4 finds nothing where it is possessive too.
_AHEAD = re.compile(rb"\s*+(?:<!--(?>(?:(?!-->).)*)-->\s*+)*+(?=<\?xml)", re.DOTALL)
# Comments, and text of which nothing is one; what is not closed reaches to the end.
_COMMENT = re.compile(rb"<!\[CDATA\[.*?(?:\]\]>|\Z)|<!--(?P<inside>.*?)(?:-->|\Z)", re.DOTALL)
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


@dataclass(slots=True, eq=False)
class Element:
    """An element of an XML file.

    Attributes:
        tag: name, with its prefix.
        attributes: by name.
        file: that it is in, for errors.
        line: of its start tag.
        start, open_end, end: byte offsets of its start tag, of the end of that tag, and of its own end.
        children: elements in it, in order.
        text: directly in it.
    """

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    start: int
    open_end: int = 0
    end: int = 0
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def all(self, tag: str) -> list[Element]:
        """Children of this name."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        """The first child of this name, None without one."""
        return next((child for child in self.children if child.tag == tag), None)

    def only(self, tag: str) -> Element:
        """The child of this name.

        Raises:
            RobotFileError: there is none.
        """
        found = self.first(tag)
        if found is None:
            self.refuse(f"has no <{tag}>", f"Add <{tag}> to it.")
        return found

    def walk(self) -> Iterator[Element]:
        """This element and all below it, in document order."""
        stack = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))

    def name(self, attribute: str = "name") -> str:
        """An attribute that must be there and not be empty."""
        value = self.attributes.get(attribute, "").strip()
        if not value:
            self.refuse(f"has no {attribute}", f'Write {attribute}="...".')
        return value

    def number(self, attribute: str, default: float | None = None, *, unlimited: bool = False) -> float:
        """A finite number; with `unlimited`, inf is allowed.

        Raises:
            RobotFileError: it is missing and has no default, or is no finite number.
        """
        text = self.attributes.get(attribute)
        if text is None:
            if default is None:
                self.refuse(f"has no {attribute}", f'Write {attribute}="..." with a number.')
            return default
        return self.numbers_of(attribute, text, 1, unlimited=unlimited)[0]

    def triple(self, attribute: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """As many finite numbers as the default has."""
        text = self.attributes.get(attribute)
        return default if text is None else self.numbers_of(attribute, text, len(default))

    def numbers_of(self, what: str, text: str, count: int, *, unlimited: bool = False) -> tuple[float, ...]:
        """Finite numbers separated by spaces."""
        words = text.split()
        if len(words) != count:
            wanted = "one number" if count == 1 else f"{count} numbers"
            self.refuse(f"has {what}={_short(text)!r}", f"Write {wanted} there.")
        return tuple(self._finite(what, word, unlimited) for word in words)

    def _finite(self, what: str, word: str, unlimited: bool) -> float:
        if unlimited and word.lower().lstrip("+-") in ("inf", "infinity"):
            return -math.inf if word.startswith("-") else math.inf
        value = float(word) if _NUMBER.fullmatch(word) else math.nan
        if not math.isfinite(value):
            self.refuse(f"has {what}={_short(word)!r}", "Write a finite number there.")
        return value

    def refuse(self, found: str, advice: str) -> NoReturn:
        """Raise RobotFileError at this element."""
        name = self.attributes.get("name")
        label = f"<{self.tag}>" if name is None else f'<{self.tag} name="{_short(name)}">'
        raise refused(self.file, f"{label} {found}", advice, self.line)


def checked_ratio(value: float, what: str, file: str, line: int | None = None) -> float:
    """A gear ratio or a unit's size; its square is computed with.

    Raises:
        RobotFileError: a size that none has.
    """
    if not LEAST_RATIO <= abs(value) <= MOST_RATIO:
        advice = f"Write a number between {LEAST_RATIO:g} and {MOST_RATIO:g}."
        raise refused(file, f"{what} is {value:g}", advice, line)
    return value


def refused(file: str, found: str, advice: str, line: int | None = None) -> RobotFileError:
    """The error for something in a robot description."""
    where = f"{file}, line {line}" if line is not None else file
    return RobotFileError(f"{where}: {found}.", where=(file, line), found=found, advice=advice)


def _short(text: str) -> str:
    plain = " ".join(text.split())
    return plain if len(plain) <= _SHOWN else f"{plain[:_SHOWN]}..."


def read_bytes(path: Path) -> bytes:
    """The content of a regular file of ordinary size.

    Raises:
        RobotFileError: it cannot be opened, is a pipe or a device, or is larger than any robot description.
    """
    try:
        return read_bounded(path, ROBOT_FILE)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise refused(str(path), f"cannot be opened ({reason})", "Give the path of a robot description.") from None


def parse(content: bytes, file: str) -> Element:
    """The root element of an XML document.

    Raises:
        RobotFileError: it is not well-formed, has a DTD, or is nested too deeply or too large.
    """
    return _Parser(file).run(content)


def _without_dashes(found: re.Match[bytes]) -> bytes:
    """A comment without the dashes in it, as of `gz sim --verbose`, which only strict parsers such as expat refuse."""
    inside = found["inside"]
    return found[0] if inside is None else b"<!--" + inside.replace(b"-", b" ") + found[0][len(b"<!--" + inside) :]


class _Parser:
    """Handlers of expat, which keep a stack instead of recursing."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.content, self.ahead, self.lines_ahead = b"", 0, 0
        self.root: Element | None = None
        self.stack: list[Element] = []
        self.count = 0
        self.waiting: Element | None = None
        self.parser = parser = expat.ParserCreate()
        parser.buffer_text = False
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text
        parser.DefaultHandler = self._other
        parser.StartDoctypeDeclHandler = self._doctype

    def run(self, content: bytes) -> Element:
        # Blanks and comments before the XML declaration are an error to expat, and to few others.
        ahead = _AHEAD.match(content)
        text = content[ahead.end() :] if ahead else content
        self.content, self.ahead = content, len(content) - len(text)
        self.lines_ahead = content[: self.ahead].count(b"\n")
        try:
            self.parser.Parse(_COMMENT.sub(_without_dashes, text), True)
        except expat.ExpatError as error:
            reason = expat.errors.messages.get(error.code, str(error))
            line = error.lineno + self.lines_ahead
            raise refused(self.file, f"not XML: {reason}", "Correct the file there.", line) from None
        except (ValueError, LookupError) as error:  # an encoding that Python does not know
            raise refused(self.file, f"not XML: {error}", "Save the file as UTF-8.") from None
        if self.root is None:
            raise refused(self.file, "not XML: it has no element", "Give a robot description.")
        return self.root

    def _opened(self) -> None:
        """The start tag before this event ends here."""
        if self.waiting is not None:
            self.waiting.open_end = self.parser.CurrentByteIndex + self.ahead
            self.waiting = None

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._opened()
        line = self.parser.CurrentLineNumber + self.lines_ahead
        self.count += 1
        if len(self.stack) >= DEEPEST or self.count > MOST_ELEMENTS:
            found, limit = "elements are nested deeper", DEEPEST
            if self.count > MOST_ELEMENTS:
                found, limit = "it has more elements", MOST_ELEMENTS
            raise refused(self.file, f"{found} than {limit}", "No robot needs that: correct the file.", line)
        element = Element(tag, attributes, self.file, line, self.parser.CurrentByteIndex + self.ahead)
        if self.stack:
            self.stack[-1].children.append(element)
        else:
            self.root = element
        self.stack.append(element)
        self.waiting = element

    def _end(self, _tag: str) -> None:
        at = self.parser.CurrentByteIndex + self.ahead
        element = self.stack.pop()
        closed = self.waiting is element and self.content[at - 2 : at] == b"/>"
        self._opened()
        element.end = at if closed else self.content.find(b">", at) + 1

    def _text(self, text: str) -> None:
        self._opened()
        if self.stack:
            self.stack[-1].text += text

    def _other(self, _text: str) -> None:
        self._opened()

    def _doctype(self, *_: object) -> None:
        line = self.parser.CurrentLineNumber + self.lines_ahead
        advice = "Remove <!DOCTYPE ...>, and write out what its entities stand for."
        raise refused(self.file, "it has a DTD, which can define entities and read other files", advice, line)
