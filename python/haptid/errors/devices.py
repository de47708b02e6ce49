"""What can be wrong with a device file or a mechanism."""

from __future__ import annotations

import math
from collections.abc import Iterable

from haptid.errors._both import DeviceError, DeviceFileError, LoopClosureError, SingularityError, suggestion


class DeviceSyntaxError(DeviceFileError):
    """A device file that is not TOML."""

    def __init__(self, path: str, line: int, column: int, found: str, text: str) -> None:
        self.line, self.column = line, column
        super().__init__(
            f"{path}, line {line}, column {column}: not TOML: {found}, in `{text}`. "
            f"Correct this line; texts and expressions need double quotes."
        )


class DeviceKeyError(DeviceFileError):
    """A key that does not belong where it stands, or one that is missing."""

    def __init__(self, where: str, found: str, instead: str) -> None:
        super().__init__(f"{where}: {found}. {instead}")


class DeviceValueError(DeviceFileError):
    """A value that cannot be what its key says."""

    def __init__(self, where: str, found: str, instead: str) -> None:
        super().__init__(f"{where}: {found}. {instead}")


class DuplicateNameError(DeviceFileError):
    """The same name twice."""

    def __init__(self, where: str, what: str, name: str, first: str) -> None:
        super().__init__(f'{where}: the {what} "{name}" is already taken by {first}. Give one of them another name.')


class MissingParentError(DeviceFileError):
    """A joint whose parent is not there, or only further down the file."""

    def __init__(self, where: str, joint: str, parent: str, known: Iterable[str], later: bool) -> None:
        if later:
            reason = f'its parent "{parent}" is declared further down; move it above joint "{joint}".'
        else:
            reason = f'no joint declared above it is named "{parent}". {suggestion(parent, known)}'
        super().__init__(f'{where}: joint "{joint}" has no parent yet: {reason}')


class CycleError(DeviceFileError):
    """Joints that are each other's ancestors."""

    def __init__(self, where: str, names: Iterable[str]) -> None:
        ring = " -> ".join(names)
        super().__init__(
            f"{where}: these joints hang on one another: {ring}. Hang one of them on the base or on a joint "
            f"outside the ring, and close the ring with [[loops]] and a cut joint."
        )


class ExpressionError(DeviceFileError):
    """A text that is not the arithmetic it should be."""

    def __init__(self, where: str, text: str, found: str, instead: str) -> None:
        super().__init__(f'{where}: cannot read "{text}": {found}. {instead}')


class DegreesError(DeviceFileError):
    """An angle that can only have been meant in degrees."""

    def __init__(self, where: str, value: float) -> None:
        super().__init__(
            f"{where}: the angle {value:g} is more than a turn (limit 2 pi rad), so it looks like degrees. "
            f'Write it in radians: {math.radians(value):.6g}, or as "{value:g}*pi/180".'
        )


class RelationError(DeviceFileError):
    """A relation between joint positions that is not linear, or does not settle its joints."""

    def __init__(self, where: str, found: str, instead: str) -> None:
        super().__init__(f"{where}: {found}. {instead}")


class NonlinearTargetError(DeviceFileError):
    """A target that is not a linear combination of standard parameters."""

    def __init__(self, where: str, text: str, found: str, instead: str) -> None:
        super().__init__(f'{where}: "{text}" is not a linear combination of parameters: {found}. {instead}')


class ActiveJointError(DeviceFileError):
    """A joint that is declared active but moved by a loop, or declared passive but moved by nothing."""

    def __init__(self, where: str, joint: str, found: str, instead: str) -> None:
        super().__init__(f'{where}: joint "{joint}" {found}. {instead}')


class LoopOpenError(LoopClosureError):
    """Loops whose cut frames do not meet."""

    def __init__(self, where: str, gap: float, limit: float, how: str) -> None:
        self.gap = gap
        super().__init__(
            f"{where}: the loop does not close: {how} its cut frames still miss each other by {gap:.3g} m "
            f"(limit {limit:.1e} m). Check the lengths and frames of the cut, and that the active joints can "
            f"move independently of each other."
        )


class LoopBranchError(LoopClosureError):
    """Loops that close in several ways, none of which the file chooses."""

    def __init__(self, where: str, pose: str, ways: Iterable[str]) -> None:
        self.ways = tuple(ways)
        super().__init__(
            f"{where}: at {pose} the loops close in {len(self.ways)} ways (limit 1 where nothing chooses): "
            f"{' or '.join(self.ways[:8])}. Add the right one to a loop, as guess = {{ ... }}; "
            f"rough values will do. Is it meant to be a parallelogram? Then make its opposite sides equal."
        )


class CutRateError(DeviceFileError):
    """A named cut whose rates by the active joints vary with the pose."""

    def __init__(self, where: str, joint: str, spread: float, limit: float) -> None:
        super().__init__(
            f"{where}: the cut joint {joint} has a name, but its rates by the active joints vary with the pose, by "
            f"{spread:.3g} (limit {limit:.0e}), so that terms cannot act on it. Remove its name, or cut the loop at "
            f"another joint and list this one in joints."
        )


class LoopUnreachableError(LoopClosureError):
    """A pose of the active joints at which the loops do not close."""

    def __init__(self, sample: int, pose: str, gap: float, limit: float) -> None:
        self.sample, self.gap = sample, gap
        super().__init__(
            f"at sample {sample} the loops do not close: with {pose} the cut frames still miss each other by "
            f"{gap:.3g} m (limit {limit:.1e} m). Keep the motion within the mechanism's reach; if the device did "
            f"move there, check the lengths, and the zeros and signs of the positions."
        )


class LoopFarError(LoopClosureError):
    """A pose of the active joints that no motion leads to."""

    def __init__(self, sample: int, pose: str, limit: float) -> None:
        self.sample = sample
        super().__init__(
            f"at sample {sample} the active joints are further from the start pose than loops are followed: {pose} "
            f"(limit {limit:.0e} rad, or as many times the mechanism's size). Such positions are in another unit: give "
            f"the log's unit, counts or degrees, and its gain."
        )


class SingularLoopError(SingularityError):
    """Loops at, or beyond, a pose in which the passive joints are not settled by the active ones."""

    def __init__(self, where: str, pose: str, openness: float, limit: float) -> None:
        self.openness = openness
        super().__init__(
            f"{where} the loops come to a singular pose: with {pose} the least singular value of the passive "
            f"Jacobian is {openness:.2g} (limit {limit:.1g}), so the active joints do not settle the others there. "
            f"Keep the motion on one side of such poses; joint limits in the device file say where it may go."
        )


class UndeterminedLoopError(DeviceFileError):
    """Loops that leave a passive joint free."""

    def __init__(self, where: str, free: int, passive: int) -> None:
        super().__init__(
            f"{where}: the cuts settle only {passive - free} of {passive} passive joints; {free} can still "
            f"move while the active ones stand still. Make {free} more of them active, or add a cut."
        )


class IdleMotorError(DeviceFileError):
    """A motor that drives no active joint."""

    def __init__(self, where: str, motor: str, found: str, active: Iterable[str]) -> None:
        super().__init__(
            f'{where}: motor "{motor}" {found}. Name active joints with non-zero factors; '
            f"the active joints are {', '.join(active)}."
        )


class TransmissionError(DeviceFileError):
    """Motors whose coordinates do not determine the active joints."""

    def __init__(self, where: str, motors: int, active: int, rank: int) -> None:
        super().__init__(
            f"{where}: {motors} motor coordinates cannot be turned into the {active} active joint positions: "
            f"the transmission matrix has rank {rank}, wanted {active} rows of rank {active}. "
            f"Give each motor its own combination of active joints."
        )


class ColumnValueError(DeviceError):
    """A column that is not a number somewhere in the motion."""

    def __init__(self, name: str, sample: int, value: float, cause: str) -> None:
        super().__init__(
            f"column {name} is {value} at sample {sample}: {cause}. Correct the expression, or keep the "
            f"motion where it is defined."
        )


class UnknownDeviceNameError(DeviceFileError):
    """A name that nothing in the device carries."""

    def __init__(self, where: str, what: str, name: str, known: Iterable[str]) -> None:
        self.name = name
        super().__init__(f'{where}: no {what} is named "{name}". {suggestion(name, known)}')
