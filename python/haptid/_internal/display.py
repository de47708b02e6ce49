"""How a value shows itself: at most twenty lines at a prompt, a small table in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from html import escape
from typing import Any, Protocol, TypeVar

from haptid._internal.escaping import printable
from haptid._internal.late import dataclass

# Rows of a table that are shown, at a prompt and in a notebook.
_FEW, _MANY = 14, 60
# Characters of a setting that are shown in a notebook.
_LONGEST = 300


@dataclass(frozen=True)
class Overview:
    """What is shown of a value.

    Attributes:
        title: one line.
        headings, rows: of a table; none where there are no rows.
        notes: sentences below it.
    """

    title: str
    headings: tuple[str, ...] = ()
    rows: Sequence[Sequence[str]] = ()
    notes: Sequence[str] = ()

    @staticmethod
    def of_text(text: str) -> Overview:
        """Of a text whose first line is the title."""
        title, *lines = text.splitlines()
        return Overview(title, ("",), [[line] for line in lines])

    def text(self) -> str:
        """Lines for a prompt."""
        rows = [list(self.headings), *map(list, self.rows[:_FEW])] if self.rows else []
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        remainder = [f".. and {len(self.rows) - _FEW} more"] if len(self.rows) > _FEW else []
        return printable(
            "\n".join([self.title, *(f"  {line[:140]}" for line in (*lines, *remainder, *self.notes[:2]))]), "\n"
        )

    def html(self) -> str:
        """A table for a notebook, in the notebook's own colours."""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.headings)
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(printable(cell))}</td>' for cell in row)}</tr>" for row in self.rows[:_MANY]
        )
        hidden = len(self.rows) - _MANY
        notes = [*([f"and {hidden} more"] if hidden > 0 else []), *self.notes[:5]]
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if self.rows else ""
        below = "".join(f"<br><small>{escape(printable(note))}</small>" for note in notes)
        return f"<div><strong>{escape(printable(self.title))}</strong>{table}{below}</div>"


class _Showing(Protocol):
    def _shown(self) -> Overview: ...


_Class = TypeVar("_Class", bound=type[_Showing])


def displayed(kind: _Class) -> _Class:
    """Class decorator: `repr` and a notebook show what the method `_shown` says, not every array of a value."""

    def as_text(self: _Showing) -> str:
        return self._shown().text()

    def as_html(self: _Showing) -> str:
        return self._shown().html()

    changed: Any = kind
    changed.__repr__, changed._repr_html_ = as_text, as_html
    return kind


_Settings = TypeVar("_Settings", bound=type)


def tabulated(kind: _Settings) -> _Settings:
    """Class decorator of a dataclass of settings: a notebook shows them as a table; `repr` stays whole and exact."""

    def as_html(self: Any) -> str:
        rows = [[attribute.name, str(getattr(self, attribute.name))[:_LONGEST]] for attribute in fields(self)]
        return Overview(kind.__name__, ("setting", "value"), rows).html()

    changed: Any = kind
    changed._repr_html_ = as_html
    return kind
