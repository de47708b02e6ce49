"""Notebooks of the documentation: executed by `python tools/site/notebooks.py`, and rendered as pages of the site.

A notebook's outputs are stored in it, so that the site is built without running it; `tests/docs` executes each anew.
"""

from __future__ import annotations

import html
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
# Longest time of one cell, s.
PATIENCE = 600


def execute(path: Path) -> dict[str, Any]:
    """The notebook with the outputs of its cells, executed from top to bottom in an empty folder.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell fails.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook, timeout=PATIENCE, resources={"metadata": {"path": folder}}, record_timing=False
        )
        # The kernel draws figures into the notebook, whatever the shell has chosen.
        client.execute(env={key: value for key, value in os.environ.items() if key != "MPLBACKEND"})
    notebook.metadata.pop("language_info", None)
    return dict(notebook)


def as_markdown(notebook: dict[str, Any]) -> str:
    """A notebook as a page: its text, its code, and the stored outputs."""
    return "\n\n".join(part for cell in notebook["cells"] for part in _parts(cell)) + "\n"


def _parts(cell: dict[str, Any]) -> Iterator[str]:
    source = _text(cell["source"])
    if cell["cell_type"] == "markdown":
        yield source
        return
    yield f"```python\n{source}\n```"
    printed = "".join(_text(output["text"]) for output in cell["outputs"] if output["output_type"] == "stream")
    if printed:
        yield f"```text\n{printed.rstrip()}\n```"
    for output in cell["outputs"]:
        if "image/png" in (data := output.get("data", {})):
            picture = "".join(_text(data["image/png"]).split())
            yield f'<img alt="figure drawn by the code above" src="data:image/png;base64,{picture}">'
        elif "text/html" in data:
            # One line: Markdown ends a block of HTML at an empty line.
            made = re.sub(r"\s*\n\s*", " ", _text(data["text/html"]))
            yield f'<div class="notebook-output" tabindex="0" role="group" aria-label="output">{made}</div>'
        elif "text/plain" in data:
            yield f"<pre>{html.escape(_text(data['text/plain']))}</pre>"


def _text(lines: str | list[str]) -> str:
    """Text of a cell, which the format keeps whole or in lines."""
    return lines if isinstance(lines, str) else "".join(lines)


def main() -> None:
    """Execute the notebooks that are named, or all, and store their outputs."""
    import nbformat

    for path in [Path(name) for name in sys.argv[1:]] or sorted(FOLDER.glob("*.ipynb")):
        notebook = execute(path)
        for cell in notebook["cells"]:
            cell["metadata"] = {}
        path.write_text(nbformat.writes(nbformat.from_dict(notebook)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
