"""Bounded reading of files: regular files only, and of each kind of input at most so much; see docs/limits.md."""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Callable
from typing import BinaryIO

from haptid._internal.late import dataclass
from haptid.errors import SettingError

_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
# Without waiting at a named pipe, and without line-end conversion where the system knows one.
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


@dataclass(frozen=True)
class Limit:
    """The largest amount of one kind of input.

    Attributes:
        name: of the limit; the environment variable `HAPTID_LIMIT_` + name replaces its default.
        default: in bytes, or a count.
        meaning: what is limited.
        counted: whether it is a count and not a number of bytes.
    """

    name: str
    default: int
    meaning: str
    counted: bool = False

    @property
    def variable(self) -> str:
        """The environment variable."""
        return f"HAPTID_LIMIT_{self.name}"

    @property
    def value(self) -> int:
        """The limit in force.

        Raises:
            SettingError: the environment variable is no positive number, with K, M, G or T for powers of 1024.
        """
        text = os.environ.get(self.variable)
        if text is None:
            return self.default
        match = re.fullmatch(r"([1-9][0-9]{0,14})([KMGT]?)(?:i?B)?", text.strip(), re.ASCII)
        if not match:
            raise SettingError(
                f"the environment variable {self.variable} is {text!r}, not a number such as 4096 or 8G.",
                where=self.variable,
                found=text,
                advice="Correct it, or unset it.",
            )
        return int(match[1]) * _UNITS[match[2]]

    def shown(self, amount: int | None = None) -> str:
        """An amount, or the limit itself, as text with its unit."""
        return amount_text(self.value if amount is None else amount, self.counted)


DEFINITION_FILE = Limit("DEFINITION_FILE", 2**20, "bytes of a device, study, experiment or other TOML file")
ROBOT_FILE = Limit("ROBOT_FILE", 2**25, "bytes of a robot description")
RESULT_FILE = Limit("RESULT_FILE", 2**26, "bytes of result.json")
REPORT_DATA = Limit("REPORT_DATA", 2**28, "bytes of the data of a report, unpacked")
LOG_FILE = Limit("LOG_FILE", 2**36, "bytes of a log file")
LOG_UNPACKED = Limit(
    "LOG_UNPACKED", 2**30, "bytes of all arrays that a log unpacks to, where they are 200 times those stored"
)
LOG_MEMBERS = Limit("LOG_MEMBERS", 10_000, "columns, arrays or datasets of a log file", counted=True)
SYMBOLIC_JOINTS = Limit("SYMBOLIC_JOINTS", 24, "joints of a device whose lengths are taken as symbols", counted=True)
BASE_PARAMETERS = Limit(
    "BASE_PARAMETERS", 400, "base parameters that are identified together; the time grows with their cube", counted=True
)
LIMITS = (
    *(DEFINITION_FILE, ROBOT_FILE, RESULT_FILE, REPORT_DATA, LOG_FILE, LOG_UNPACKED, LOG_MEMBERS),
    *(SYMBOLIC_JOINTS, BASE_PARAMETERS),
)


def amount_text(amount: int, counted: bool = False) -> str:
    """A count, or a number of bytes in its largest binary unit."""
    if counted or amount < 1024:
        return f"{amount}" if counted else f"{amount} bytes"
    power = min((amount.bit_length() - 1) // 10, 4)
    return f"{amount / 1024**power:.4g} {'KMGT'[power - 1]}iB"


def open_regular(path: str | os.PathLike[str], limit: Limit) -> BinaryIO:
    """Open a regular file of at most so many bytes; a pipe, a device or a folder is refused without reading it.

    Raises:
        OSError: it cannot be opened, is no regular file (EINVAL) or is larger (EFBIG); `strerror` says which.
    """
    handle = os.open(path, _FLAGS)
    try:
        status = os.fstat(handle)
        if stat.S_ISDIR(status.st_mode):
            raise OSError(errno.EISDIR, "it is a folder", str(path))
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        if status.st_size > limit.value:
            raise too_large(path, limit, status.st_size)
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_bounded(path: str | os.PathLike[str], limit: Limit) -> bytes:
    """The bytes of a regular file.

    Raises:
        OSError: as of `open_regular`.
    """
    with open_regular(path, limit) as file:
        return read_at_most(file.read, path, limit)


def read_at_most(read: Callable[[int], bytes], path: str | os.PathLike[str], limit: Limit) -> bytes:
    """All bytes of an open stream, such as one that unpacks.

    Raises:
        OSError: there are more (EFBIG).
    """
    most = limit.value
    content = read(most + 1)
    if len(content) > most:
        raise too_large(path, limit, None)
    return content


def too_large(path: str | os.PathLike[str], limit: Limit, found: int | None) -> OSError:
    """The error of a file with too much in it."""
    size = "more" if found is None else limit.shown(found)
    why = f"it has {size}, and at most {limit.shown()} are read; {limit.variable} sets another limit"
    return OSError(errno.EFBIG, why, str(path))
