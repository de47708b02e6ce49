"""What an interrupted run has computed: files in a folder, complete or absent, until the run is complete."""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import ClassVar, Self

from haptid._internal.late import dataclass


@dataclass(frozen=True)
class KeptParts:
    """A folder with one file for each part of the work.

    Attributes:
        folder: created with the first file.
    """

    # What parts are called in messages, and how their files end.
    noun: ClassVar[str] = "parts"
    suffix: ClassVar[str] = ".npz"
    folder: Path

    @classmethod
    def beside(cls, out: Path) -> Self:
        """Of the run that writes a result folder: hidden beside it."""
        target = out.resolve()
        return cls(target.with_name(f".{target.name}.partial"))

    def put(self, path: Path, content: bytes) -> None:
        """Write to a temporary file and rename it, so that a file is complete or absent.

        It is absent where another run into the same results is complete, and deletes the folder, meanwhile.
        """
        with suppress(FileNotFoundError):
            self.folder.mkdir(exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=self.folder, delete=False) as file:
                try:
                    file.write(content)
                    file.close()  # Windows renames no open file
                    os.replace(file.name, path)
                except BaseException:
                    Path(file.name).unlink(missing_ok=True)  # an interruption may come after the renaming
                    raise

    def count(self) -> int:
        """Number of parts, of any run."""
        return len(list(self.folder.glob(f"*{self.suffix}")))

    def forget(self) -> None:
        """Delete the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
