"""A kind of demonstration: the form of its plan, and how it is walked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from haptid.demos.plan import Demo
from haptid.demos.recordings import Take

# Called with what is being done and the share of it done.
Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Kind:
    """What is done with one form of plan. Each kind finds values of its own type, which its own functions take.

    Attributes:
        plan: its form.
        takes: logs to be recorded into a folder.
        find: everything from the logs in that folder.
        draw: every figure into a folder.
        write_tables: the paper's tables with our columns, as text and CSV.
        values: every figure, as JSON holds it.
        chapters: all lines of the report, in Markdown.
        summary: what is published beside ours, as text.
    """

    plan: type[Demo]
    takes: Callable[[Any, Path], list[Take]]
    find: Callable[[Any, Path, Tell], Any]
    draw: Callable[[Any, Path, Tell], None]
    write_tables: Callable[[Any, Path], None]
    values: Callable[[Any], dict[str, Any]]
    chapters: Callable[[Any], Iterator[str]]
    summary: Callable[[Any], str]
