"""What can be wrong where several estimates are compared."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.errors._both import SettingError


class FewEstimatesError(SettingError):
    """Fewer estimates than can be compared."""

    def __init__(self, count: int, least: int) -> None:
        super().__init__(f"{count} estimates cannot be compared; give {least} or more.")


class LabelCountError(SettingError):
    """Labels that do not name every estimate, or two alike."""

    def __init__(self, labels: Sequence[str], estimates: int) -> None:
        super().__init__(
            f"{len(set(labels))} different labels are given for {estimates} estimates, {list(labels)!r}; give one for "
            f"each."
        )


class TimeCountError(SettingError):
    """Times that do not belong to every estimate."""

    def __init__(self, times: int, estimates: int) -> None:
        super().__init__(f"{times} times are given for {estimates} estimates; give one for each.")


class TimeValueError(SettingError):
    """Times along which nothing can drift."""

    def __init__(self, times: Sequence[float]) -> None:
        super().__init__(f"the times are {list(times)!r}; give finite numbers, two different ones at least.")
