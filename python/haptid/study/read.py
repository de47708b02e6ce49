"""`read_study`: a study file as a `Study`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.toml_tables import read_checked
from haptid.device.priors import PriorBody, tensor
from haptid.errors import LogError, SettingError, StudyFileError, TreatmentError
from haptid.estimation import Method
from haptid.estimation.method import only_weights_rows
from haptid.inference.payloads import AttachedBody
from haptid.log import Channels, Merge, Signal
from haptid.log.registers import Register
from haptid.motion.filters import SHAPES, Causal, HighPass
from haptid.motion.holds import HoldDetection
from haptid.motion.treatment import Treatment
from haptid.observation.known_payload import Payload
from haptid.simulation import PID
from haptid.study.method import INTERVALS, method_of
from haptid.study.schema import (
    CalibrationTable,
    ChannelsTable,
    ControllerTable,
    CrossValidation,
    EstimateTable,
    LogTable,
    PayloadTable,
    PosesTable,
    SignalTable,
    StudyTable,
    TimeTable,
    TreatmentTable,
    Use,
    ValidationTable,
    fault,
)
from haptid.study.study import LogEntry, PoseSettings, Study
from haptid.treatment_choice.calibration import CalibrationPrior


def read_study(path: str | Path) -> Study:
    """Read a study file.

    Raises:
        StudyFileError: the file cannot be read; a key in it is missing, unknown or wrong; there is no log to identify
            from, or one is named twice; the method requires a controller, and there is none.
    """
    path = Path(path)
    table = read_checked(path, StudyTable, StudyFileError, "a study")
    poses = _poses(path, table.poses) if table.poses else None
    timeless = poses is not None and poses.table
    logs = tuple(_log(path, k, log, table.channels, timeless) for k, log in enumerate(table.logs))
    _check_logs(path, logs, table.validation)
    controller = _controller(path, table.controller) if table.controller else None
    method = method_of(path, table.estimate, controller)
    return Study(
        name=table.name or path.stem,
        path=path,
        device=_device(path, table.device),
        logs=logs,
        treatment=_treatment(path, table.treatment),
        method=method,
        cross_validation=_cross_validation(table.validation, logs),
        largest_error=table.criteria.relative_error_percent,
        intervals=INTERVALS[table.estimate.intervals](),
        controller=controller,
        poses=poses,
        calibration=_calibration(path, table.calibration) if table.calibration else None,
        use=_use(path, table.estimate, method),
        method_given=table.estimate.method is not None,
    )


def _use(study: Path, table: EstimateTable, method: Method) -> Use:
    """The wanted model for use, which only a method without constraints and prior leaves to choose."""
    if table.use is not None and not only_weights_rows(method):
        raise fault(
            study,
            "estimate.use",
            f"the model for use is the estimate itself, by {method.name}",
            table.use,
            "Leave it out.",
        )
    return table.use or "auto"


def _poses(study: Path, table: PosesTable) -> PoseSettings:
    still = None if table.still is None else tuple(table.still) if isinstance(table.still, list) else (table.still,)
    if table.approach and not table.table:
        raise fault(study, "poses.approach", "only a table has channels of approach; a log is searched for them")
    try:
        return PoseSettings(table.table, HoldDetection(table.hold_s, table.settle_s, still), tuple(table.approach))
    except TreatmentError as error:
        raise fault(study, "poses", str(error).rstrip(".")) from error


def _treatment(study: Path, table: TreatmentTable) -> dict[str, Any]:
    """Given settings of `Treatment`."""
    given: dict[str, Any] = table.model_dump(exclude_none=True)
    shape, order = given.pop("parallel_shape", None), given.pop("parallel_order", None)
    if order is not None and shape != "causal":
        raise fault(study, "treatment.parallel_order", "only the shape 'causal' has an order")
    if shape is not None:
        given["parallel_shape"] = Causal(order or 1) if shape == "causal" else SHAPES[shape]
    if "velocity_cutoff_hz" in given:
        given |= {"velocity": HighPass(given.pop("velocity_cutoff_hz")), "cutoff_hz": given.get("cutoff_hz")}
    settings: dict[str, Any] = {key: None if value == "none" else value for key, value in given.items()}
    Treatment(**settings)  # a setting without meaning is an error before any log is read
    return settings


def _calibration(study: Path, table: CalibrationTable) -> CalibrationPrior:
    std = table.home_offset_std
    try:
        return CalibrationPrior(
            tuple(std) if isinstance(std, list) else std, table.each_log, table.gravity_direction_std
        )
    except SettingError as error:
        raise fault(study, "calibration", str(error).rstrip(".")) from error


def _controller(study: Path, table: ControllerTable) -> PID:
    settings: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key, value in table.model_dump(exclude={"reference"}, exclude_none=True).items()
    }
    if table.reference is not None:
        signal = SignalTable.model_validate(table.reference.model_dump() | {"constant_ok": True})
        settings["reference"] = _signal(study, "controller.reference", signal)
    try:
        return PID(**settings)
    except SettingError as error:
        raise fault(study, "controller", str(error).rstrip(".")) from error


def _device(study: Path, text: str) -> str | Path:
    """A path, or the name of a shipped device."""
    return study.parent / text if text.endswith(".toml") or "/" in text or "\\" in text else text


def _log(study: Path, index: int, log: LogTable, common: ChannelsTable | None, timeless: bool) -> LogEntry:
    table = log.channels or common
    time_range = (log.time_range[0], log.time_range[1]) if log.time_range else None
    if time_range and time_range[0] >= time_range[1]:
        start, stop = time_range
        raise fault(study, f"logs.{index}.time_range", f"ends at {stop} before it begins at {start}")
    exclude = tuple((start, stop) for start, stop in log.exclude or ())
    for start, stop in exclude:
        if start > stop:
            raise fault(study, f"logs.{index}.exclude", f"a part ends at {stop} before it begins at {start}")
    channels = None
    if table:
        key = f"logs.{index}.channels" if log.channels else "channels"
        if timeless and (table.time is not None or table.rate_hz is not None):
            raise fault(study, key, "a table with one row a pose has neither `time` nor `rate_hz`")
        if not timeless and (table.time is None) == (table.rate_hz is None):
            raise fault(study, key, "give `time` (a channel) or `rate_hz`, one of the two")
        try:
            channels = Channels(
                position=_signal(study, f"{key}.position", table.position),
                torque=_signal(study, f"{key}.torque", table.torque),
                time=_time(study, key, table),
                time_unit=table.time_unit or ("ns" if isinstance(table.time, TimeTable) else "s"),
                rate_hz=1.0 if timeless else table.rate_hz,
                sampling=table.sampling,
                stale=table.stale,
                merge=Merge(table.merge.method, table.merge.largest_gap),
                velocity=None if table.velocity is None else _signal(study, f"{key}.velocity", table.velocity),
            )
        except LogError as error:
            raise fault(study, key, str(error).rstrip(".")) from error
    elif timeless:
        raise fault(study, "channels", "a table with one row a pose requires them")
    episodes = None if log.episodes is None else tuple(log.episodes)
    if log.payload is None:
        return LogEntry(log.path, log.role, time_range, channels, episodes=episodes, exclude=exclude)
    payload = _payload(study, f"logs.{index}.payload", log.path, log.payload)
    return LogEntry(log.path, log.role, time_range, channels, *payload, episodes, exclude)


def _time(study: Path, key: str, table: ChannelsTable) -> str | None:
    """Name of the time channel."""
    if not isinstance(table.time, TimeTable):
        return table.time
    if table.time_unit not in (None, "ns"):
        raise fault(study, f"{key}.time_unit", "stamps of messages are in ns", table.time_unit)
    signal = table.position if table.merge.onto == "position" else table.torque
    topic = table.time.topic or signal.topic
    if topic is None:
        raise fault(study, f"{key}.time", f"give its `topic`, or that of the {table.merge.onto}")
    return f"{topic}@{table.time.stamp}"


def _names(study: Path, key: str, table: SignalTable) -> tuple[str, ...]:
    """Names of a signal's channels: as given, or the joints of a field."""
    if table.channels is not None:
        if table.topic or table.field or table.joints:
            raise fault(study, key, "give either `channels`, or `field` with `topic` and `joints`")
        return tuple(table.channels)
    if table.field is None:
        raise fault(study, key, "give `channels`, or `field` with `joints` (and the `topic` of messages)")
    array = table.field if table.topic is None else f"{table.topic}.{table.field}"
    return tuple(f"{array}[{joint}]" for joint in table.joints) if table.joints else (array,)


def _payload(study: Path, key: str, log: str, table: PayloadTable) -> tuple[Payload | None, AttachedBody]:
    """The payload where it is known well enough to be subtracted, and what is known of it."""
    inertia = None if table.inertia is None else tensor(np.array(table.inertia))
    com = None if table.com is None else np.array(table.com)
    try:
        body = AttachedBody(table.name or Path(log).stem, table.link, table.mass, com, inertia)
    except SettingError as error:
        raise fault(study, key, str(error).rstrip(".")) from error
    known = None if table.mass is None or com is None else Payload(table.link, PriorBody(table.mass, com, inertia))
    return known, body


def _signal(study: Path, key: str, table: SignalTable) -> Signal:
    names = _names(study, key, table)

    def spread(name: str, value: float | list[float]) -> tuple[float, ...]:
        values = tuple(value) if isinstance(value, list) else (value,) * len(names)
        if len(values) != len(names):
            raise fault(study, f"{key}.{name}", f"{len(values)} figures for {len(names)} channels")
        return values

    if table.sign_bit is not None and table.word_bits is not None:
        raise fault(study, f"{key}.word_bits", "give either `sign_bit` or `word_bits`")
    return Signal(
        channels=names,
        unit=table.unit if isinstance(table.unit, str) else next(iter(table.unit), ""),
        units=() if isinstance(table.unit, str) else tuple(table.unit),
        side=table.side,
        gain=spread("gain", table.gain),
        offset=spread("offset", table.offset),
        unwrap=table.unwrap,
        period=table.period,
        constant_ok=table.constant_ok,
        allow_saturation=table.allow_saturation,
        register=Register(table.sign_bit, table.word_bits),
    )


def _check_logs(study: Path, logs: tuple[LogEntry, ...], validation: ValidationTable | None) -> None:
    fitted = [log for log in logs if log.role == "identify"]
    if not fitted:
        raise fault(study, "logs", "no log has role 'identify', so there is nothing to fit")
    entries_of: dict[str, list[LogEntry]] = {}
    for log in logs:
        earlier = entries_of.setdefault(log.path, [])
        if any(_overlap(log.time_range, other.time_range) and _shared(log, other) for other in earlier):
            raise fault(
                study,
                "logs",
                f"{log.path!r} is named twice; give the two entries parts or episodes that do not overlap",
            )
        earlier.append(log)
    if validation and validation.cross_validation == "leave-one-log-out" and len(fitted) < 2:
        raise fault(
            study, "logs", "cross_validation = 'leave-one-log-out' needs at least two logs with role 'identify'"
        )


def _cross_validation(table: ValidationTable | None, logs: tuple[LogEntry, ...]) -> CrossValidation | None:
    """The given scheme; without one, blocks where no log is for validation.

    A fit to all logs but one would fail where each of them moves another joint.
    """
    if table is not None:
        return None if table.cross_validation == "none" else table.cross_validation
    return None if any(log.role == "validate" for log in logs) else "blocks"


def _overlap(a: tuple[float, float] | None, b: tuple[float, float] | None) -> bool:
    return a is None or b is None or (a[0] < b[1] and b[0] < a[1])


def _shared(a: LogEntry, b: LogEntry) -> bool:
    """Whether two entries of one data set have an episode in common."""
    return a.episodes is None or b.episodes is None or not set(a.episodes).isdisjoint(b.episodes)
