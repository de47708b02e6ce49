"""Extension of griffe: `a, b: text` among the arguments of a docstring is an entry for each of the names."""

from __future__ import annotations

import re
from typing import Any

import griffe

_SEVERAL = re.compile(r"^( +)(\w+(?:, \w+)+): (.*(?:\n\1 +\S.*)*)", re.MULTILINE)
_SECTION = re.compile(r"^( *)(Args|Attributes):\n((?:\1 +\S.*\n|\n(?=\1 +\S))*(?:\1 +\S.*)?)", re.MULTILINE)


class NamesApart(griffe.Extension):
    """Entries of several names taken apart, so that each has its own type."""

    def on_instance(self, *, obj: Any, **_: Any) -> None:
        """Rewrite the docstring of anything that has one."""
        if obj.docstring is not None:
            obj.docstring.value = _SECTION.sub(self._apart, obj.docstring.value)

    @staticmethod
    def _apart(section: re.Match[str]) -> str:
        def entries(found: re.Match[str]) -> str:
            return "\n".join(f"{found[1]}{name}: {found[3]}" for name in found[2].split(", "))

        return f"{section[1]}{section[2]}:\n{_SEVERAL.sub(entries, section[3])}"
