"""What can be wrong with a demonstration that comes with haptid."""

from __future__ import annotations

from collections.abc import Iterable

from haptid.errors._both import IdentifiabilityError, UnknownNameError, suggestion


class UnknownDemoError(UnknownNameError):
    """A demonstration that there is none of."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        super().__init__(f"there is no demo {name!r}. {suggestion(name, known)}")


class MountingError(IdentifiabilityError):
    """A mounting whose torques the device's own base parameters cannot express."""

    def __init__(self, name: str, left: float, limit: float) -> None:
        super().__init__(
            f"in another mounting, {name} has torques that its base parameters as mounted in the device file cannot "
            f"express: {left:.1e} of them is left, the limit is {limit:.1e}. Identify it with gravity as it is there."
        )
