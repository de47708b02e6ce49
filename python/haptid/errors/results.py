"""What can be wrong with a folder of results that is read again."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.errors._both import ResultFileError


class ResultDeviceError(ResultFileError):
    """A result whose parameters are not those that this haptid finds for its device."""

    def __init__(self, path: object, stored: Sequence[str], found: Sequence[str], version: str) -> None:
        lost = ", ".join(name for name in stored if name not in found) or "their order"
        super().__init__(
            f"{path}: its {len(stored)} base parameters, by haptid {version}, are not the {len(found)} of its device "
            f"here; they differ in {lost}. Identify again with this haptid."
        )
