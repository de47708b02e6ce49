"""`draft_study`: the text of a study of logs whose channels are guessed, to be checked by a person."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from haptid._internal.toml_text import basic_string
from haptid.device import Device
from haptid.errors import HaptidError, LogFileError
from haptid.log.file_format import FOLDER_OF_TABLES, format_of, logs_in
from haptid.log.formats.folders import is_pattern, log_files, table_files
from haptid.log.survey import Survey, survey
from haptid.log.survey.draft import unrecognised
from haptid.log.survey.parts import parts_in_words, recordings

# Of more runs than these each identifies, and is held out in turn: one run is seldom all of the motion.
_FEW = 2
# Times that positions or torques are those of other runs, from which another unit is likelier than another motion.
_OTHER_UNIT = 20.0


def draft_study(
    logs: Sequence[str | Path], device: Device, device_path: str, folder: str | Path = "."
) -> tuple[str, Survey]:
    """A study of a device and logs, in TOML, and the survey of the first log, from which its channels are.

    Args:
        logs: paths; the second one and later ones validate. One folder of runs, each a file with all channels, a
            folder, or files of one quantity each, stands for its runs: of two the second one validates, of more each
            is held out in turn. So do files of one quantity each, and a path with one `*` of files with all channels.
        device: whose active joints the channels are for, by name or alias.
        device_path: as the study names it: a path, or the name of a shipped device.
        folder: where the study will be; paths are relative to it.

    Raises:
        LogFileError: the first log cannot be read, or its files have different numbers of rows.
    """
    joints = {k: (device.joints[k].name, device.joints[k].alias) for k in device.active}
    motors = []
    for motor in device.motors:
        driven = np.flatnonzero(motor.row)
        single = joints.get(int(driven[0]), ()) if len(driven) == 1 else ()
        motors.append((motor.name, *single))
    names, driven_names = ([tuple(filter(None, g)) for g in groups] for groups in (joints.values(), motors))
    units = {motor.command_unit for motor in device.motors}
    straight = [device.joints[k].prismatic for k in device.active]
    given, apart = logs, recordings([Path(log) for log in logs], names, driven_names)
    logs = apart or _runs(logs, len(names))
    surveyed = survey(logs[0], names, driven_names, units.pop() if len(units) == 1 else "", straight)
    if apart:
        surveyed = replace(surveyed, notes=(parts_in_words(apart), *surveyed.notes))
    if surveyed.unequal and surveyed.format == FOLDER_OF_TABLES:
        raise LogFileError(
            f"{surveyed.path}: {surveyed.unequal}.", where=surveyed.path, advice="Cut them to the rows that they share."
        )
    each, odd = logs is not given and len(logs) > _FEW, dict[int, str]()
    if len(logs) > 1 and logs is not given:
        roles = (
            "all identify, and each is held out in turn" if each else "the first one identifies, the other validates"
        )
        odd = dict(_other_units(surveyed, logs[1:]))
        held = "there are" if len(given) > 1 else f"{given[0]} holds"
        said = [f"{held} {len(logs)} runs: {roles}; channels are of {_called(logs, 0)}"]
        said += [f"{_called(logs, k)}: {text}" for k, text in odd.items()]
        surveyed = replace(surveyed, notes=(*said, *surveyed.notes))
    surveyed = replace(
        surveyed, notes=(*surveyed.notes, *_without_gears(surveyed, device), *_elsewhere(surveyed, logs[1:]))
    )
    path = Path(device_path)
    if path.suffix == ".toml" or path.parts[1:]:
        device_path = _relative(path, folder)
        device_path = device_path if "/" in device_path or device_path.endswith(".toml") else f"./{device_path}"
    lines = ["schema = 1", f"name = {basic_string(device.name)}", f"device = {basic_string(device_path)}", ""]
    lines.append(surveyed.table or unrecognised(surveyed.topics))
    for k, log in enumerate(logs):
        note = f"  # {odd[k]}" if k in odd else ""
        lines += ["[[logs]]", f"path = {basic_string(_relative(Path(log), folder))}{note}"]
        lines += ['role = "validate"', ""] if k and not each else [""]
        lines += [own, ""] if k and (own := _own_channels(surveyed, log)) else []
    if each:
        lines += ["[validation]", 'cross_validation = "leave-one-log-out"']
    return "\n".join(lines).rstrip() + "\n", surveyed


def _runs(logs: Sequence[str | Path], joints: int) -> Sequence[str | Path]:
    """The runs of one folder, or path with one `*`, that holds several: tables that all have the channels of the first
    one, with all joints, or folders; else the logs."""
    folder = Path(logs[0])
    if len(logs) > 1 or not (folder.is_dir() or is_pattern(folder)):
        return logs
    if not log_files(folder):
        return logs if is_pattern(folder) else logs_in(folder) or logs
    if is_pattern(folder):
        tables = log_files(folder)
    else:
        tables = table_files(folder) if format_of(folder).name == FOLDER_OF_TABLES else []
    try:
        columns = [tuple(format_of(file).names(file)) for file in tables]
        first = survey(tables[0]) if columns else None
    except HaptidError:  # a note among them, which the folder's own reader passes over
        return logs
    if first is None or first.lacking or not first.table:
        return logs
    positions = sum(c.quantity == "position" for topic in first.topics for c in topic.channels)
    alike = len(set(columns)) == 1 or _drafted(first.table) <= set.intersection(*map(set, columns))
    return tables if alike and positions >= joints else logs


def _drafted(table: str) -> set[str]:
    """Names of the channels of a draft; of those that are addressed by a field, the field."""
    channels = tomllib.loads(table)["channels"]
    signals = [own for key, own in channels.items() if key in ("time", "position", "torque", "velocity")]
    signals = [{"channels": [own]} if isinstance(own, str) else own for own in signals]
    return {name for own in signals for name in own.get("channels", [own.get("field", "")])}


def _own_channels(first: Survey, log: str | Path) -> str:
    """The table of channels of a log that calls its only variable or group otherwise than the first log, as MATLAB's
    `run1.q` and `run2.q`; else empty."""
    if [topic.name for topic in first.topics] != [""] or not first.table:
        return ""
    names = [channel.name for channel in first.topics[0].channels]
    try:
        others = format_of(Path(log)).names(Path(log))
    except HaptidError:  # `identify` says what is wrong with it
        return ""
    (before, *further), (after, *more) = (sorted({name.partition(".")[0] for name in own}) for own in (names, others))
    if further or more or before == after or {name.replace(before, after, 1) for name in names} - set(others):
        return ""
    return first.table.replace(f'"{before}.', f'"{after}.').replace("[channels", "[logs.channels").rstrip()


def _other_units(first: Survey, others: Sequence[str | Path]) -> Iterator[tuple[int, str]]:
    """Runs whose positions or torques are many times those of the others, as in another unit, by their places."""
    surveys = [first]
    for other in others:
        try:
            surveys.append(survey(other))
        except HaptidError:  # `identify` says what is wrong with it
            surveys.append(replace(first, topics=()))
    for key, unit in (("position", "rad or deg, m or mm"), ("torque", "N m or N mm, A or mA")):
        found = [_sizes(one, key) for one in surveys]
        names = sorted(set.intersection(*(set(sizes) for sizes in found if sizes)) if any(found) else ())
        if not names:
            continue
        sizes = np.array([[own.get(name, np.nan) for name in names] for own in found])
        times = np.exp(np.median(np.log(sizes / np.nanmedian(sizes, axis=0)), axis=1))
        for k in np.flatnonzero(np.maximum(times, 1 / times) > _OTHER_UNIT):
            yield (
                int(k),
                f"its {key}s are {times[k]:.2g} times those of most runs: in another unit ({unit})? If so, it needs "
                "[logs.channels] of its own",
            )


def _sizes(surveyed: Survey, key: str) -> dict[str, float]:
    """Largest absolute value of each channel of a quantity that moves, by its name."""
    channels = (c for topic in surveyed.topics for c in topic.channels if c.quantity == key and c.usable)
    return {c.name: max(abs(c.low), abs(c.high)) for c in channels}


def _without_gears(surveyed: Survey, device: Device) -> Iterator[str]:
    """A sentence on positions of motors, where the device file has no gears."""
    position = tomllib.loads(surveyed.table)["channels"]["position"] if surveyed.table else {}
    if position.get("side") == "motor" and all(abs(motor.gear_ratio) <= 1 for motor in device.motors):
        yield (
            "positions are taken as those of the motors' shafts, by name and by how far they turn, and the device file "
            "has no gear ratio above 1: write `gear_ratio` of each of its [[motors]], or remove `side`"
        )


def _elsewhere(surveyed: Survey, others: Sequence[str | Path]) -> Iterator[str]:
    """Sentences on other files that have what the first one lacks, and not what it has: parts of one recording."""
    for other in others if surveyed.lacking else ():
        try:
            quantities = survey(other).quantities
        except HaptidError:
            continue
        parts = [key for key in surveyed.lacking if key in quantities]
        if parts and not quantities.issuperset(("position", "torque")):
            has = " and ".join(f"{key}s" for key in parts)
            yield (
                f"{Path(other).name} has {has}, which {surveyed.path.name} lacks: put the files of a recording into a "
                "folder of their own, and name that as the log"
            )


def _called(logs: Sequence[str | Path], k: int) -> str:
    """The name of a log, with its folder where another log has the same name."""
    path = Path(logs[k])
    alike = sum(Path(log).name == path.name for log in logs) > 1
    return f"{path.parent.name}/{path.name}" if alike else path.name


def _relative(path: Path, folder: str | Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()
