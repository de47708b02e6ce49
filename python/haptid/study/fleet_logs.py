"""Logs of a fleet: those below a folder, by device and day."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from haptid._internal.late import dataclass
from haptid.errors import LogFileError
from haptid.log.file_format import FORMATS

SECONDS_IN_DAY = 86400.0
# A date in a name, with the time of the day where it follows.
_DATE = re.compile(
    r"(?<!\d)(20\d\d)-?([01]\d)-?([0-3]\d)(?:[T_ -]?([0-2]\d)[-:h]?([0-5]\d)(?:[-:m]?([0-5]\d))?)?(?!\d)"
)


@dataclass(frozen=True)
class FleetLog:
    """A log of a fleet.

    Attributes:
        device: name of the folder that it lies in.
        path: of the file.
        day: when it was recorded, days since 1970.
    """

    device: str
    path: Path
    day: float


def fleet_logs(folder: Path) -> tuple[tuple[FleetLog, ...], str]:
    """The logs below a folder by device and day, and where the days are from.

    Each folder in it is a device; files of the folder itself are of a device of its name. Days are dates in the names
    of files, such as 2026-03-02 or 20260302T1400; where a name has none, times of modification are taken for all.

    Raises:
        LogFileError: no file there has the suffix of a log.
    """
    suffixes = {suffix for kind in FORMATS for suffix in kind.suffixes}
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in suffixes and path.is_file())
    paths = [path for path in paths if not any(part.startswith(".") for part in path.relative_to(folder).parts)]
    if not paths:
        raise LogFileError(
            f"{folder} has no logs.",
            where=folder,
            limit=tuple(sorted(suffixes)),
            advice="Give the folder of the fleet: a folder for each device with its logs in it.",
        )
    named = [day for path in paths if (day := day_in(path.name)) is not None]
    whole = len(named) == len(paths)
    days = named if whole else [path.stat().st_mtime / SECONDS_IN_DAY for path in paths]
    own = folder.resolve().name
    devices = [parts[0] if len(parts := path.relative_to(folder).parts) > 1 else own for path in paths]
    logs = sorted(map(FleetLog, devices, paths, days), key=lambda log: (log.device, log.day, log.path))
    return tuple(logs), "file names" if whole else "modification times"


def day_in(name: str) -> float | None:
    """The date in a name as days since 1970, taken as UTC; None without one."""
    for found in _DATE.finditer(name):
        year, month, day, hour, minute, second = (int(part or 0) for part in found.groups())
        try:
            return datetime(year, month, day, hour, minute, second, tzinfo=UTC).timestamp() / SECONDS_IN_DAY
        except ValueError:  # such as a thirteenth month
            continue
    return None
