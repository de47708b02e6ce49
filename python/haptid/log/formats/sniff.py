"""Content of a log file by its first bytes, checks before it is read, its channels, and guesses of what they are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.bounded_files import LOG_MEMBERS, LOG_UNPACKED, amount_text
from haptid._internal.numerals import whole_number
from haptid.errors import HaptidError, LogChannelError, LogFileError
from haptid.log import units
from haptid.log.formats.encoding import UTF_16_MARKS
from haptid.log.formats.mat4_header import is_mat4
from haptid.log.log import Channels, Signal

RawChannel: TypeAlias = NDArray[Any]
Address: TypeAlias = tuple[slice | int, ...]

# A file whose arrays together unpack to more than LOG_UNPACKED, and to more than this ratio to its bytes, is refused.
RATIO_LIMIT = 200.0
# An array whose shorter side is longer than this is a matrix and not a set of channels.
MOST_CHANNELS = 1000
# Samples of a trial at least, in an array of several; fewer poses are enough where the other sides are half as long.
_LEAST_TRIAL, _LEAST_POSES = 50, 20

MAGIC = (
    (b"PAR1", "Parquet"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"PK\x05\x06", "a ZIP archive"),
    (b"\x89HDF\r\n\x1a\n", "HDF5"),
    (b"MATLAB 5.0", "MAT 5"),
    (b"MATLAB 7.3", "MAT 7.3"),
    (b"\x93NUMPY", "a single NumPy array"),
    (b"TDSm", "TDMS"),
    (b"\x89MCAP", "MCAP"),
    (b"#ROSBAG", "a ROS bag"),
    (b"SQLite format 3", "SQLite"),
    (b"\x1f\x8b", "gzip"),
    *((mark, "UTF-16 text") for mark in UTF_16_MARKS),
)

# Names that most recorders use: t, q1..qn and tau1..taun.
WHERE = r"(?P<where>(?:.*\.)?)"
_NUMBER = r"_?\[?(?P<number>\d{1,9})\]?"
_TIME = re.compile(WHERE + r"(?:t|time)(?:_(?P<unit>s|ms|us|ns))?", re.IGNORECASE)
_POSITION = re.compile(WHERE + r"(?P<family>q|pos|position)" + _NUMBER, re.IGNORECASE)
_TORQUE = re.compile(WHERE + r"(?P<family>tau|torque|u)" + _NUMBER, re.IGNORECASE)
_ELEMENT = re.compile(r"\[[^\[\] ]*\]$")
_SINGLE = {"position": ("q", "pos", "position"), "torque": ("tau", "torque", "u")}


def content(path: Path) -> str:
    """Kind of content, by the first bytes."""
    with path.open("rb") as file:
        head = file.read(4096)
    if head[124:128] in (b"\0\2IM", b"\2\0MI"):  # the version in the header; its text may say another
        return "MAT 7.3"
    for magic, name in MAGIC:
        if head.startswith(magic):
            return name
    if is_mat4(head):
        return "MAT 4"
    return "binary data" if b"\0" in head else "text"


def require(path: Path, kind: str, *wanted: str) -> str:
    """Kind of content of a file, which must be one of those wanted.

    Raises:
        LogFileError: it holds something else.
    """
    found = content(path)
    if found not in wanted:
        raise LogFileError(
            f"{path} is named as {kind}, but it holds {found}.",
            where=path,
            found=found,
            limit=kind,
            advice="Rename it, or export it again.",
        )
    return found


class Budget:
    """Bytes that the arrays of one file may unpack to, counted over all of them.

    Args:
        path: of the file.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.taken, self.stored = path, 0, path.stat().st_size

    def take(self, name: str, declared: int) -> None:
        """Count an array before it is read.

        Raises:
            LogFileError: the sum is more than `LOG_UNPACKED` bytes, and more than `RATIO_LIMIT` times the file's.
        """
        self.taken += declared
        most = LOG_UNPACKED.value
        if self.taken > most and self.taken > RATIO_LIMIT * self.stored:
            raise LogFileError(
                f"{self.path}: with {name} its arrays unpack to {amount_text(self.taken)}, from "
                f"{amount_text(self.stored)} stored; above {amount_text(most)} at most {RATIO_LIMIT:.0f} times the "
                f"stored size is accepted.",
                where=name,
                found=self.taken,
                limit=max(most, RATIO_LIMIT * self.stored),
                advice=f"If the file is yours, save it without compression, or set {LOG_UNPACKED.variable}.",
            )


def check_members(path: Path, count: int, noun: str) -> None:
    """Raise LogFileError where a file has more columns, arrays or datasets than a log has."""
    if count > LOG_MEMBERS.value:
        raise LogFileError(
            f"{path} has more than {LOG_MEMBERS.value} {noun}, so it is no log.",
            where=path,
            found=count,
            limit=LOG_MEMBERS.value,
            advice=f"Export the channels of the motion alone, or set {LOG_MEMBERS.variable}.",
        )


# What no bytes of a file can cause, in any library; and what haptid's own code raises by mistake only.
_NEVER_DATA = (NameError, ImportError)
_BUGS = (AttributeError, TypeError, AssertionError)


@contextmanager
def opened_file(path: Path, kind: str) -> Iterator[None]:
    """Convert exceptions over a file's content into LogFileError; haptid's own errors pass, and so does a bug.

    Libraries raise nearly any class over damaged bytes (ValueError, KeyError, struct.error, zlib.error, RuntimeError,
    TypeError from within, ...). One of `_BUGS` that haptid's own code raises is a mistake of that code, which no other
    file would mend.
    """
    try:
        yield
    except HaptidError:
        raise
    except MemoryError as error:
        raise corrupt(path, kind, "it requires more memory than is available") from error
    except Exception as error:
        if isinstance(error, _NEVER_DATA) or (isinstance(error, _BUGS) and _raised_here(error)):
            raise
        why = str(error).splitlines()[0] if str(error).strip() else type(error).__name__
        raise corrupt(path, kind, why) from error


def _raised_here(error: BaseException) -> bool:
    """Whether the innermost Python frame of an exception is of haptid."""
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    return at is not None and str(at.tb_frame.f_globals.get("__name__", "")).startswith("haptid.")


def corrupt(path: Path, kind: str, why: str) -> LogFileError:
    """Error of a file whose content cannot be read."""
    return LogFileError(
        f"{path} is damaged or cut short: its {kind} content cannot be read ({why.strip().rstrip('.')}).",
        where=path,
        limit=kind,
        advice="Copy or export it again.",
    )


def empty(path: Path, what: str) -> LogFileError:
    """Error of a file without samples."""
    return LogFileError(
        f"{path} has {what}, so it contains no motion.", where=path, advice="Record or export the log again."
    )


def not_numeric(path: Path, name: str, found: str) -> LogFileError:
    """Error of a channel that holds no real numbers."""
    return LogFileError(
        f"{path}: channel {name!r} holds {found}, not real numbers.",
        where=name,
        found=found,
        advice="Save it as floats or integers (calendar stamps as integers, with time_unit).",
    )


def repeated_name(path: Path, name: str, advice: str = "Rename one of them.") -> LogFileError:
    """Error of two columns with one name."""
    return LogFileError(f"{path}: two columns are named {name!r}.", where=name, advice=advice)


def channel_list(names: Sequence[str], most: int = 24) -> str:
    """The first names of a list as text, elements of one array together, and how many more there are.

    Columns of a matrix are `name[1..n]`, named elements `name[a, b]`.
    """
    elements: dict[str, list[str]] = {}
    for name in names:
        array = _ELEMENT.sub("", name)
        elements.setdefault(array, []).extend([name[len(array) + 1 : -1]] if array != name else [])
    groups = [f"{name}[{_elements(inner)}]" if inner else name for name, inner in elements.items()]
    shown = ", ".join(groups[:most])
    return f"{shown} and {len(groups) - most} more" if len(groups) > most else shown or "none"


def _elements(inner: list[str]) -> str:
    first = whole_number(inner[0])
    if first is not None and len(inner) > 1 and inner == [str(first + k) for k in range(len(inner))]:
        return f"{inner[0]}..{inner[-1]}"
    return ", ".join(inner[:12]) + (f" and {len(inner) - 12} more" if len(inner) > 12 else "")


def numeric(dtype: np.dtype[Any]) -> bool:
    """Whether arrays of this type are numbers, and so can be channels."""
    return dtype.kind in "iuf"


def collect(wanted: Sequence[str], columns: Iterator[tuple[str, RawChannel]]) -> dict[str, RawChannel]:
    """Columns as they come, stored as rows of one float64 block in the order they are wanted.

    A signal's channels are then contiguous and are used in place: a log is never in memory twice. Integers stay
    separate (stamps in ns need all their digits), and so do channels that are in a block already.
    """
    places = {name: k for k, name in enumerate(dict.fromkeys(wanted))}
    block: NDArray[np.float64] | None = None
    out: dict[str, RawChannel] = {}
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


def block_of(columns: Sequence[RawChannel], most: int) -> NDArray[np.float64] | None:
    """The block, (columns, n), whose consecutive rows the columns are; None where they are not.

    Args:
        columns: each (n,); only writable float64 can be a block.
        most: a block larger than this many columns is not kept in memory for them.
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


def array_names(path: Path, arrays: Mapping[str, Array], noun: str) -> list[str]:
    """Channels of the arrays that a file was read into.

    Raises:
        LogFileError: more than a log has.
    """
    found = [channel for name, array in arrays.items() for channel in addresses(name, array.shape)]
    check_members(path, len(found), noun)
    return found


def array_columns(wanted: Sequence[str], arrays: Mapping[str, Array]) -> dict[str, RawChannel]:
    """The wanted ones of these channels."""
    every = ((own, array[at]) for name, array in arrays.items() for own, at in addresses(name, array.shape).items())
    return collect(wanted, ((own, column) for own, column in every if own in wanted))


def addresses(name: str, shape: tuple[int, ...]) -> dict[str, Address]:
    """Channels of an array, each with its index into it.

    A vector, a single row or a single column is one channel of the array's own name. Any other matrix has the
    channels `name[1]`, `name[2]`, ... along its shorter side (along its columns where it is square). Sides of one
    element are left out, as of Simulink's arrays of 7 x 1 x n. An array of trials has `name[trial][channel]`: its
    longest side is that of the samples, and that of the trials is the first, or the last where the samples' is first.
    """
    every = slice(None)
    sides = [k for k, count in enumerate(shape) if count != 1]
    if len(shape) > 2 and 0 < len(sides) <= 2:
        inner = addresses(name, tuple(shape[k] for k in sides))
        return {own: _within(at, sides, len(shape)) for own, at in inner.items()}
    if len(shape) == 3 and 0 not in shape and max(shape) >= min(_LEAST_TRIAL, max(_LEAST_POSES, 2 * sorted(shape)[1])):
        return _of_trials(name, shape)
    if len(shape) == 1:
        return {name: (every,)}
    if len(shape) != 2 or shape == (1, 1):
        return {}
    along = shape.index(0) if 0 in shape else int(shape[0] < shape[1])
    count = shape[1 - along]
    if count > MOST_CHANNELS:
        return {}
    if count == 1:
        return {name: (every, 0) if along == 0 else (0, every)}
    return {f"{name}[{k + 1}]": (every, k) if along == 0 else (k, every) for k in range(count)}


def _of_trials(name: str, shape: tuple[int, ...]) -> dict[str, Address]:
    """Channels of an array of trials."""
    along = shape.index(max(shape))
    trial = 0 if along else 2
    channel = 3 - along - trial
    if shape[trial] * shape[channel] > MOST_CHANNELS:
        return {}
    made: dict[str, Address] = {}
    for i in range(shape[trial]):
        for k in range(shape[channel]):
            at: dict[int, slice | int] = {along: slice(None), trial: i, channel: k}
            made[f"{name}[{i + 1}][{k + 1}]"] = tuple(at[side] for side in range(3))
    return made


def _within(at: Address, sides: Sequence[int], dimensions: int) -> Address:
    """Index into an array whose other sides have one element."""
    whole: list[slice | int] = [0] * dimensions
    for side, part in zip(sides, at, strict=True):
        whole[side] = part
    return tuple(whole)


def guess(path: Path, names: Sequence[str], stated: Mapping[str, str]) -> tuple[Channels, str]:
    """Channels by their names, in rad and N m at the joints, and a note of what was chosen.

    Args:
        path, names: of the file and its channels.
        stated: units that the file states, by channel.

    Raises:
        LogChannelError: there are none, the choice is not unique, or the file states another unit.
    """
    times = [(name, match) for name in names if (match := _TIME.fullmatch(name))]
    if len(times) != 1:
        found = "no time channel" if not times else f"{len(times)} time channels ({', '.join(n for n, _ in times)})"
        raise _not_guessed(path, f"{found} found by name", names)
    (time, match) = times[0]
    position = _numbered(path, names, _POSITION, "position")
    torque = _numbered(path, names, _TORQUE, "torque")
    unit = (match["unit"] or "s").lower()
    for kind, taken, chosen in (("time", unit, (time,)), ("position", "rad", position), ("torque", "N m", torque)):
        for name in chosen:
            stated_unit = stated.get(name)
            if stated_unit is not None and units.closest_unit(stated_unit, kind) != taken:  # type: ignore[arg-type]
                raise LogChannelError(
                    f"{path}: without `channels`, {name!r} is taken in {taken}, and the file states {stated_unit}.",
                    where=name,
                    found=stated_unit,
                    limit=taken,
                    advice="Give `[channels]` with their units; `haptid channels` prints the table.",
                )
    channels = Channels(Signal(position, "rad"), Signal(torque, "N m"), time=time, time_unit=unit)
    sentence = (
        f"channels were not given; taken: time {time} in {unit}, positions {', '.join(position)} in rad, "
        f"torques {', '.join(torque)} in N m, both at the joints"
    )
    return channels, sentence


def _numbered(path: Path, names: Sequence[str], pattern: re.Pattern[str], kind: str) -> tuple[str, ...]:
    """The only family of numbered channels, in order."""
    families: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if match := pattern.fullmatch(name):
            family = families.setdefault((match["where"], match["family"].lower()), {})
            if family.setdefault(int(match["number"]), name) != name:
                raise _not_guessed(path, f"{family[int(match['number'])]} and {name} have one number", names)
    if not families:
        alone = [name for name in names if name.rpartition(".")[2].lower() in _SINGLE[kind]]
        if len(alone) == 1:
            return (alone[0],)
        raise _not_guessed(path, f"no {kind} channels found by name", names)
    if len(families) > 1:
        firsts = ", ".join(family[min(family)] for family in families.values())
        raise _not_guessed(path, f"more than one set of {kind} channels ({firsts}, ...) found by name", names)
    (family,) = families.values()
    order = sorted(family)
    if order[0] > 1 or order[-1] - order[0] + 1 != len(order):
        found = ", ".join(family[k] for k in order)
        raise _not_guessed(path, f"{kind} channels {found} are not numbered without a gap from 1", names)
    return tuple(family[k] for k in order)


def _not_guessed(path: Path, what: str, names: Sequence[str]) -> LogChannelError:
    """Error of a file whose channels' names are not conventional."""
    return LogChannelError(
        f"{path}: {what}.",
        where=path,
        found=tuple(names),
        advice="Without `channels`, haptid takes t or time, q1..qn (or pos1, position1) and tau1..taun (or torque1, "
        "u1). Name the channels with haptid.Channels, or in `[channels]` of a study file (`haptid channels` prints the "
        f"table). Channels of this file: {channel_list(names)}.",
    )


def group_of(name: str) -> str:
    """The group of a channel, `drive` of `drive.current[1]`; empty where it is in none."""
    return name.partition("[")[0].rpartition(".")[0]
