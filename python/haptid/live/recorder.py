"""`Recorder`: samples of frames in their order to a CSV file, what is missing counted exactly.

Frames may come late, twice or not at all. A late one is waited for while no more than some samples are ahead of it;
then what is missing counts as lost. Of all samples between the first and the last of a recording,

    written + lost = last number - first number + 1.

The file grows beside the others as a hidden one and gets its name at the end, so that a crash loses no sample that was
written: `recover` names what was left.
"""

from __future__ import annotations

import bisect
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array, positive
from haptid._internal.late import dataclass
from haptid.errors import LogFileError, SettingError
from haptid.live.frames import SampleFrame

# Samples by which others may be ahead of a late one.
WAIT = 64
# Sequence numbers behind by this and more are those of a sender that was restarted, and no late frame.
_AGAIN = 4096
# Gap in the times of the file where the sender began again, s.
_PAUSE = 1.0
_ENDING = ".part"
# Lost stretches that are remembered, to tell late samples from repeated ones.
_REMEMBERED = 256


@dataclass
class Counts:
    """Samples of a recording so far.

    Attributes:
        written: to the file.
        lost: never came, or too late.
        late: came after they were counted as lost; not written.
        repeated: came more than once; written once.
        restarts: of the sender: the numbers began again.
        refused: frames with other channels than the recording's.
    """

    written: int = 0
    lost: int = 0
    late: int = 0
    repeated: int = 0
    restarts: int = 0
    refused: int = 0


@dataclass(frozen=True, eq=False)
class SampleRun:
    """Samples without a gap, in order.

    Attributes:
        t: of the first sample, s.
        gap: time missing before the first sample, s; 0 where the run continues the last.
        position, torque: (samples, channels).
    """

    t: float
    gap: float
    position: Array
    torque: Array


class Recorder:
    """Writes samples in their order; not safe for several threads at once.

    Args:
        path: of the CSV file, which is there when the recording is closed.
        rate_hz: of the samples.
        names: of the columns: time, positions, torques.
        positions: number of position channels.
        time_unit: seconds in the unit of the time column.
        wait: samples by which others may be ahead of a late one.

    Raises:
        SettingError: a setting out of range.
        LogFileError: the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        rate_hz: float,
        names: Sequence[str],
        positions: int,
        *,
        time_unit: float = 1.0,
        wait: int = WAIT,
    ) -> None:
        if not positive(rate_hz):
            raise SettingError(f"rate_hz is {rate_hz!r}; write a number above zero.", where="rate_hz", found=rate_hz)
        self.path, self.rate_hz, self.counts = path, rate_hz, Counts()
        self._part = path.with_name(f".{path.name}{_ENDING}")
        self._positions, self._torques, self._unit, self._wait = positions, len(names) - 1 - positions, time_unit, wait
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._part.open("x", encoding="utf-8", newline="\n")
        except OSError as error:
            raise LogFileError(f"{path} cannot be written: {error.strerror}.", where=path) from error
        self._file.write(",".join(names) + "\n")
        self._first = self._next = -1  # numbers without wrapping: of the first sample, and of the next in order
        self._base, self._gap = 0.0, 0.0  # time of the first sample; missing before the next run, s
        self._ahead: list[tuple[int, Array]] = []
        self._missing: list[tuple[int, int]] = []

    def take(self, frame: SampleFrame) -> Iterator[SampleRun]:
        """Write what is in order by now, and give it."""
        if (frame.position.shape[1], frame.torque.shape[1]) != (self._positions, self._torques):
            self.counts.refused += 1
            return
        samples = np.concatenate([frame.position, frame.torque], axis=1)
        number = self._unwrapped(frame.number)
        if self._next < 0:
            self._first = self._next = number
        elif number < self._next - _AGAIN:
            yield from self._restarted(frame.number)
            number = self._next
        bisect.insort(self._ahead, (number, samples), key=lambda entry: entry[0])
        yield from self._in_order()
        while self._ahead and self._ahead[-1][0] + len(self._ahead[-1][1]) - self._next > self._wait:
            self._lose(self._ahead[0][0])
            yield from self._in_order()

    def close(self) -> Iterator[SampleRun]:
        """Write what waits, and give the file its name; without a sample there is no file."""
        while self._ahead:
            self._lose(self._ahead[0][0])
            yield from self._in_order()
        self._file.close()
        if self.counts.written:
            os.replace(self._part, self.path)
        else:
            self._part.unlink()

    def _unwrapped(self, number: int) -> int:
        """The number without modulo, nearest to the next one."""
        if self._next < 0:
            return number
        away = (number - self._next) & 0xFFFFFFFF
        return self._next + (away - 2**32 if away >= 2**31 else away)

    def _restarted(self, number: int) -> Iterator[SampleRun]:
        """The sender began again: what waits is written, and the times have a pause."""
        while self._ahead:
            self._lose(self._ahead[0][0])
            yield from self._in_order()
        self.counts.restarts += 1
        self._base += (self._next - self._first) / self.rate_hz + _PAUSE
        self._gap += _PAUSE
        self._first = self._next = number
        self._missing.clear()

    def _in_order(self) -> Iterator[SampleRun]:
        """Runs that continue what was written."""
        while self._ahead and self._ahead[0][0] <= self._next:
            number, samples = self._ahead.pop(0)
            known = min(self._next - number, len(samples))
            for k in range(number, number + known):
                if any(low <= k < high for low, high in self._missing):
                    self.counts.late += 1
                else:
                    self.counts.repeated += 1
            if known < len(samples):
                yield self._written(samples[known:])

    def _lose(self, until: int) -> None:
        """Count what is missing before a number as lost."""
        if until > self._next:
            self.counts.lost += until - self._next
            self._gap += (until - self._next) / self.rate_hz
            self._missing = [*self._missing[1 - _REMEMBERED :], (self._next, until)]
            self._next = until

    def _written(self, samples: Array) -> SampleRun:
        start = self._base + (self._next - self._first) / self.rate_hz
        times = (self._base + (self._next - self._first + np.arange(len(samples))) / self.rate_hz) / self._unit
        rows = np.column_stack([times, samples]).tolist()
        self._file.write("".join(",".join(map(repr, row)) + "\n" for row in rows))
        self._file.flush()
        self._next += len(samples)
        self.counts.written += len(samples)
        made = SampleRun(start, self._gap, samples[:, : self._positions], samples[:, self._positions :])
        self._gap = 0.0
        return made


def recover(folder: Path) -> list[Path]:
    """Give recordings that a crash left in a folder their names, up to their last whole line; the paths."""
    found = []
    for part in sorted(folder.glob(f".*{_ENDING}")):
        path = part.with_name(part.name.removesuffix(_ENDING)[1:])
        while path.exists():
            path = path.with_name(f"{path.stem}-recovered{path.suffix}")
        with part.open("r+b") as file:
            size, back = file.seek(0, os.SEEK_END), 1 << 16
            file.seek(max(0, size - back))
            tail = file.read()
            file.truncate(size - len(tail) + tail.rfind(b"\n") + 1)
        os.replace(part, path)
        found.append(path)
    return found
