"""What can be wrong where work is done by others."""

from __future__ import annotations

from haptid.errors._both import ExecutorError, MissingDependencyError, SettingError


class WorkerCountError(SettingError):
    """No worker at all."""

    def __init__(self, count: int) -> None:
        super().__init__(f"{count} workers do nothing. Write 1 or more.")


class WorkerLostError(ExecutorError):
    """An item of work that was lost with one worker after the other."""

    def __init__(self, item: int, losses: int) -> None:
        super().__init__(
            f"part {item + 1} of the work was lost {losses} times, each time as the process that had it ended. Look "
            f"for what ends it: too little memory, as a rule. Use fewer workers, or machines with more memory."
        )


class DistributedMissingError(MissingDependencyError):
    """A cluster without the package that talks to it."""

    def __init__(self) -> None:
        super().__init__('a cluster needs Dask distributed: pip install "haptid[cluster]".')


class ClusterError(ExecutorError):
    """A scheduler that does not answer."""

    def __init__(self, address: str, why: str) -> None:
        super().__init__(
            f"no Dask scheduler answers at {address}: {why}. Start one with `dask scheduler`, workers with `dask "
            f"worker ADDRESS`, and give the address that the scheduler prints."
        )
