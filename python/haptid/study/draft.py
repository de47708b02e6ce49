"""`draft_study`: the text of a study of logs whose channels are guessed, to be checked by a person."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from haptid._internal.toml_text import basic_string
from haptid.device import Device
from haptid.errors import HaptidError
from haptid.log.file_format import format_of, logs_in
from haptid.log.formats.folders import log_files, table_files
from haptid.log.survey import Survey, survey


def draft_study(
    logs: Sequence[str | Path], device: Device, device_path: str, folder: str | Path = "."
) -> tuple[str, Survey]:
    """A study of a device and logs, in TOML, and the survey of the first log, from which its channels are.

    Args:
        logs: paths; the second one and later ones validate. One folder of runs, each a file with all channels or a
            folder, stands for its runs.
        device: whose active joints the channels are for, by name or alias.
        device_path: as the study names it: a path, or the name of a shipped device.
        folder: where the study will be; paths are relative to it.

    Raises:
        LogFileError: the first log cannot be read.
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
    given, logs = logs, _runs(logs, len(names))
    surveyed = survey(logs[0], names, driven_names, units.pop() if len(units) == 1 else "", straight)
    if logs is not given:
        said = f"{given[0]} holds {len(logs)} runs: the first one identifies, the others validate; channels are of it"
        surveyed = replace(surveyed, notes=(said, *surveyed.notes))
    surveyed = replace(surveyed, notes=(*surveyed.notes, *_elsewhere(surveyed, logs[1:])))
    path = Path(device_path)
    if path.suffix == ".toml" or path.parts[1:]:
        device_path = _relative(path, folder)
        device_path = device_path if "/" in device_path or device_path.endswith(".toml") else f"./{device_path}"
    lines = ["schema = 1", f"name = {basic_string(device.name)}", f"device = {basic_string(device_path)}", ""]
    lines.append(surveyed.table or "[channels]  # no channels of positions were recognised: name them here\n")
    for k, log in enumerate(logs):
        lines += ["[[logs]]", f"path = {basic_string(_relative(Path(log), folder))}"]
        lines += ['role = "validate"', ""] if k else [""]
    return "\n".join(lines).rstrip() + "\n", surveyed


def _runs(logs: Sequence[str | Path], joints: int) -> Sequence[str | Path]:
    """The runs of one folder that holds several: tables of equal columns with all joints, or folders; else the logs."""
    folder = Path(logs[0])
    if len(logs) > 1 or not folder.is_dir():
        return logs
    if not log_files(folder):
        return logs_in(folder) or logs
    tables = table_files(folder) if format_of(folder).name == "folder of tables" else []
    try:
        columns = {tuple(format_of(file).names(file)) for file in tables}
        first = survey(tables[0]) if len(columns) == 1 else None
    except HaptidError:  # a note among them, which the folder's own reader passes over
        return logs
    positions = sum(c.quantity == "position" for topic in first.topics for c in topic.channels) if first else 0
    return tables if first and not first.lacking and positions >= joints else logs


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
                f"{Path(other).name} has {has}, which {surveyed.path.name} lacks: a log is one file with all of its "
                "channels; put their columns side by side in one table"
            )


def _relative(path: Path, folder: str | Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()
