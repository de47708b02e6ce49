"""Exceptions of haptid: one class for each thing that a caller can usefully catch.

Every error says what was found, how much, the limit and what to do. All classes have one constructor; the sentence is
composed where the error is raised, and its figures are attributes:

    raise LogDataError(
        f"{path}: channel {name!r} is {value:g} in every sample.",
        where=name,
        found=value,
        advice="Map the channel that is connected, or give its signal `constant_ok = true`.",
    )

Errors that cross processes keep their attributes and notes.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from typing import Any

# A word of a message that is longer is shown by its first and last characters: a key of a hostile file, never a path.
_LONGEST_WORD, _FIRST, _LAST = 1000, 200, 50


class HaptidError(Exception):
    """Base class of all exceptions that haptid raises.

    Args:
        message: what is wrong, with the figures and the limit; one sentence or more, each with its full stop.
        where: name, key, file, sample or time (s) at which it is wrong; a tuple where it takes two of these.
        found: the value that was found.
        limit: what it may be: a bound, or the values that are allowed.
        advice: what to do about it, as sentences; appended to the message in `str(error)`.
        notes: further lines, added with `add_note`.
    """

    def __init__(
        self,
        message: str,
        *,
        where: Any = None,
        found: Any = None,
        limit: Any = None,
        advice: str = "",
        notes: Iterable[str] = (),
    ) -> None:
        super().__init__(_shortened(f"{message} {advice}" if advice else message))
        self.where, self.found, self.limit, self.advice = where, found, limit, advice
        for note in notes:
            self.add_note(note)

    def __reduce__(self) -> tuple[object, ...]:
        """By text and attributes, not by the constructor's arguments: errors come back from worker processes."""
        return _unpickled, (type(self), self.args), self.__dict__


def _shortened(message: str) -> str:
    """The message without the middle of words that nobody can read."""
    if len(message) <= _LONGEST_WORD:
        return message
    word = rf"\S{{{_LONGEST_WORD},}}"
    return re.sub(word, lambda m: f"{m[0][:_FIRST]}...{m[0][-_LAST:]} ({len(m[0])} characters)", message)


def _unpickled(kind: type[HaptidError], args: tuple[object, ...]) -> HaptidError:
    error = kind.__new__(kind)
    error.args = args
    return error


class ShapeError(HaptidError):
    """An array does not have the shape that the call requires."""


class SettingError(HaptidError):
    """An argument or a setting of a method has a value that it cannot have, or does not go with the others."""


class OptionError(HaptidError):
    """An option on the command line cannot be read, or does not fit the device."""


class UnknownNameError(HaptidError):
    """A parameter, link, motor, demo or format is named that does not exist."""


class MissingDependencyError(HaptidError):
    """An optional package, or a compiler, is not installed."""


class ExecutorError(HaptidError):
    """Worker processes or a cluster failed."""


class OutputFolderError(HaptidError):
    """A folder or file cannot be written."""


class DeviceError(HaptidError):
    """Base class: the device, its file or its mechanism."""


class DeviceFileError(DeviceError):
    """A device file cannot be read, or one of its keys, values, names or expressions is wrong."""


class IncompleteDeviceError(DeviceError):
    """The device file lacks what the call requires: a handle, limits, targets or prior values."""


class RobotFileError(DeviceError):
    """A robot description (URDF, MJCF, SDF and others) cannot be read, or describes what no mechanism can be."""


class LoopClosureError(DeviceError):
    """Kinematic loops do not close, or close in several assembly modes of which none is chosen."""


class SingularityError(LoopClosureError):
    """Kinematic loops are at a singular configuration, where the active joints do not determine the passive ones."""


class LogError(HaptidError):
    """Base class: a log file or its samples."""


class LogFileError(LogError):
    """A log file cannot be opened, or its content is not in a format that haptid reads."""


class LogChannelError(LogError):
    """The channel mapping is wrong: a channel is missing or mapped twice, or its unit is not known."""


class LogDataError(LogError):
    """Samples that cannot be right: NaN, constant or identical channels, saturation, jumps, wrapped angles."""


class LogTimeError(LogError):
    """The time base cannot be used: stamps that repeat or decrease, gaps, too few samples."""


class LogMismatchError(LogError):
    """The log does not fit the device: the number of channels, units, or positions against the joint limits."""


class TreatmentError(HaptidError):
    """Filtering, differentiation or decimation with settings that are impossible for this log."""


class MotionTooShortError(TreatmentError):
    """The motion is shorter than the transients of its filters."""


class MissingAccelerationError(TreatmentError):
    """Accelerations are required and the treatment leaves none."""


class EstimationError(HaptidError):
    """Base class: observation, estimation, validation or inference."""


class NoRowsError(EstimationError):
    """Too few rows are left to estimate from."""


class IdentifiabilityError(EstimationError):
    """A parameter or a target is not identifiable: not excited, collinear with others, or without effect on torque."""


class ConvergenceError(EstimationError):
    """An iteration stopped without a solution."""


class PhysicalConsistencyError(EstimationError):
    """No rigid bodies have these inertial parameters."""


class SimulationError(EstimationError):
    """A simulated device diverges, loses its reference or cannot be integrated."""


class SharedRowsError(EstimationError):
    """Rows of a log are used twice where independent ones are required."""


class ModelMismatchError(EstimationError):
    """Estimates or observations of different devices, or without a common parameter, are combined."""


class RegroupingError(HaptidError):
    """Base parameters cannot be found with the lengths as symbols."""


class WorkspaceError(HaptidError):
    """Limits of a workspace are impossible, or no pose is within them."""


class RedundancyError(HaptidError):
    """A quantity at the end effector is not determined, since the joints are redundant for its motion."""


class ExperimentError(HaptidError):
    """An experiment on the virtual bench cannot be carried out."""


class ExperimentFileError(ExperimentError):
    """An experiment file cannot be read, or a key in it is wrong."""


class TrajectoryError(ExperimentError):
    """A planned motion violates limits of the device, or none within them was found."""


class ExportError(HaptidError):
    """A model cannot be expressed in a format or simulator, or exported code cannot be used."""


class UnvalidatedModelError(ExportError):
    """The model to export was not validated, or does not meet its criterion."""


class StudyFileError(HaptidError):
    """A study file cannot be read, or a key in it is wrong."""


class ResultFileError(HaptidError):
    """A folder of results is absent, cannot be read, or lacks what is required."""


class WorkbenchError(HaptidError):
    """A page of the workbench asks for what it cannot have: a path elsewhere, a name, a port, a job in the way."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Advice on a name that is not known: the nearest of the known ones, and a list of them."""
    names = list(dict.fromkeys(known))
    return f"{_nearest(name, names)}Known: {listed(names, 24) or 'none'}."


def unknown_name(message: str, name: str, known: Iterable[str], where: str | None = None) -> UnknownNameError:
    """The error for a name that is none of the known ones, with the nearest of them; `where` is the name by default."""
    names = tuple(known)
    advice = suggestion(str(name), names)
    return UnknownNameError(message, where=where or name, found=name, limit=names, advice=advice)


def index_of(name: str, known: Sequence[str], what: str) -> int:
    """Index of a name.

    Raises:
        UnknownNameError: it is none of them.
    """
    if name in known:
        return list(known).index(name)
    raise unknown_name(f"there is no {what} {name!r}.", name, known, what)


def setting_error(name: str, value: object, wanted: str, owner: str = "") -> SettingError:
    """The error for a value that a setting cannot have: `wanted` says what it can be, `owner` whose setting it is."""
    of = f"{owner}: " if owner else ""
    return SettingError(f"{of}{name} is {value!r}; write {wanted}.", where=name, found=value, limit=wanted)


def keys_here(where: str, known: Sequence[str]) -> str:
    """Advice on the last key of the dotted path `where`; empty where no keys are known."""
    return f"{_nearest(where.rpartition('.')[2], known)}Keys here: {', '.join(known)}." if known else ""


def listed(names: Sequence[str], most: int = 8) -> str:
    """The first `most` names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _nearest(name: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f'Did you mean "{close[0]}"? ' if close else ""
