"""`Study`: a study file, read and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from haptid.estimation import ClusterRobust, Intervals, Method
from haptid.log import Channels
from haptid.observation.known_payload import Payload
from haptid.simulation import PID
from haptid.study.schema import CrossValidation, Role


@dataclass(frozen=True)
class LogEntry:
    """A log of a study: path, role, time range, channel mapping, known payload."""

    path: str
    role: Role
    time_range: tuple[float, float] | None
    channels: Channels | None
    payload: Payload | None = None


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
        controller: that moved the device, None if not given.
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
