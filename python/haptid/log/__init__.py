"""Logs: recordings in CSV, Parquet, MAT, NPZ or HDF5, checked, in SI and on a uniform grid."""

from haptid.log.lazy import is_long, open_log
from haptid.log.limits import check_against
from haptid.log.log import Channels, Log, Signal
from haptid.log.on_disk import OnDisk, as_array
from haptid.log.read import read_log

__all__ = ["Channels", "Log", "OnDisk", "Signal", "as_array", "check_against", "is_long", "open_log", "read_log"]
