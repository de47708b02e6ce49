"""What the files of a data set are reduced to, also on disk, so that an interrupted run goes on with the others."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import asdict, astuple
from pathlib import Path
from typing import ClassVar

import numpy as np

from haptid._internal.kept_parts import KeptParts
from haptid._internal.late import dataclass
from haptid.log.data_set import DataFile
from haptid.observation.observation import MotorRows
from haptid.observation.plan import Block

_ARRAYS = ("columns", "r_factors", "rows")


@dataclass(frozen=True)
class FileWork:
    """What the work on one file took.

    Attributes:
        name: of the file.
        worker: host and number of the process.
        begin: when it began, s since 1970 by the worker's clock.
        fetching, reading, reducing: s of the clock: a copy of a remote file; to a checked log; filters and R factors.
        processor: s of the processor, of all three.
        fetched: bytes of the file.
        returned: bytes of the R factors.
        samples: of the log.
        rows: of all motors.
        problem: why it gives no rows; empty where it does.
    """

    name: str
    worker: str
    begin: float
    fetching: float = 0.0
    reading: float = 0.0
    reducing: float = 0.0
    processor: float = 0.0
    fetched: int = 0
    returned: int = 0
    samples: int = 0
    rows: int = 0
    problem: str = ""

    @property
    def seconds(self) -> float:
        """Of the clock."""
        return self.fetching + self.reading + self.reducing


@dataclass(frozen=True, eq=False)
class ReducedFile:
    """A file's work and its rows; without motors where it has none."""

    work: FileWork
    motors: tuple[MotorRows, ...] = ()
    blocks: tuple[Block, ...] = ()


@dataclass(frozen=True)
class PoolParts(KeptParts):
    """One file for each file of a data set that gives rows, by what these depend on.

    A file is the same where its place, its size and what its file system says of its version are: reading all of them
    again, to compare their content, would take as long as the transfer of a data set. Names alone are not enough: those
    of two robots that record together agree, and so may sizes and, from an archive, times in whole seconds.
    """

    noun: ClassVar[str] = "files"

    def read(self, study: str, file: DataFile) -> ReducedFile | None:
        """What a file was reduced to; None where that is not there, or cannot be read.

        Args:
            study: fingerprint of all that the rows depend on besides the file.
            file: of the data set.
        """
        try:
            with self._path(study, file).open("rb") as stream, np.load(stream) as stored:
                head = json.loads(str(stored["head"]))
                motors = tuple(
                    MotorRows(**one, **{key: stored[f"{key} {k}"] for key in _ARRAYS})
                    for k, one in enumerate(head["motors"])
                )
            return ReducedFile(FileWork(**head["work"]), motors, tuple(Block(*one) for one in head["blocks"]))
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            return None

    def write(self, study: str, file: DataFile, one: ReducedFile) -> None:
        """Keep what a file was reduced to."""
        motors = [
            {name: getattr(motor, name) for name in ("name", "label", "unit", "rounding", "free")}
            for motor in one.motors
        ]
        blocks = [(block.log, block.start, block.stop) for block in one.blocks]
        head = json.dumps({"work": asdict(one.work), "motors": motors, "blocks": blocks})
        arrays = {f"{key} {k}": getattr(motor, key) for k, motor in enumerate(one.motors) for key in _ARRAYS}
        buffer = io.BytesIO()
        np.savez(buffer, head=np.array(head), **arrays)
        self.put(self._path(study, file), buffer.getvalue())

    def _path(self, study: str, file: DataFile) -> Path:
        content = json.dumps((study, *astuple(file)))
        return self.folder / (hashlib.sha256(content.encode()).hexdigest()[:24] + self.suffix)
