"""Logs: recordings in tables, bags of messages and data sets, checked, in SI and on a uniform grid.

May not use any device: `check_against` takes joint limits as numbers.
"""

from haptid.log.copies import same_samples
from haptid.log.formats.folders import log_size
from haptid.log.lazy import OnDisk, PartlyInMemory, as_array
from haptid.log.limit_checks import check_against
from haptid.log.log import Channels, Log, Signal
from haptid.log.read import is_long, open_log, read_log
from haptid.log.request import Merge
from haptid.log.time_base import TimeBaseReport

__all__ = [
    "Channels",
    "Log",
    "Merge",
    "OnDisk",
    "PartlyInMemory",
    "Signal",
    "TimeBaseReport",
    "as_array",
    "check_against",
    "is_long",
    "log_size",
    "open_log",
    "read_log",
    "same_samples",
]
