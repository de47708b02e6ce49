"""Executors: a function mapped over items in this process, in processes of this machine, or on a Dask cluster."""

from haptid.executors.cluster import DaskExecutor
from haptid.executors.executor import Executor, SerialExecutor
from haptid.executors.processes import ProcessExecutor

__all__ = ["DaskExecutor", "Executor", "ProcessExecutor", "SerialExecutor"]
