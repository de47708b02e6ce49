"""Comparison page of several results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from haptid._core import __version__
from haptid._internal.atomic_folder import write_file
from haptid.report.page import page
from haptid.report.sections.comparison import ComparisonSection
from haptid.results.result import Result


def write_comparison(folders: Sequence[str | Path], path: str | Path) -> ComparisonSection:
    """Write a page that compares the output folders of `haptid identify`, each with the first.

    Args:
        folders: two or more.
        path: of the page.

    Raises:
        ResultFileError: a folder has no result that can be read.
        ModelMismatchError: a result has no parameter in common with the first.
        OutputFolderError: the page cannot be written there.
    """
    results = [Result.load(folder) for folder in folders]
    section = ComparisonSection.between(results, names_of([Path(folder) for folder in folders]))
    title = f"Comparison of {len(results)} results"
    about = f"{', '.join(dict.fromkeys(r.model.device.name for r in results))}, haptid {__version__}"
    write_file(Path(path), page(title, about, (section,)))
    return section


def names_of(folders: Sequence[Path]) -> list[str]:
    """Short names of folders, longer where two would be equal."""
    resolved = [folder.resolve() for folder in folders]
    for parts in range(1, max(len(path.parts) for path in resolved) + 1):
        names = ["/".join(path.parts[-parts:]) for path in resolved]
        if len(set(names)) == len(names):
            return names
    return [f"{k + 1}: {path.name}" for k, path in enumerate(resolved)]
