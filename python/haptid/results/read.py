"""`read_result(folder)`: an identification as its result folder has it, without the logs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from haptid._internal.arrays import Array, expect, read_only
from haptid.device.toml.reader import device_of
from haptid.device.toml.tables import checked
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.model import GivenParameters
from haptid.errors import ResultDeviceError, ResultFileError, ShapeError
from haptid.estimation.intervals.spread import correlations
from haptid.observation.observation import Block
from haptid.study import Role
from haptid.validation.validation import MotorError, Validation

# A result of two hundred parameters is some megabytes; a file beyond this is something else.
LARGEST_FILE = 1 << 26
# Good for a use, to be used with care, not fit for it.
Grade = Literal["ok", "doubt", "bad"]


class _Table(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class _Log(_Table):
    path: str
    sha256: str
    role: Role
    start: float = 0.0
    samples: int
    dt: float


class _Parameter(_Table):
    name: str
    value: float
    free: float
    interval95: tuple[float | None, float | None]
    essential: bool | None = None


class _Searched(_Table):
    name: str
    value: float


class _Estimate(_Table):
    method: str
    possible: bool
    status: str
    parameters: list[_Parameter]
    searched: list[_Searched] = []
    loads: list[float] | None = None
    covariance: list[list[float]]
    dof: list[float | None]


class _Error(_Table):
    rows: Literal["fit", "unseen"]
    motor: str
    unit: str | None
    residual: float | None
    measured: float | None
    count: int | None


class _Criteria(_Table):
    relative_error_percent: float | None
    met: bool | None


class _Use(_Table):
    use: str
    grade: Grade
    sentence: str


class _File(_Table):
    version: Literal[1] = Field(alias="schema")
    haptid: str
    study: str
    device_file: dict[str, Any]
    logs: list[_Log]
    treatment: dict[str, Any]
    estimate: _Estimate
    validation: list[_Error]
    criteria: _Criteria
    verdict: list[_Use] = []
    notes: list[str]


@dataclass(frozen=True)
class RecordedLog:
    """A log of a result.

    Attributes:
        path: where it was.
        sha256: of the file.
        role: "identify" or "validate".
        start, stop: of the stretch that was used, s from the file's first sample.
    """

    path: str
    sha256: str
    role: Role
    start: float
    stop: float


@dataclass(frozen=True)
class RecordedUse:
    """What the diagnosis said of one use of the model.

    Attributes:
        use: "predicting", "compensation" or "quoting".
        grade: "ok", "doubt", or "bad" where the model is not fit for it.
        sentence: the same in words, with the reason.
    """

    use: str
    grade: Grade
    sentence: str


@dataclass(frozen=True, eq=False)
class Recorded:
    """An identification as its result folder has it.

    Attributes:
        folder: that it was read from.
        model: the dynamic model, as its device file had it.
        study: name of the study.
        version: of the haptid that made it.
        logs: what it was made from.
        treatment: settings by their names in a study.
        method, possible: "OLS" or "WLS", with how many parameters it leaves out; whether it is held to what bodies can
            have.
        status: as `Estimate.status`.
        beta: base parameters, (p,), SI; their names and units are those of `base`.
        free: of the fit that is held to nothing, (p,); `beta` where nothing holds it.
        covariance: of `free`, (p, p).
        dof: degrees of freedom of each interval, (p,); infinite of a parameter that is held at zero.
        interval95: (p, 2), infinite of the parameters that one stretch of the log alone tells.
        zero: indices of the parameters that were left out: zero, without deviation.
        direct: errors on the rows of the fit, log by log.
        unseen: errors on rows that a fit had not seen.
        largest_error: the study's criterion, per cent, None where it sets none.
        meets_criteria: whether it is met, None where there is none.
        verdict: what the model is good for, use by use; empty where it was not diagnosed.
        notes: sentences a user should read.
        values: all of `result.json`.
    """

    folder: Path
    model: DynamicModel
    study: str
    version: str
    logs: tuple[RecordedLog, ...]
    treatment: Mapping[str, Any]
    method: str
    possible: bool
    status: str
    beta: Array
    free: Array
    covariance: Array
    dof: Array
    interval95: Array
    zero: tuple[int, ...]
    direct: tuple[Validation, ...]
    unseen: tuple[Validation, ...]
    largest_error: float | None
    meets_criteria: bool | None
    verdict: tuple[RecordedUse, ...]
    notes: tuple[str, ...]
    values: Mapping[str, Any]

    def __post_init__(self) -> None:
        p = len(self.base)
        shapes = {"beta": (p,), "free": (p,), "covariance": (p, p), "freedom": (p,), "interval95": (p, 2)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, shape)

    @property
    def base(self) -> BaseParameters:
        """Names, units and groupings of the parameters."""
        return self.model.base

    @property
    def names(self) -> tuple[str, ...]:
        return self.base.names

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The logs of the fit, as stretches."""
        return tuple(Block(log.sha256, log.start, log.stop) for log in self.logs if log.role == "identify")

    @property
    def correlation(self) -> Array:
        """Of the errors of the base parameters, (p, p); NaN beside what has no deviation."""
        return correlations(self.covariance)

    @property
    def single_block(self) -> tuple[int, ...]:
        """Parameters, by index, that one stretch of the log alone tells."""
        return tuple(int(k) for k in np.flatnonzero(np.isinf(self.interval95).any(axis=1)))

    @property
    def se(self) -> Array:
        """Honest deviations, (p,); infinite for the lonely ones."""
        se = np.sqrt(np.diag(self.covariance))
        se[list(self.single_block)] = np.inf
        return se

    @property
    def identified(self) -> GivenParameters:
        """The parameters as `characterise`, `apparent_mass` and the like take them.

        Intervals of what is made from it have the degrees of freedom of the parameter that has fewest: how evenly the
        log tells a combination of parameters is not in the folder.
        """
        return GivenParameters(
            self.model, self.beta, self.covariance, float(self.dof.min(initial=np.inf)), self.single_block
        )


def read_result(folder: str | Path) -> Recorded:
    """Read the output folder of `haptid identify` or `haptid essential`, or its `result.json`.

    Args:
        folder: the folder, or the file itself.

    Raises:
        ResultFileError: there is no result, or it lacks what is needed here.
        ResultDeviceError: this haptid finds other base parameters for the device than the one that made it.
        DeviceError: the device in it cannot be read by this haptid.
    """
    path = Path(folder)
    path = path / "result.json" if path.is_dir() else path
    values = _values(path)
    table = _checked(path, values)
    model = DynamicModel(device_of(*checked(table.device_file, f"{path}, device_file")))
    model = model.at_constants([constant.value for constant in table.estimate.searched])
    if model.has_loads:
        model = _loaded(path, model, table.estimate.loads)
    stored = [p.name for p in table.estimate.parameters]
    if tuple(stored) != model.base.names:
        raise ResultDeviceError(path, stored, model.base.names, table.haptid)
    found = table.estimate
    return Recorded(
        folder=path.parent,
        model=model,
        study=table.study,
        version=table.haptid,
        logs=tuple(_log(log) for log in table.logs),
        treatment=MappingProxyType(table.treatment),
        method=found.method,
        possible=found.possible,
        status=found.status,
        beta=np.array([p.value for p in found.parameters]),
        free=np.array([p.free for p in found.parameters]),
        covariance=np.array(found.covariance),
        dof=np.array([np.inf if f is None else f for f in found.dof]),
        interval95=np.array([_interval(p) for p in found.parameters]).reshape(-1, 2),
        zero=tuple(k for k, p in enumerate(found.parameters) if p.essential is False),
        direct=_validations(table.validation, model, seen=True),
        unseen=_validations(table.validation, model, seen=False),
        largest_error=table.criteria.relative_error_percent,
        meets_criteria=table.criteria.met,
        verdict=tuple(RecordedUse(said.use, said.grade, said.sentence) for said in table.verdict),
        notes=tuple(table.notes),
        values=MappingProxyType(values),
    )


def _values(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ResultFileError(path, f"the file is larger than {LARGEST_FILE >> 20} MiB, so it is no result")
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ResultFileError(path, "there is no such file") from None
    except (OSError, ValueError, RecursionError) as error:  # not readable, not UTF-8, not JSON
        raise ResultFileError(path, f"cannot be read ({error})") from error
    if not isinstance(values, dict):
        raise ResultFileError(path, "is not a result of haptid")
    return values


def _checked(path: Path, values: dict[str, Any]) -> _File:
    try:
        return _File.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        what = "is missing" if first["type"] == "missing" else f"is wrong ({first['msg']})"
        raise ResultFileError(path, f"key `{where}` {what}") from error


def _loaded(path: Path, model: DynamicModel, bodies: list[float] | None) -> DynamicModel:
    """With friction by load made of the bodies that it was estimated with."""
    if bodies is None:
        raise ResultFileError(path, "key `estimate.loads` is missing, of which the friction by load is made")
    try:
        return model.with_load(bodies)
    except ShapeError as error:
        raise ResultFileError(path, f"key `estimate.loads` is wrong ({error})") from error


def _log(log: _Log) -> RecordedLog:
    return RecordedLog(log.path, log.sha256, log.role, log.start, log.start + (log.samples - 1) * log.dt)


def _interval(p: _Parameter) -> tuple[float, float]:
    low, high = p.interval95
    return (-np.inf if low is None else low, np.inf if high is None else high)


def _validations(errors: list[_Error], model: DynamicModel, *, seen: bool) -> tuple[Validation, ...]:
    """Errors motor by motor are one validation; each ends with the entry of all motors."""
    labels = dict(zip(model.device.row_names, model.device.row_labels, strict=True))
    made: list[Validation] = []
    motors: list[MotorError] = []
    for e in errors:
        if (e.rows == "fit") is not seen:
            continue
        if e.residual is None or e.measured is None or e.count is None or e.unit is None:
            made.append(Validation(tuple(motors), seen))
            motors = []
        else:
            motors.append(MotorError(e.motor, labels.get(e.motor, e.motor), e.unit, e.residual, e.measured, e.count))
    return tuple(made)
