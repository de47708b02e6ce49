"""What a demonstration found, written down: a result file, and a report in sentences."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from haptid.demos.plan import Demo
from haptid.demos.tables import markdown


def write_report(values: Mapping[str, Any], lines: Iterable[str], folder: Path) -> None:
    """result.json and report.md.

    Args:
        values: every figure, as JSON holds it.
        lines: of the report, in Markdown.
        folder: where they go.
    """
    text = json.dumps(values, indent=1, allow_nan=False)
    (folder / "result.json").write_text(text + "\n", encoding="utf-8")
    (folder / "report.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def head(demo: Demo) -> dict[str, Any]:
    """What stands first in every result file, and what is printed and does not hold."""
    return {
        "schema": 1,
        "demo": demo.name,
        "title": demo.title,
        "source": demo.source,
        "claims": [claim.model_dump() for claim in demo.claims],
    }


def claims(demo: Demo) -> Iterator[str]:
    """The last chapter of every report."""
    yield "## What is printed and does not hold"
    yield ""
    cells = [["", "where", "printed", "found", "check"]]
    cells += [[c.name, c.where, c.printed, c.found, f"`{c.check}`"] for c in demo.claims]
    yield from markdown(cells)
    yield ""
    yield "The checks are among the golden tests of the project."
