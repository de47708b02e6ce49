"""What a file really holds, whatever its name says, and what is refused before it is read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptid.errors import CorruptLogError, LogError, OversizedLogError, WrongContentError

Column: TypeAlias = NDArray[Any]
Address: TypeAlias = tuple[slice | int, ...]

# A member larger than this once unpacked, and by more than this ratio to its stored bytes, is refused.
SIZE_LIMIT = 2**30
RATIO_LIMIT = 200.0
# An array whose shorter side is longer than this is a matrix and not a set of channels.
MOST_CHANNELS = 1000

# No quantity of a robot is larger in any unit; what is comes from damaged bytes, and powers of it overflow.
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


def all_usable(column: Column) -> bool:
    """Whether it holds nothing else; the extremes tell without a mask of all samples."""
    return column.size == 0 or bool(column.min() > -LARGEST and column.max() < LARGEST)


def numeric(dtype: np.dtype[Any]) -> bool:
    """Whether an array of this type can be a channel."""
    return dtype.kind in "iuf"


def collect(wanted: Sequence[str], columns: Iterator[tuple[str, Column]]) -> dict[str, Column]:
    """Columns as they come, gathered as rows of one float64 block in the order they are wanted.

    A signal's channels are then contiguous and are used where they are: a log is never in memory twice.
    Integers stay apart (stamps in ns need all their digits), and so do channels that lie in a block already.
    """
    places = {name: k for k, name in enumerate(dict.fromkeys(wanted))}
    block: NDArray[np.float64] | None = None
    out: dict[str, Column] = {}
    for name, column in columns:
        if block is None and column.dtype.kind == "f":
            block = np.empty((len(places), column.size))
        if (
            block is None
            or column.dtype.kind != "f"
            or column.size != block.shape[1]
            or block_of([column], len(places)) is not None
        ):
            out[name] = column
        else:
            out[name] = block[places[name]]
            out[name][:] = column
    return out


def block_of(columns: Sequence[Column], most: int) -> NDArray[np.float64] | None:
    """The block, (columns, n), whose rows the columns are in order; None where they do not follow each other.

    Args:
        columns: each (n,); only writable float64 can be a block.
        most: a block this many times larger than a column is not worth keeping in memory for them.
    """
    head = columns[0]
    owner = head.base
    owned = owner.nbytes if isinstance(owner, np.ndarray) else len(owner) if isinstance(owner, bytes) else 0
    if not 0 < owned <= most * head.nbytes:
        return None
    for k, column in enumerate(columns):
        follows = column.base is owner and column.ctypes.data == head.ctypes.data + k * head.nbytes
        plain = column.dtype == np.float64 and column.flags.c_contiguous and column.flags.writeable
        if not (follows and plain and column.size == head.size):
            return None
    return np.lib.stride_tricks.as_strided(head, (len(columns), head.size), (head.nbytes, head.itemsize))


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
