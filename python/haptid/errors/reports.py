"""What can be wrong with making a report again."""

from __future__ import annotations

from haptid.errors._both import ResultFileError


class ReportDataError(ResultFileError):
    """A folder of results without the data of a report, or with data that cannot be read."""

    def __init__(self, path: object, what: str) -> None:
        super().__init__(
            f"{path}: {what}. Give the output folder of `haptid identify`, or run it again with this haptid: it writes "
            f"the report and its data."
        )
