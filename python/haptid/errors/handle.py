"""What can be wrong at the handle, and in the workspace it moves in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from haptid.errors._both import (
    ConvergenceError,
    DeviceError,
    IncompleteDeviceError,
    RedundancyError,
    SettingError,
    UnknownNameError,
    WorkspaceError,
    suggestion,
)


class HandleMissingError(IncompleteDeviceError):
    """A question about the handle of a device that has none."""

    def __init__(self, device: str) -> None:
        super().__init__(
            f"{device} has no handle, so nothing is known of forces or positions there. Add [handle] with its link "
            f"and xyz to the device file."
        )


class WorkspaceLimitError(WorkspaceError):
    """Limits that leave no workspace, or are of nothing in the device."""

    def __init__(self, name: str, found: object, wanted: str) -> None:
        super().__init__(f"workspace limit {name} is {found!r}; write {wanted}.")


class UnboundedWorkspaceError(IncompleteDeviceError):
    """A sliding joint without limits."""

    def __init__(self, joint: str) -> None:
        super().__init__(
            f"joint {joint} slides and has no position limits, so its workspace has no end. Give it limits in the "
            f"device file, or to the workspace."
        )


class EmptyWorkspaceError(WorkspaceError):
    """Limits that no pose meets."""

    def __init__(self, poses: int) -> None:
        super().__init__(
            f"none of {poses} poses on a grid over the joints' limits is inside all limits of the workspace. Widen "
            f"the coupling limits or the box of the handle, or check their signs and units (rad, m)."
        )


class ForceSettingError(SettingError):
    """A setting of the force estimate or of the momentum observer that means nothing."""

    def __init__(self, name: str, value: object, wanted: str) -> None:
        super().__init__(f"{name} is {value!r}; write {wanted}.")


class UnknownLinkError(UnknownNameError):
    """A link to which nothing can be added, since there is none of that name, or it has no free parameters."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        super().__init__(f"no link {name!r} with free inertial parameters. {suggestion(name, known)}")


class LoadSymmetryError(DeviceError):
    """A load that the symmetries of the device file do not allow."""

    def __init__(self, link: str, names: Sequence[str]) -> None:
        super().__init__(
            f"a load on link {link} has {', '.join(names)}, which the device file says to be zero or the same as "
            f"another's. Take these symmetries out of the file, or fix the load where they hold."
        )


class GainSettlingError(ConvergenceError):
    """Drive gains that do not settle."""

    def __init__(self, moved: float, limit: float, steps: int) -> None:
        super().__init__(
            f"the gains still move by {moved:.2g} after {steps} steps, limit {limit:.2g}. Record longer, with a "
            f"heavier load, and let every motor feel it."
        )


class CharacterisationSettingError(SettingError):
    """A setting of a characterisation that means nothing."""

    def __init__(self, name: str, value: object, wanted: str) -> None:
        super().__init__(f"{name} is {value!r}; write {wanted}.")


class SpareJointsError(RedundancyError):
    """A figure that the handle's motion does not determine, since joints can share that motion in many ways."""

    def __init__(self, figure: str, joints: int, rows: int) -> None:
        super().__init__(
            f"{figure} is not determined: {joints} joints move {rows} components of the handle's velocity, so they can "
            f"share a motion in many ways. Choose more rows; masses and greatest forces are known all the same."
        )


class TorqueLimitError(IncompleteDeviceError):
    """Torque limits of motors that are not known, or mean nothing."""

    def __init__(self, motor: str, found: object) -> None:
        super().__init__(
            f"the torque limit of motor {motor} is {found!r}; give a finite torque of its coordinate above zero, N m "
            f"or N, or torque limits of its joint in the device file."
        )


class CompensationSettingError(SettingError):
    """A setting of a compensation law that means nothing."""

    def __init__(self, name: str, value: object, wanted: str) -> None:
        super().__init__(f"{name} is {value!r}; write {wanted}.")
