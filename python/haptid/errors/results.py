"""What can be wrong with a folder of results that is read again."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.errors.roots import StudyError


class ResultFileError(StudyError):
    """A result file that is not there, cannot be read, or lacks what is asked of it."""

    def __init__(self, path: object, what: str) -> None:
        super().__init__(f"{path}: {what}. Give the output folder of `haptid identify`, or identify again.")


class ResultDeviceError(StudyError):
    """A result whose parameters are not those that this haptid finds for its device."""

    def __init__(self, path: object, stored: Sequence[str], found: Sequence[str], version: str) -> None:
        lost = ", ".join(name for name in stored if name not in found) or "their order"
        super().__init__(
            f"{path}: its {len(stored)} base parameters, by haptid {version}, are not the {len(found)} of its device "
            f"here; they differ in {lost}. Identify again with this haptid."
        )
