"""`WorkbenchFolder`: the folder of plain files that the workbench shows, and the one way in which it writes them.

The layout is that of a project on the command line: `devices/`, `studies/`, `experiments/` (TOML), `logs/` (as they
were dropped, never changed) and `results/` (folders of `haptid identify`). `.haptid/` has the index and the records of
jobs, and can be deleted.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from haptid._internal.atomic_folder import write_file
from haptid.errors import WorkbenchError

# Folders of the layout, and the largest text that is edited, bytes.
DEVICES, STUDIES, EXPERIMENTS, LOGS, RESULTS, EXPORTS = (
    "devices",
    "studies",
    "experiments",
    "logs",
    "results",
    "exports",
)
_OWN = ".haptid"
_EDITED, _LARGEST_TEXT = (DEVICES, STUDIES, EXPERIMENTS), 2**20
# Names that work on Windows, macOS and Linux, and on a command line without quotes.
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,99}")
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


class StaleFileError(WorkbenchError):
    """A file was changed since the page read it; `found` is its present text."""


class WorkbenchFolder:
    """The folder, resolved; every path of a request goes through `inside`.

    Args:
        folder: exists.

    Raises:
        WorkbenchError: it is no folder.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).resolve()
        if not self.folder.is_dir():
            raise WorkbenchError(
                f"{folder} is no folder.",
                where=str(folder),
                advice="Give the folder of your devices, logs and results.",
            )

    def inside(self, name: str, *folders: str) -> Path:
        """The path of a name that a page gave: relative, with `/`, below the folder also after symbolic links.

        Args:
            name: such as "logs/sweep.parquet".
            folders: first parts that are allowed; all of the layout if left out.

        Raises:
            WorkbenchError: it leads elsewhere.
        """
        allowed = folders or (DEVICES, STUDIES, EXPERIMENTS, LOGS, RESULTS, EXPORTS)
        parts = PurePosixPath(name).parts
        plain = all(part not in ("..", ".", "/") and not re.search(r'[\\:\0-\x1f<>|?*"]', part) for part in parts)
        if not plain or len(parts) < 2 or parts[0] not in allowed or "/".join(parts) != name:
            raise _outside(name, allowed)
        path = self.folder.joinpath(*parts)
        if not path.resolve().is_relative_to(self.folder / parts[0]):
            raise _outside(name, allowed)
        return path

    def edited(self, name: str) -> Path:
        """The path of a TOML file right in devices/, studies/ or experiments/.

        Raises:
            WorkbenchError: it is none.
        """
        path = self.inside(name, *_EDITED)
        if name.count("/") != 1:
            raise _outside(name, _EDITED)
        self.check_name(path.name, ".toml")
        return path

    def name_of(self, path: Path) -> str:
        """The path of a file as pages name it: relative, with `/`."""
        return path.relative_to(self.folder).as_posix()

    def read_text(self, name: str) -> tuple[str, str]:
        """The text of an edited file, and its SHA-256.

        Raises:
            WorkbenchError: it cannot be read, is too large or is not UTF-8.
        """
        path = self.edited(name)
        try:
            if path.stat().st_size > _LARGEST_TEXT:
                raise WorkbenchError(f"{name} has more than {_LARGEST_TEXT} bytes: no text that is edited here.")
            content = path.read_bytes()
            return content.decode("utf-8"), hashlib.sha256(content).hexdigest()
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or "it is not UTF-8"
            raise WorkbenchError(f"{name} cannot be read: {why}.", where=name) from error

    def save_text(self, name: str, text: str, known: str) -> str:
        """Write an edited file in one step; its new SHA-256.

        Args:
            name: of a TOML file in devices/, studies/ or experiments/.
            text: new content.
            known: SHA-256 of the content that the page had read; empty for a new file.

        Raises:
            StaleFileError: the file has another content by now.
            WorkbenchError: it cannot be written there.
        """
        path = self.edited(name)
        current = self.read_text(name) if path.exists() else ("", "")
        if current[1] != known:
            said = "was changed by another program or tab" if current[1] else "is not there any more"
            raise StaleFileError(
                f"{name} {said} since this page read it; nothing was written.", where=name, found=current[0]
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text)
        return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()

    @contextmanager
    def beside(self, name: str, text: str) -> Iterator[Path]:
        """A hidden copy of a text where its file is, or will be: what it names is found from there."""
        place = self.edited(name).parent
        place.mkdir(parents=True, exist_ok=True)
        path = place / f".unsaved-{secrets.token_hex(6)}.toml"
        try:
            path.write_text(text, encoding="utf-8", errors="backslashreplace")
            yield path
        finally:
            path.unlink(missing_ok=True)

    def check_name(self, name: str, *endings: str) -> None:
        """Raise WorkbenchError unless a file can have this name on every system."""
        if not _NAME.fullmatch(name) or _RESERVED.fullmatch(name) or name.endswith("."):
            raise WorkbenchError(
                f"{name[:60]!r} is no name for a file here.",
                where=name,
                advice="Use letters, digits, and . _ + - after the first character; at most 100.",
            )
        if endings and not name.lower().endswith(endings):
            raise WorkbenchError(f"{name!r} must end in {' or '.join(endings)}.", where=name, limit=endings)

    def own(self) -> Path:
        """The folder of derived files (index, records of jobs), created at its first use."""
        path = self.folder / _OWN
        path.mkdir(exist_ok=True)
        return path


def _outside(name: str, allowed: tuple[str, ...]) -> WorkbenchError:
    return WorkbenchError(
        f"{name[:200]!r} is not a path in this workbench.",
        where=name[:200],
        limit=allowed,
        advice=f"Paths begin with {', '.join(f'{one}/' for one in allowed)} and stay below the folder.",
    )


def free_name(folder: Path, name: str) -> Path:
    """The path of a name in a folder, with a number before its ending where that is taken: `sweep-2.csv`."""
    path, stem, ending = folder / name, name.partition(".")[0], "".join(f".{part}" for part in name.split(".")[1:])
    count = 2
    while os.path.lexists(path):
        path, count = folder / f"{stem}-{count}{ending}", count + 1
    return path
