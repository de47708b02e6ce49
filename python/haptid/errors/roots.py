"""The roots of haptid's errors, by which a caller can catch a whole kind."""

from __future__ import annotations


class HaptidError(Exception):
    """Root of haptid's errors."""

    def __reduce__(self) -> tuple[object, ...]:
        """By what it holds, not by what it was made from: so it comes back from another process."""
        return _again, (type(self), self.args), self.__dict__


def _again(kind: type[HaptidError], args: tuple[object, ...]) -> HaptidError:
    error = kind.__new__(kind)
    error.args = args
    return error


class DeviceError(HaptidError):
    """Something about a device file or a mechanism."""


class LogError(HaptidError):
    """Something about a log file or its samples."""


class StudyError(HaptidError):
    """Something about a study file or the corridor it asks for."""


class RegroupingError(HaptidError):
    """Regroupings with lengths as symbols cannot be found."""


class TreatmentError(HaptidError):
    """Something about filtering, differentiation or decimation."""


class EstimationError(HaptidError):
    """Something about observation, estimation or validation."""


class BenchError(HaptidError):
    """Something about an experiment on the virtual bench."""


class ExcitationError(HaptidError):
    """Something about the search for an exciting motion."""


class HandleError(HaptidError):
    """Something about the handle, the workspace or the force of the hand."""


class ExportError(HaptidError):
    """Something about writing a model out for other programs."""


class WorkError(HaptidError):
    """Something about the processes or machines that do the work."""


class ShapeError(HaptidError):
    """An array whose shape is not what the call needs."""

    def __init__(self, name: str, got: tuple[int, ...], wanted: tuple[int | None, ...]) -> None:
        shown = tuple("any" if n is None else n for n in wanted)
        super().__init__(f"{name} has shape {got}, wanted {shown}; pass it with that shape.")
