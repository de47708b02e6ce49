"""A study, read and checked: the corridor from device and logs to a validated estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from haptid.estimation import ClusterRobust, Intervals, Method
from haptid.log import Channels
from haptid.observation.known_payload import Payload
from haptid.simulation import PID
from haptid.study.schema import Role


@dataclass(frozen=True)
class LogEntry:
    """A log of a study: where it is, what it is for, how its channels are mapped, what was fixed to the device."""

    path: str
    role: Role
    stretch: tuple[float, float] | None
    channels: Channels | None
    load: Payload | None = None


@dataclass(frozen=True)
class Study:
    """A study file, read and checked.

    Attributes:
        name, path: of the study.
        device: name of a shipped device, or path of a device file.
        logs: the logs, in the file's order.
        treatment: settings of `Treatment` that the study gives; the rest is proposed from the logs.
        method: how they are estimated.
        holdout: how rows are held out of the fit for validation, if at all.
        largest_error: largest relative error on unseen rows that is good enough, per cent; None for no limit.
        intervals: how deviations are made.
        controller: that moved the device, None where the study does not say.
    """

    name: str
    path: Path
    device: str | Path
    logs: tuple[LogEntry, ...]
    treatment: Mapping[str, Any]
    method: Method
    holdout: Literal["alternate", "each-log"] | None
    largest_error: float | None
    intervals: Intervals = field(default_factory=ClusterRobust)
    controller: PID | None = None
