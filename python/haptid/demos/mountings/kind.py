"""One device in several mountings: the kind of demonstration."""

from __future__ import annotations

from pathlib import Path

from haptid.demos.kind import Kind, Tell
from haptid.demos.mountings.chapters import chapters
from haptid.demos.mountings.columns import summary
from haptid.demos.mountings.finding import Results, find, takes
from haptid.demos.mountings.plan import Mountings
from haptid.demos.mountings.table_files import write_tables
from haptid.demos.mountings.values import values


def draw(found: Results, folder: Path, tell: Tell) -> None:
    """Every figure; the library that draws is loaded here."""
    from haptid.demos.mountings.figures import draw_all

    draw_all(found, folder, tell)


def write(found: Results, folder: Path) -> None:
    """Tables, and the HTML report of the mounting whose handle the hand pushes."""
    from haptid.demos.mountings.page import write_page

    write_tables(found, folder)
    write_page(found, folder)


MOUNTINGS = Kind(Mountings, takes, find, draw, write, values, chapters, summary)
