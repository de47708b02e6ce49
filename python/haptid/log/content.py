"""What a file really holds, whatever its name says, and what is refused before it is read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptid.errors import CorruptLogError, LogError, OversizedLogError, WrongContentError

Column: TypeAlias = NDArray[Any]
Address: TypeAlias = tuple[slice | int, ...]

# A member that is larger than this once unpacked, and by more than this ratio to what is stored, is refused.
SIZE_LIMIT = 2**30
RATIO_LIMIT = 200.0
# An array whose shorter side is longer than this is a matrix and not a set of channels.
MOST_CHANNELS = 1000

# No quantity of a robot is larger in any unit; what is comes from damaged bytes, and its square would overflow.
LARGEST = 1e30

MAGIC = (
    (b"PAR1", "Parquet"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"PK\x05\x06", "a ZIP archive"),
    (b"\x89HDF\r\n\x1a\n", "HDF5"),
    (b"MATLAB 5.0", "MAT 5"),
    (b"MATLAB 7.3", "MAT 7.3"),
    (b"\x93NUMPY", "a single NumPy array"),
    (b"\x1f\x8b", "gzip"),
    (b"\xff\xfe", "UTF-16 text"),
    (b"\xfe\xff", "UTF-16 text"),
)


def content(path: Path) -> str:
    """What the first bytes say."""
    with path.open("rb") as file:
        head = file.read(4096)
    for magic, name in MAGIC:
        if head.startswith(magic):
            return name
    return "binary data" if b"\0" in head else "text"


def require(path: Path, kind: str, *wanted: str) -> str:
    """What the file holds, one of those wanted.

    Raises:
        WrongContentError: it holds something else.
    """
    found = content(path)
    if found not in wanted:
        raise WrongContentError(path, kind, found)
    return found


def guard(path: Path, name: str, declared: int, stored: int) -> None:
    """Refuse what unpacks to far more than is stored.

    Raises:
        OversizedLogError: more than `SIZE_LIMIT` bytes, and more than `RATIO_LIMIT` times the stored ones.
    """
    if declared > SIZE_LIMIT and declared > RATIO_LIMIT * stored:
        raise OversizedLogError(path, name, declared, stored, SIZE_LIMIT, RATIO_LIMIT)


@contextmanager
def opened(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a library raises over a bad file into one error; haptid's own errors pass.

    Readers of binary formats raise nearly anything over hostile bytes (ValueError, KeyError, struct.error,
    zlib.error, RuntimeError, ...), hence the wide net.
    """
    try:
        yield
    except LogError:
        raise
    except MemoryError as error:
        raise CorruptLogError(path, kind, "it asks for more memory than there is") from error
    except Exception as error:
        why = str(error).splitlines()[0] if str(error).strip() else type(error).__name__
        raise CorruptLogError(path, kind, why) from error


def usable(column: Column) -> NDArray[np.bool_]:
    """Where a column holds a number that can be reckoned with: finite, and not beyond `LARGEST`."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(column) < LARGEST)


def numeric(dtype: np.dtype[Any]) -> bool:
    """Whether an array of this type can be a channel."""
    return dtype.kind in "iuf"


def addresses(name: str, shape: tuple[int, ...]) -> dict[str, Address]:
    """The channels of an array, each with its index into it.

    A vector, a single row or a single column is one channel of the array's own name. Any other matrix has the
    channels `name[1]`, `name[2]`, ... along its shorter side (along its columns where it is square).
    """
    every = slice(None)
    if len(shape) == 1:
        return {name: (every,)}
    if len(shape) != 2 or shape == (1, 1) or min(shape) > MOST_CHANNELS:
        return {}
    along = shape.index(0) if 0 in shape else int(shape[0] < shape[1])
    count = shape[1 - along]
    if count == 1:
        return {name: (every, 0) if along == 0 else (0, every)}
    return {f"{name}[{k + 1}]": (every, k) if along == 0 else (k, every) for k in range(count)}
