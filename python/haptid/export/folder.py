"""What every export is: a folder with some text files, and what the model's validation said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from haptid._internal.atomic_folder import publishing


@dataclass(frozen=True)
class Export:
    """What was written.

    Attributes:
        folder: where.
        files: names of the files in it.
        verdict: on unseen motion, as the files have it.
    """

    folder: Path
    files: tuple[str, ...]
    verdict: str


def write(folder: str | Path, texts: Mapping[str, str], verdict: str) -> Export:
    """Write texts by their files' names; files that are there already are replaced, and only if all goes well.

    Raises:
        OutputError: the folder cannot be written.
    """
    folder = Path(folder)
    with publishing(folder) as scratch:
        for file, text in texts.items():
            path = scratch / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return Export(folder, tuple(texts), verdict)
