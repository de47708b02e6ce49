"""Branches of one device: the kind of demonstration."""

from __future__ import annotations

from pathlib import Path

from haptid.demos.branches.chapters import chapters
from haptid.demos.branches.columns import summary
from haptid.demos.branches.finding import Results, find, takes
from haptid.demos.branches.plan import Branches
from haptid.demos.branches.table_files import write_tables
from haptid.demos.branches.values import values
from haptid.demos.kind import Kind, Tell


def draw(found: Results, folder: Path, tell: Tell) -> None:
    """Every figure; the library that draws is loaded here."""
    from haptid.demos.branches.figures import draw_all

    draw_all(found, folder, tell)


BRANCHES = Kind(Branches, takes, find, draw, write_tables, values, chapters, summary)
