"""`Study`: a study file, read and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any, TypeVar

from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.device import Device
from haptid.estimation import ClusterRobust, Intervals, Method, TorqueNoise
from haptid.inference.payloads import AttachedBody
from haptid.log import Channels
from haptid.motion.holds import HoldDetection
from haptid.observation.known_payload import Payload
from haptid.simulation import PID
from haptid.study.schema import CrossValidation, Role, Use
from haptid.treatment_choice.calibration import CalibrationPrior

_Item = TypeVar("_Item")


@dataclass(frozen=True)
class LogEntry:
    """A log of a study: path, role, time range, channel mapping, payload.

    `episodes` are those of a data set, None for all; `exclude` are parts that are left out, s. `body` is the payload
    with what is known of it, `payload` the same where it is known well enough to be subtracted.
    """

    path: str
    role: Role
    time_range: tuple[float, float] | None
    channels: Channels | None
    payload: Payload | None = None
    body: AttachedBody | None = None
    episodes: tuple[int, ...] | None = None
    exclude: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class PoseSettings:
    """How the logs of a study hold poses.

    Attributes:
        table: whether they are tables with one row a pose.
        detection: what counts as a hold in a continuous log.
        approach: channels of a table with the directions of approach.
    """

    table: bool
    detection: HoldDetection
    approach: tuple[str, ...]


@displayed
@dataclass(frozen=True)
class Study:
    """An identification pipeline: device, logs, treatment, estimator, validation, criterion.

    Attributes:
        name, path: of the study.
        device: name of a shipped device, or path of a device file.
        logs: the logs, in the file's order.
        treatment: given settings of `Treatment`; the others are proposed from the logs.
        method: of estimation.
        cross_validation: scheme, None for none.
        largest_error: criterion on the relative error on unseen rows, per cent; None for none.
        intervals: how standard errors are computed.
        calibration: how well zeros and the direction of gravity are known; None where they are exact.
        use: which fit is the model for use, "auto" where it is chosen on held-out blocks.
        method_given: whether the file names the method; else it is chosen by the device.
        controller: that moved the device, None if not given.
        poses: how the logs hold poses, None for motions.
    """

    name: str
    path: Path
    device: str | Path
    logs: tuple[LogEntry, ...]
    treatment: Mapping[str, Any]
    method: Method
    cross_validation: CrossValidation | None
    largest_error: float | None
    intervals: Intervals = field(default_factory=ClusterRobust)
    controller: PID | None = None
    poses: PoseSettings | None = None
    calibration: CalibrationPrior | None = None
    use: Use = "auto"
    method_given: bool = True

    def _shown(self) -> Overview:
        settings = ", ".join(f"{name} {value}" for name, value in self.treatment.items())
        largest = "none" if self.largest_error is None else f"at most {self.largest_error:g} % error on unseen rows"
        notes = (f"criterion: {largest}", f"treatment: {settings or 'proposed from the logs'}")
        title = f"Study {self.name} of {self.device} by {self.method.name}"
        return Overview(title, ("log", "role"), [[entry.path, entry.role] for entry in self.logs], notes)

    def of_fit(self, items: Sequence[_Item]) -> list[_Item]:
        """Of one item for each log of the study, those of the logs that the fit uses."""
        return [item for item, entry in zip(items, self.logs, strict=True) if entry.role == "identify"]

    def on(self, device: Device) -> Study:
        """The study with the default method of a device: torque noise where its rows mix motors by the pose."""
        if self.method_given or not (device.redundant or device.drive_varies.any()):
            return self
        method: Any = self.method  # WLS, or constraints around it
        noise = TorqueNoise()
        return replace(self, method=replace(method, weighting=noise) if hasattr(method, "weighting") else noise)


def silent(_step: str, _share: float) -> None:
    """The progress callback that does nothing."""
