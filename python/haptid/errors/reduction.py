"""What can be wrong with essential parameters, a friction test, or the search for an exciting motion."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.errors._both import IncompleteDeviceError, NoRowsError, TrajectoryError, UnknownNameError, suggestion


class BaseNameError(UnknownNameError):
    """A base parameter that the device does not have."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        super().__init__(f"the device has no base parameter {name!r}. {suggestion(name, known)}")


class MotorNameError(UnknownNameError):
    """A motor that the observation has no rows of."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        super().__init__(f"the observation has no rows of a motor {name!r}; it has rows of {', '.join(known)}.")


class NoStretchesError(NoRowsError):
    """A motion in which no joint moves at a constant velocity."""

    def __init__(self, tolerance: float, shortest: float, slowest: float) -> None:
        super().__init__(
            f"no joint moves to and fro by itself at a velocity that is constant within {100 * tolerance:g} % for "
            f"{shortest:g} s, and faster than {slowest:g} rad/s or m/s. Record each joint in turn at several constant "
            f"velocities, or raise `tolerance`."
        )


class NoRangeError(IncompleteDeviceError):
    """A joint without limits, for which none were given."""

    def __init__(self, what: str, joint: str) -> None:
        super().__init__(
            f"joint {joint} has no {what} in the device file, so there is nothing to plan a motion within. Give it to "
            f"the limits, or write it in the device file."
        )


class NoFeasibleMotionError(TrajectoryError):
    """A search that found no motion within the limits."""

    def __init__(self, tried: int, worst: str, excess: float) -> None:
        super().__init__(
            f"none of {tried} motions respects all limits; the best exceeds {worst} by {100 * excess:.3g} %. Widen "
            f"that limit, move the range of positions, or search longer."
        )
