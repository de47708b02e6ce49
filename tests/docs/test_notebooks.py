"""The notebooks of the documentation run from top to bottom, and their pages have what they print and draw."""

import json
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT / "tools" / "site"))
from notebooks import FOLDER, as_markdown, execute  # noqa: E402

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def kinds(notebook: dict) -> list[set[str]]:
    """What each cell puts out: text, tables, pictures; not progress, which only slow machines show."""
    made = []
    for cell in notebook["cells"]:
        outputs = [one for one in cell.get("outputs", []) if one.get("name") != "stderr"]
        made.append({kind for one in outputs for kind in one.get("data", {one["output_type"]: None})})
    return made


@pytest.mark.filterwarnings("ignore")  # of the notebook libraries
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_puts_out_what_is_stored(path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(PROJECT / "python"))
    assert kinds(execute(path)) == kinds(json.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_page_of_a_notebook_has_its_outputs(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    page = as_markdown(notebook)
    assert page.startswith("# ")
    assert page.count("data:image/png;base64,") == sum("image/png" in kinds for kinds in kinds(notebook))
    assert page.count("```python") == sum(cell["cell_type"] == "code" for cell in notebook["cells"])
    # Nothing of the machine that executed it.
    assert not any(place in page for place in ("/tmp/", "/home/", str(PROJECT)))


def test_every_notebook_is_in_the_contents():
    contents = (PROJECT / "mkdocs.yml").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) == 5
    for path in NOTEBOOKS:
        assert f"notebooks/{path.stem}.md" in contents
