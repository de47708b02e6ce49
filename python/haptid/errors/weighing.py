"""What can be wrong with what is known beside the rows, and with noise in the columns."""

from __future__ import annotations

from haptid.errors._both import IdentifiabilityError, IncompleteDeviceError, SettingError


class NoPriorError(IncompleteDeviceError):
    """A fit towards prior values, of a device that has none."""

    def __init__(self, device: str) -> None:
        super().__init__(
            f"no base parameter of {device!r} has a prior value other than zero, so there is nothing to pull towards. "
            f"Give bodies or values in the device file, for all the parameters of a group, or take WLS()."
        )


class PulledProfileError(SettingError):
    """A profile likelihood of an estimate that is not the best fit."""

    def __init__(self) -> None:
        super().__init__(
            "a profile likelihood tells how far a parameter can go before the rows speak against it, and an estimate "
            "that is pulled towards prior bodies is not what the rows speak for. Take Consistent() in the place of "
            "Entropic(), or other intervals, such as Clustered()."
        )


class ContradictionError(SettingError):
    """Relations between parameters that cannot hold together."""

    def __init__(self, relations: str, left: float) -> None:
        super().__init__(
            f"the relations {relations} contradict each other: whatever the parameters, one is off by {left:.3g} of "
            f"its size. Leave one out."
        )


class NoisyColumnsError(IdentifiabilityError):
    """Noise in the columns that is as large as what the motion says."""

    def __init__(self, name: str, share: float, limit: float) -> None:
        super().__init__(
            f"of what the rows say of {name}, {100 * share:.0f} % would be noise of the columns, limit "
            f"{100 * limit:.0f} %. Lower the cut-off of the position filter, check the resolution of the encoders, or "
            f"take WLS()."
        )


class NoResolutionError(SettingError):
    """Noise of the columns asked for, of a motion whose encoders are not known."""

    def __init__(self, why: str) -> None:
        super().__init__(
            f"the steps of the encoders are not known: {why}. Give `resolution`, in rad or m of the position channels."
        )
