"""What can be wrong with what is written on the command line."""

from __future__ import annotations

from haptid.errors.roots import HaptidError


class OptionError(HaptidError):
    """An option of a command that cannot be read, or that does not fit the device."""

    def __init__(self, option: str, found: object, wanted: str) -> None:
        super().__init__(f"{option} is {found!r}; write {wanted}.")
