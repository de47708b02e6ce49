"""A study: the corridor from device and logs to a validated estimate, written down as TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from haptid.causal import Causal, HighPass
from haptid.device.prior import Body, tensor
from haptid.errors import (
    ControllerError,
    LogError,
    MethodSettingError,
    StudyControllerError,
    StudyFileError,
    StudyLogsError,
)
from haptid.estimators import (
    CLIE,
    CLOE,
    DIDIM,
    EKF,
    GLS,
    IRLS,
    IV,
    OLS,
    SUR,
    TLS,
    UKF,
    WLS,
    BlockJackknife,
    Bootstrap,
    Bounded,
    Clustered,
    Consistent,
    Corrected,
    Equal,
    FixedB,
    Heteroscedastic,
    Huber,
    Intervals,
    Loss,
    Method,
    OutputError,
    Profile,
    Ridge,
    Sandwich,
    StudentT,
    Textbook,
    Tukey,
)
from haptid.estimators.entropic import Entropic
from haptid.estimators.simulating import ClosedLoop
from haptid.loads import Load
from haptid.log import Channels, Signal
from haptid.shapes import SHAPES
from haptid.simulation import PID
from haptid.treatment import Treatment

Role = Literal["identify", "validate"]
# A study is a page of text; anything much larger is not one.
LARGEST_FILE = 1 << 20

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class SignalTable(_Table):
    """Which channels are the positions, or the torques, and in what unit."""

    channels: list[str] = Field(min_length=1, description="one channel for each joint or motor, in the device's order")
    unit: str = Field(description="rad, deg, turn, m, mm, um, counts; N m, mN m, N, V, mV, A, mA, counts")
    side: Literal["joint", "motor"] = Field("joint", description="measured at the joint or at the motor's shaft")
    gain: Finite | list[Finite] = Field(1.0, description="the channel is multiplied by this first")
    offset: Finite | list[Finite] = Field(0.0, description="added after the gain and the unit, SI")
    unwrap: bool = Field(False, description="the angle jumps by a whole turn: put the turns back")
    period: Positive | None = Field(None, description="the jump of a wrapped channel, in its own unit; one turn")
    constant_ok: bool = Field(False, description="a channel that never changes is meant to")
    allow_saturation: bool = Field(False, description="a torque held at its limit is meant to be used")


class ChannelsTable(_Table):
    """Where time, positions and torques are in the log files."""

    time: str | None = Field(None, description="channel of the sample times; or give rate_hz")
    time_unit: str = Field("s", description="s, ms, us or ns")
    rate_hz: Positive | None = Field(None, description="sampling rate, where the log has no times")
    position: SignalTable
    torque: SignalTable


class LoadTable(_Table):
    """A known body that was fixed to a link while the log was recorded; a point mass where `inertia` is left out."""

    link: str = Field(description="name of the link's joint")
    mass: Positive = Field(description="kg")
    com: list[Finite] = Field(min_length=3, max_length=3, description="centre of mass in the file's link frame, m")
    inertia: list[Finite] | None = Field(
        None, min_length=6, max_length=6, description="XX YY ZZ XY XZ YZ about the centre of mass, kg m^2"
    )


class LogTable(_Table):
    """One log and what it is for."""

    path: str = Field(description="relative to --data, or to the study file")
    role: Role = Field("identify", description="identify: the fit sees it; validate: it is only predicted")
    stretch: list[Finite] | None = Field(None, min_length=2, max_length=2, description="only from .. to, s")
    channels: ChannelsTable | None = Field(None, description="where this log's channels differ from the study's")
    load: LoadTable | None = Field(None, description="known load of this recording; its torque is taken off")


class TreatmentTable(_Table):
    """How logs become rows; what is not given is proposed from the logs. See `haptid.Treatment`."""

    cutoff_hz: Positive | Literal["none"] | None = Field(
        None, description="-3 dB of the position filter, Hz, or 'none'"
    )
    order: int | None = Field(None, ge=1, le=12, description="order of one pass of the Butterworth filter; default 4")
    decimation: int | None = Field(None, ge=1, description="one row is kept of so many samples")
    parallel_cutoff_hz: Positive | None = Field(None, description="-3 dB of the filter that torque and W share, Hz")
    parallel_shape: Literal["bell", "sharp", "causal"] | None = Field(
        None, description="of that filter: bell (default), sharp as published recipes have it, or causal"
    )
    parallel_order: int | None = Field(None, ge=1, le=12, description="of the causal filter; default 1")
    accelerations: Literal["differences", "momentum"] | None = Field(
        None, description="differences of the positions (default), or momentum: rows without accelerations"
    )
    velocity_cutoff_hz: Positive | None = Field(
        None, description="velocity by a causal differentiator of the positions, Hz; with accelerations = 'momentum'"
    )
    low_speed: Finite | list[Finite] | None = Field(
        None, description="rows slower than this are dropped, rad/s or m/s; 0 for none"
    )
    guard: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        None,
        description="rows this near slow motion are dropped too, s; default: all that the shared filter reaches",
    )
    block: Positive | None = Field(None, description="length of a time block, s; default 1")
    torque_delay: Finite | None = Field(
        None, description="the torque that acts is the channel's of so much earlier, s; 0 for none"
    )


class ReferenceTable(_Table):
    """Channels of the planned positions, in the log files."""

    channels: list[str] = Field(min_length=1, description="one channel for each active joint, in the device's order")
    unit: str = Field(description="rad, deg, turn, m, mm, um, counts")
    gain: Finite | list[Finite] = Field(1.0, description="the channel is multiplied by this first")
    offset: Finite | list[Finite] = Field(0.0, description="added after the gain and the unit, SI")


class ControllerTable(_Table):
    """The controller that moved the device while it was logged; one figure for all motors, or one for each."""

    kp: Finite | list[Finite] = Field(description="gain of the position error at the joint side, N m/rad or N/m")
    kd: Finite | list[Finite] = Field(description="gain of the velocity error, N m s/rad or N s/m")
    ki: Finite | list[Finite] = Field(0.0, description="gain of the integral of the position error; 0 for none")
    rate_hz: Positive | None = Field(None, description="control rate, a multiple of the log's; default: the log's")
    velocity_cutoff_hz: Positive | None = Field(
        None, description="of the first-order filter behind the difference of positions; none where left out"
    )
    saturation: Positive | list[Positive] | None = Field(None, description="greatest torque of a motor, N m or N")
    reference: ReferenceTable | None = Field(None, description="planned positions; the treated ones where left out")


class HoldoutTable(_Table):
    """Rows that are predicted by a fit that has not seen them."""

    pattern: Literal["alternate", "each-log"] = Field(
        description="alternate: every other time block; each-log: every log in turn"
    )


class LimitTable(_Table):
    """Between what a base parameter is held."""

    low: Finite | None = Field(None, description="least value, SI")
    high: Finite | None = Field(None, description="largest value, SI")


class EstimateTable(_Table):
    """The estimator."""

    method: Literal[
        "OLS",
        "WLS",
        "SUR",
        "GLS",
        "IRLS",
        "heteroscedastic",
        "TLS",
        "encoder noise",
        "ridge",
        "entropic",
        "IV",
        "DIDIM",
        "CLIE",
        "CLOE",
        "output error",
        "EKF",
        "UKF",
    ] = Field("WLS", description="how rows are weighted, and what is taken off or added; see the page on estimators")
    passes: int | None = Field(
        None, ge=1, description="times the weights are made anew; only of WLS, SUR, GLS, heteroscedastic and ridge"
    )
    loss: Literal["Tukey", "Huber", "Student t"] | None = Field(None, description="IRLS: what wild rows count; Tukey")
    resolution: Positive | list[Positive] | None = Field(
        None, description="encoder noise: step of the position channels, rad or m; the log's smallest"
    )
    share: Positive | None = Field(None, description="ridge: deviation of prior values that have none, as a share; 0.3")
    strength: Positive | None = Field(None, description="ridge, entropic: of the pull; the one that predicts best")
    intervals: Literal["clustered", "jackknife", "textbook", "sandwich", "fixed-b", "bootstrap", "profile"] = Field(
        "clustered", description="how deviations are made; see the page on estimators"
    )
    possible: bool = Field(False, description="hold the estimate to what bodies and passive friction can have")
    limits: dict[str, LimitTable] | None = Field(None, description="hold base parameters between limits, by name")
    relations: dict[str, Finite] | None = Field(None, description="combinations of parameters and their exact values")


class CriteriaTable(_Table):
    """What the result must meet; the exit status of `haptid identify` says whether it does."""

    relative_error_percent: Positive | None = Field(None, description="largest relative error on unseen rows")


class StudyTable(_Table):
    """A study file."""

    schema_: Literal[1] = Field(alias="schema", description="version of this format: 1")
    name: str = Field(min_length=1)
    device: str = Field(description="name of a shipped device, or path of a device file, relative to the study")
    channels: ChannelsTable | None = None
    logs: list[LogTable] = Field(min_length=1)
    treatment: TreatmentTable = TreatmentTable.model_construct()
    holdout: HoldoutTable | None = None
    controller: ControllerTable | None = None
    estimate: EstimateTable = EstimateTable.model_validate({})
    criteria: CriteriaTable = CriteriaTable.model_construct(relative_error_percent=None)


@dataclass(frozen=True)
class LogEntry:
    """A log of a study: where it is, what it is for, how its channels are mapped, what was fixed to the device."""

    path: str
    role: Role
    stretch: tuple[float, float] | None
    channels: Channels | None
    load: Load | None = None


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
    intervals: Intervals = field(default_factory=Clustered)
    controller: PID | None = None


def study_schema() -> dict[str, Any]:
    """JSON Schema of study files, for editors."""
    return StudyTable.model_json_schema(by_alias=True)


def read_study(path: str | Path) -> Study:
    """Read a study file.

    Raises:
        StudyFileError: the file cannot be read, or a key in it is missing, unknown or wrong; says which.
        StudyLogsError: the logs cannot serve the study: none to identify from, or one named twice.
        StudyControllerError: the method needs the controller that moved the device, and there is none.
    """
    path = Path(path)
    table = _parse(path)
    logs = tuple(_log(path, k, log, table.channels) for k, log in enumerate(table.logs))
    _check_logs(path, logs, table.holdout)
    controller = _controller(path, table.controller) if table.controller else None
    return Study(
        name=table.name,
        path=path,
        device=_device(path, table.device),
        logs=logs,
        treatment=_treatment(path, table.treatment),
        method=_method(path, table.estimate, controller),
        holdout=table.holdout.pattern if table.holdout else None,
        largest_error=table.criteria.relative_error_percent,
        intervals=INTERVALS[table.estimate.intervals](),
        controller=controller,
    )


def _treatment(study: Path, table: TreatmentTable) -> dict[str, Any]:
    """Settings of `Treatment` that the study gives."""
    given: dict[str, Any] = table.model_dump(exclude_none=True)
    shape, order = given.pop("parallel_shape", None), given.pop("parallel_order", None)
    if order is not None and shape != "causal":
        raise StudyFileError(study, "treatment.parallel_order", "only the shape 'causal' has an order")
    if shape is not None:
        given["parallel_shape"] = Causal(order or 1) if shape == "causal" else SHAPES[shape]
    if "velocity_cutoff_hz" in given:
        given |= {"velocity": HighPass(given.pop("velocity_cutoff_hz")), "cutoff_hz": given.get("cutoff_hz")}
    settings: dict[str, Any] = {key: None if value == "none" else value for key, value in given.items()}
    Treatment(**settings)  # a setting that means nothing is an error before any log is read
    return settings


# What each method is made of, and the keys of the study that are its settings.
METHODS: Mapping[str, tuple[Callable[..., Method], tuple[str, ...]]] = {
    "OLS": (OLS, ()),
    "WLS": (WLS, ("passes",)),
    "SUR": (SUR, ("passes",)),
    "GLS": (GLS, ("passes",)),
    "IRLS": (IRLS, ("loss",)),
    "heteroscedastic": (Heteroscedastic, ("passes",)),
    "TLS": (TLS, ()),
    "encoder noise": (Corrected, ("resolution",)),
    "ridge": (Ridge, ("share", "strength", "passes")),
    "entropic": (Entropic, ("strength",)),
    "IV": (IV, ()),
    "DIDIM": (DIDIM, ()),
    "CLIE": (CLIE, ()),
    "CLOE": (CLOE, ()),
    "output error": (OutputError, ()),
    "EKF": (EKF, ()),
    "UKF": (UKF, ()),
}
INTERVALS: Mapping[str, Callable[[], Intervals]] = {
    "clustered": Clustered,
    "jackknife": BlockJackknife,
    "textbook": Textbook,
    "sandwich": Sandwich,
    "fixed-b": FixedB,
    "bootstrap": Bootstrap,
    "profile": Profile,
}
LOSSES: Mapping[str, Callable[[], Loss]] = {"Tukey": Tukey, "Huber": Huber, "Student t": StudentT}
SETTINGS = tuple(dict.fromkeys(key for _, keys in METHODS.values() for key in keys))
HOLDING = ("possible", "limits", "relations")


def _controller(study: Path, table: ControllerTable) -> PID:
    given: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key, value in table.model_dump(exclude={"reference"}, exclude_none=True).items()
    }
    if table.reference is not None:
        signal = SignalTable.model_validate(table.reference.model_dump() | {"constant_ok": True})
        given["reference"] = _signal(study, "controller.reference", signal)
    try:
        return PID(**given)
    except ControllerError as error:
        raise StudyFileError(study, "controller", str(error).rstrip(".")) from error


def _method(study: Path, table: EstimateTable, controller: PID | None) -> Method:
    make, keys = METHODS[table.method]
    given = {key: value for key in SETTINGS if (value := getattr(table, key)) is not None}
    for key in given:
        if key not in keys:
            raise StudyFileError(study, f"estimate.{key}", f"the method {table.method!r} has no such setting")
    if "loss" in given:
        given["loss"] = LOSSES[given["loss"]]()
    if isinstance(make, type) and issubclass(make, ClosedLoop):
        if controller is None:
            raise StudyControllerError(study, table.method)
        given["controller"] = controller
    if isinstance(given.get("resolution"), list):
        given["resolution"] = tuple(given["resolution"])
    held = [key for key in HOLDING if getattr(table, key)]
    if len(held) > 1:
        raise StudyFileError(study, f"estimate.{held[1]}", f"beside {held[0]}: give one of {', '.join(HOLDING)}")
    try:
        return _held(table, make(**given))
    except MethodSettingError as error:
        raise StudyFileError(study, "estimate", str(error).rstrip(".")) from error


def _held(table: EstimateTable, weighting: Method) -> Method:
    """The method with what holds its estimate."""
    if table.possible:
        return Consistent(weighting)
    if table.limits:
        return Bounded({name: (limit.low, limit.high) for name, limit in table.limits.items()}, weighting)
    return Equal(table.relations, weighting) if table.relations else weighting


def _parse(path: Path) -> StudyTable:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise StudyFileError(path, "", f"the file is larger than {LARGEST_FILE >> 20} MiB, so it is no study")
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise StudyFileError(path, "", "there is no such file; give the path of a study's TOML file") from error
    except (OSError, ValueError) as error:  # not readable, not UTF-8, not TOML
        raise StudyFileError(path, "", str(error)) from error
    try:
        return StudyTable.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where, table, key = _place(first["loc"])
        known = list(_fields(table)) if key not in _fields(table) else None
        raise StudyFileError(path, where, _sentence(first, table, key), known) from error


def _sentence(error: Any, table: type[BaseModel], key: str) -> str:
    """What is wrong with a key: what was found, and what the key is for."""
    found = "" if error["type"] == "missing" else f" (found {str(error.get('input'))[:60]!r})"
    text = {"missing": "this key is missing", "extra_forbidden": "there is no such key"}.get(error["type"])
    field = _fields(table).get(key)
    meaning = f"; {key} is {field.description}" if field is not None and field.description else ""
    return (text or str(error["msg"])) + found + meaning


def _fields(table: type[BaseModel]) -> dict[str, Any]:
    """Fields of a table by the names they have in the file."""
    return {field.alias or name: field for name, field in table.model_fields.items()}


def _place(location: tuple[int | str, ...]) -> tuple[str, type[BaseModel], str]:
    """Where an error is: as text, the table, and the key in it; without the tags of pydantic's unions."""
    table: type[BaseModel] = StudyTable
    shown: list[str] = []
    key = ""
    for k, part in enumerate(location):
        fields = _fields(table)
        if isinstance(part, int):
            shown.append(str(part))
        elif part in fields:
            shown.append(part)
            inner = _inner(fields[part].annotation)
            if isinstance(inner, type) and issubclass(inner, BaseModel) and k + 1 < len(location):
                table, key = inner, ""
            else:
                key = part
        elif k + 1 == len(location) and not key:
            shown.append(part)  # a key that is not known
            key = part
    return ".".join(shown), table, key


def _inner(annotation: Any) -> Any:
    """The table type inside `X | None` or `list[X]`."""
    for part in getattr(annotation, "__args__", ()):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part
    return annotation


def _device(study: Path, text: str) -> str | Path:
    """A path where the study means one, else the name of a shipped device."""
    return study.parent / text if text.endswith(".toml") or "/" in text or "\\" in text else text


def _log(study: Path, index: int, log: LogTable, common: ChannelsTable | None) -> LogEntry:
    table = log.channels or common
    stretch = (log.stretch[0], log.stretch[1]) if log.stretch else None
    if stretch and stretch[0] >= stretch[1]:
        raise StudyFileError(study, f"logs.{index}.stretch", f"ends at {stretch[1]} before it begins at {stretch[0]}")
    channels = None
    if table:
        where = f"logs.{index}.channels" if log.channels else "channels"
        if (table.time is None) == (table.rate_hz is None):
            raise StudyFileError(study, where, "give `time` (a channel) or `rate_hz`, one of the two")
        try:
            channels = Channels(
                position=_signal(study, f"{where}.position", table.position),
                torque=_signal(study, f"{where}.torque", table.torque),
                time=table.time,
                time_unit=table.time_unit,
                rate_hz=table.rate_hz,
            )
        except LogError as error:
            raise StudyFileError(study, where, str(error).rstrip(".")) from error
    return LogEntry(log.path, log.role, stretch, channels, _load(log.load) if log.load else None)


def _load(table: LoadTable) -> Load:
    inertia = None if table.inertia is None else tensor(np.array(table.inertia))
    return Load(table.link, Body(table.mass, np.array(table.com), inertia))


def _signal(study: Path, where: str, table: SignalTable) -> Signal:
    def spread(name: str, value: float | list[float]) -> tuple[float, ...]:
        values = tuple(value) if isinstance(value, list) else (value,) * len(table.channels)
        if len(values) != len(table.channels):
            raise StudyFileError(study, f"{where}.{name}", f"{len(values)} figures for {len(table.channels)} channels")
        return values

    return Signal(
        channels=tuple(table.channels),
        unit=table.unit,
        side=table.side,
        gain=spread("gain", table.gain),
        offset=spread("offset", table.offset),
        unwrap=table.unwrap,
        period=table.period,
        constant_ok=table.constant_ok,
        allow_saturation=table.allow_saturation,
    )


def _check_logs(study: Path, logs: tuple[LogEntry, ...], holdout: HoldoutTable | None) -> None:
    fitted = [log for log in logs if log.role == "identify"]
    if not fitted:
        raise StudyLogsError(study, "no log has role 'identify', so there is nothing to fit")
    seen: dict[str, list[LogEntry]] = {}
    for log in logs:
        earlier = seen.setdefault(log.path, [])
        if any(_overlap(log.stretch, other.stretch) for other in earlier):
            raise StudyLogsError(
                study, f"{log.path!r} is named twice; give the two entries stretches that do not overlap"
            )
        earlier.append(log)
    if holdout and holdout.pattern == "each-log" and len(fitted) < 2:
        raise StudyLogsError(study, "holdout pattern 'each-log' needs at least two logs with role 'identify'")


def _overlap(a: tuple[float, float] | None, b: tuple[float, float] | None) -> bool:
    return a is None or b is None or (a[0] < b[1] and b[0] < a[1])
