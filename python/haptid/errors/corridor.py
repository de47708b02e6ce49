"""What can be wrong from a study to its estimate."""

from __future__ import annotations

from haptid.errors._both import (
    ConvergenceError,
    EstimationError,
    IdentifiabilityError,
    IncompleteDeviceError,
    LogMismatchError,
    MissingAccelerationError,
    ModelMismatchError,
    NoRowsError,
    OutputFolderError,
    PhysicalConsistencyError,
    SettingError,
    SharedRowsError,
    StudyFileError,
    TreatmentError,
)


class StudyLogsError(StudyFileError):
    """Logs that cannot serve the study."""

    def __init__(self, path: object, what: str) -> None:
        super().__init__(f"{path}, key `logs`: {what}.")


class StudyControllerError(StudyFileError):
    """A method that simulates the closed loop, in a study that does not say what closed it."""

    def __init__(self, path: object, method: str) -> None:
        super().__init__(
            f"{path}, key `estimate.method`: {method} simulates the device under the controller that moved it, and "
            f"the study has none. Add a [controller] table with its gains kp and kd; or take a method that needs "
            f"none, such as WLS."
        )


class OutputError(OutputFolderError):
    """A folder that results cannot be written to."""

    def __init__(self, path: object, why: str) -> None:
        super().__init__(f"cannot write results to {path}: {why}. Choose another folder with --out.")


class TreatmentValueError(TreatmentError):
    """A setting of the treatment that means nothing."""

    def __init__(self, name: str, value: object, wanted: str) -> None:
        super().__init__(f"treatment {name} is {value!r}; write {wanted}.")


class CutoffError(TreatmentError):
    """A cut-off that the sampling rate, or the decimation, cannot carry."""

    def __init__(self, name: str, cutoff_hz: float, limit_hz: float) -> None:
        super().__init__(
            f"{name} is {cutoff_hz:g} Hz, and the rate that is left carries only what is well below {limit_hz:g} Hz. "
            f"Lower {name}, or decimate less."
        )


class NoAccelerationError(MissingAccelerationError):
    """Accelerations asked of a motion whose velocity is a causal differentiator's: there are none worth having."""

    def __init__(self, what: str) -> None:
        super().__init__(
            f"{what} needs accelerations, and `velocity` by a high-pass leaves none. Choose accelerations = "
            f"'momentum', or leave `velocity` out."
        )


class AccelerationColumnError(MissingAccelerationError):
    """A column of the device that is made of accelerations, where there are none."""

    def __init__(self, column: str) -> None:
        super().__init__(
            f"column {column} is made of accelerations, and there are none in rows with accelerations = 'momentum', in "
            f"the momentum observer and in the models of Kalman filters. Choose accelerations = 'differences', "
            f"estimate_force or another method, or write the term as a rotor inertia."
        )


class ChannelCountError(LogMismatchError):
    """A log with more or fewer channels than the device has."""

    def __init__(self, what: str, got: int, names: list[str]) -> None:
        super().__init__(
            f"the log has {got} {what} channels, and the device wants {len(names)}: {', '.join(names)}. "
            f"Map one channel for each, in this order."
        )


class CommandUnitError(LogMismatchError):
    """A torque channel in a unit that the device's motors are not driven in."""

    def __init__(self, motor: str, got: str, wanted: str, side: str) -> None:
        super().__init__(
            f"the torque channel of {motor} is in {got!r} at the {side} side, and the device file says {wanted!r}. "
            f"Give the channel that unit, or change the motor's `unit` and `gain` in the device file."
        )


class TooFewRowsError(NoRowsError):
    """Fewer rows than parameters."""

    def __init__(self, rows: int, parameters: int) -> None:
        super().__init__(f"{rows} rows cannot tell {parameters} parameters. Record a longer motion, or decimate less.")


class UnexcitedError(IdentifiabilityError):
    """A parameter that the log says nothing about."""

    def __init__(self, name: str, ratio: float, limit: float) -> None:
        super().__init__(
            f"base parameter {name} is not excited by this log: its direction carries {ratio:.1e} of the largest one, "
            f"below the limit {limit:.1e}. Record motion that turns its link, or leave the term out of the device file."
        )


class NoTorqueError(IdentifiabilityError):
    """A motor whose torque is zero throughout."""

    def __init__(self, motor: str) -> None:
        super().__init__(
            f"the treated torque of motor {motor} is zero in every row, so its rows cannot be weighed by their "
            f"residual. Map the channel that holds its torque, or estimate with OLS."
        )


class MethodSettingError(SettingError):
    """A setting of an estimator that means nothing."""

    def __init__(self, method: str, name: str, value: object, wanted: str) -> None:
        super().__init__(f"{method}: {name} is {value!r}; write {wanted}.")


class UnsearchableError(EstimationError):
    """Constants of a device that cannot be searched."""

    def __init__(self, device: str, why: str) -> None:
        instead = "Write a constant as velocity = { start = 0.05, low = 0.005, high = 0.5 }, each term on its own."
        super().__init__(f"{device}: {why}. {instead}")


class DifferentModelError(ModelMismatchError):
    """Two values of different devices put together."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(
            f"these are of two devices, {one!r} and {other!r}, or of one device read twice. Read the device once, and "
            f"make every observation with it."
        )


class NoTargetsError(IncompleteDeviceError):
    """Targets asked of a device that names none."""

    def __init__(self, device: str) -> None:
        super().__init__(
            f"device {device!r} has no targets. Write a table [targets] in its file, such as "
            f'pi_4 = "2*(L1*MX2 + L3*MX3)", and read it again.'
        )


class UnidentifiableTargetError(IdentifiabilityError):
    """A target that no motion can show."""

    def __init__(self, name: str, hidden: str, shown: str, groups: list[str]) -> None:
        self.name = name
        seen = f" What it shows is {shown}." if shown else ""
        held = f" It is seen only within {'; '.join(groups)}." if groups else ""
        super().__init__(
            f"target {name} cannot be identified: no torque of this device shows {hidden} by itself.{seen}{held} "
            f"Write the target as a sum of base parameters; `haptid model` prints them with what regroups into each."
        )


class DependentEstimatesError(SharedRowsError):
    """Two estimates compared that share rows."""

    def __init__(self, log: str, start: float, stop: float) -> None:
        super().__init__(
            f"both estimates were made from the rows from {start:.3f} to {stop:.3f} s of log {log[:12]}, so the "
            f"deviation of their difference is not known. Compare estimates from logs, or stretches, without common "
            f"rows."
        )


class DifferentParametersError(ModelMismatchError):
    """Two estimates compared that have no parameter in common."""

    def __init__(self, first: list[str], second: list[str]) -> None:
        shown = " and of ".join(", ".join(names[:6]) + (", ..." if len(names) > 6 else "") for names in (first, second))
        super().__init__(
            f"these estimates have no parameter of one name, unit and meaning in common: they are of {shown}. "
            f"Compare base parameters with base parameters or targets with targets, in the same units."
        )


class ConfidenceError(SettingError):
    """A confidence that is none."""

    def __init__(self, confidence: float) -> None:
        super().__init__(f"confidence is {confidence!r}; write a number between 0 and 1, such as 0.95.")


class SameRowsError(SharedRowsError):
    """The same stretch of a log counted twice."""

    def __init__(self, log: str, start: float, stop: float) -> None:
        super().__init__(
            f"both observations hold the rows from {start:.3f} to {stop:.3f} s of log {log[:12]}: counting them twice "
            f"would halve every variance. Leave one out."
        )


class SeenRowsError(SharedRowsError):
    """Rows of the fit offered as unseen ones."""

    def __init__(self, log: str, start: float, stop: float) -> None:
        super().__init__(
            f"the rows from {start:.3f} to {stop:.3f} s of log {log[:12]} were in the fit, so they prove nothing. "
            f"Validate on another log, or hold blocks out of this one before the fit."
        )


class UnsolvedError(ConvergenceError):
    """A cone programme that the solver gave up."""

    def __init__(self, status: str, iterations: int) -> None:
        super().__init__(
            f"the search for parameters that bodies can have stopped after {iterations} iterations without an answer "
            f"({status}). Check that no parameter is off by orders of magnitude, such as a unit; or estimate with WLS."
        )


class NoBodyError(PhysicalConsistencyError):
    """Symmetries that leave no body."""

    def __init__(self, labels: list[str], margin: float, limit: float) -> None:
        super().__init__(
            f"with the symmetries in the device file no body of positive volume fits {', '.join(labels)}: the least "
            f"eigenvalue is at most {margin:.1e}, below the limit {limit:.1e}. Take a zero out of [[symmetry]], such "
            f"as the moment of inertia of a rod about its own axis."
        )


class ParameterValueError(SettingError):
    """Base parameters that are no numbers."""

    def __init__(self, name: str, value: float) -> None:
        super().__init__(f"base parameter {name} is {value}; every one must be a finite number before this question.")


class MetricError(IdentifiabilityError):
    """A triangle that does not weigh every direction."""

    def __init__(self, name: str, ratio: float, limit: float) -> None:
        super().__init__(
            f"the metric says nothing about base parameter {name}: its direction weighs {ratio:.1e} of the "
            f"largest one, below the limit {limit:.1e}. Take that of an observation that excites all."
        )
