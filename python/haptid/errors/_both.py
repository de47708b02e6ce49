"""Classes that exist in both styles until every raise is of the new one."""

from __future__ import annotations

from typing import Any

from haptid.errors import _new
from haptid.errors._new import ConvergenceError as ConvergenceError
from haptid.errors._new import DeviceError as DeviceError
from haptid.errors._new import EstimationError as EstimationError
from haptid.errors._new import ExecutorError as ExecutorError
from haptid.errors._new import ExperimentError as ExperimentError
from haptid.errors._new import ExportError as ExportError
from haptid.errors._new import HaptidError as HaptidError
from haptid.errors._new import IdentifiabilityError as IdentifiabilityError
from haptid.errors._new import IncompleteDeviceError as IncompleteDeviceError
from haptid.errors._new import LogChannelError as LogChannelError
from haptid.errors._new import LogDataError as LogDataError
from haptid.errors._new import LogError as LogError
from haptid.errors._new import LogFileError as LogFileError
from haptid.errors._new import LogMismatchError as LogMismatchError
from haptid.errors._new import LogTimeError as LogTimeError
from haptid.errors._new import LoopClosureError as LoopClosureError
from haptid.errors._new import MissingAccelerationError as MissingAccelerationError
from haptid.errors._new import MissingDependencyError as MissingDependencyError
from haptid.errors._new import ModelMismatchError as ModelMismatchError
from haptid.errors._new import OutputFolderError as OutputFolderError
from haptid.errors._new import PhysicalConsistencyError as PhysicalConsistencyError
from haptid.errors._new import RedundancyError as RedundancyError
from haptid.errors._new import RegroupingError as RegroupingError
from haptid.errors._new import SettingError as SettingError
from haptid.errors._new import ShapeError as ShapeError
from haptid.errors._new import SharedRowsError as SharedRowsError
from haptid.errors._new import SimulationError as SimulationError
from haptid.errors._new import SingularityError as SingularityError
from haptid.errors._new import TrajectoryError as TrajectoryError
from haptid.errors._new import TreatmentError as TreatmentError
from haptid.errors._new import UnknownNameError as UnknownNameError
from haptid.errors._new import UnvalidatedModelError as UnvalidatedModelError
from haptid.errors._new import WorkspaceError as WorkspaceError
from haptid.errors._new import keys_here as keys_here
from haptid.errors._new import listed as listed
from haptid.errors._new import suggestion as suggestion


class OptionError(_new.OptionError):
    __doc__ = _new.OptionError.__doc__

    def __init__(self, *args: Any, **given: Any) -> None:
        if len(args) == 1:
            super().__init__(*args, **given)
            return
        option, found, wanted = args
        super().__init__(f"{option} is {found!r}; write {wanted}.", where=option, found=found, limit=wanted)


class DeviceFileError(_new.DeviceFileError):
    __doc__ = _new.DeviceFileError.__doc__

    def __init__(self, *args: Any, **given: Any) -> None:
        if len(args) == 1:
            super().__init__(*args, **given)
            return
        path, found, instead = args
        super().__init__(f"{path}: {found}.", where=path, found=found, advice=instead)


class MotionTooShortError(_new.MotionTooShortError):
    __doc__ = _new.MotionTooShortError.__doc__

    def __init__(self, *args: Any, **given: Any) -> None:
        if len(args) == 1:
            super().__init__(*args, **given)
            return
        seconds, needed, what = args
        super().__init__(
            f"the motion lasts {seconds:.3g} s, and {what} alone take {needed:.3g} s. Record a longer motion, raise "
            f"the cut-off, or decimate less.",
            found=seconds,
            limit=needed,
        )


class NoRowsError(_new.NoRowsError):
    __doc__ = _new.NoRowsError.__doc__

    def __init__(self, *args: Any, **given: Any) -> None:
        if len(args) == 1:
            super().__init__(*args, **given)
            return
        motor, reversal_speed = args
        super().__init__(
            f"every row of motor {motor} is slower than reversal_speed = {reversal_speed}, so none is left. Lower `reversal_speed`, "
            f"or record motion that turns this joint faster."
        )


class ExperimentFileError(_new.ExperimentFileError):
    __doc__ = _new.ExperimentFileError.__doc__

    def __init__(self, *args: Any, **given: Any) -> None:
        if len(args) == 1:
            super().__init__(*args, **given)
            return
        path, where, what, known = *args[:3], args[3] if len(args) > 3 else given.get("known", ())
        place = f"{path}, key `{where}`" if where else f"{path}"
        keys = f" {keys_here(where, known)}" if known else ""
        super().__init__(f"{place}: {what}.{keys} `haptid schema experiment` prints every key.", where=where)


class StudyFileError(_new.StudyFileError):
    __doc__ = _new.StudyFileError.__doc__

    def __init__(self, *args: Any, **given: Any) -> None:
        if len(args) == 1:
            super().__init__(*args, **given)
            return
        path, where, what, known = *args[:3], args[3] if len(args) > 3 else given.get("known", ())
        place = f"{path}, key `{where}`" if where else f"{path}"
        keys = f" {keys_here(where, known)}" if known else ""
        super().__init__(f"{place}: {what}.{keys}", where=where)


class ResultFileError(_new.ResultFileError):
    __doc__ = _new.ResultFileError.__doc__

    def __init__(self, *args: Any, **given: Any) -> None:
        if len(args) == 1:
            super().__init__(*args, **given)
            return
        path, what = args
        super().__init__(f"{path}: {what}. Give the output folder of `haptid identify`, or identify again.", where=path)
