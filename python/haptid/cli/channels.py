"""`haptid channels`."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import AsJson, command, errors_shown, out, print_json

if TYPE_CHECKING:
    from haptid.log.survey import ChannelSurvey, Survey, TopicSurvey

HELP = """\
List what a log contains: topics, rates, joints, empty fields, stamps; and a draft of a study.

LOG is a file (CSV, Parquet, MAT, NPZ, NPY, HDF5, MCAP, ROS bag, db3, TDMS) or the folder of a ROS 2 bag or of a LeRobot
data set. Files of one quantity each, as q.csv and tau.csv, are one log; in a study it is a folder, or a path with one
`*`. Quantities and units are guessed from names, stated units and ranges: the table is a draft, each line with the
reason of its guess, and nothing is read by it before it stands in a study. Without --device, the draft is the table
[channels] alone; with it, a study of all LOGs, of which all but the first validate.

Exit status: 0 on success, 2 if the log cannot be read; the message says what to do.

Example: `haptid channels sweep.mcap check.mcap --device arm.toml --out study.toml`
"""
# Channels of a topic that are printed.
_PRINTED = 60


@command(HELP)
def channels(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG", help="files or folders", show_default=False)],
    device: Annotated[str | None, typer.Option(help="a device file: choose and order channels by its joints")] = None,
    study: Annotated[Path | None, typer.Option("--out", help="the study to write; needs --device")] = None,
    toml: Annotated[bool, typer.Option("--toml", help="print only the draft")] = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.atomic_folder import publishing_files
    from haptid.device import read_device
    from haptid.errors import OptionError
    from haptid.log.survey import survey
    from haptid.log.survey.draft import unrecognised
    from haptid.log.survey.parts import parts_in_words, recordings
    from haptid.study.draft import draft_study

    with errors_shown():
        apart = recordings(logs) if device is None else []
        given, logs = len(logs), apart or logs
        if device is None and (study or len(logs) > 1):
            drafted = f"a study of {len(logs)} logs is drafted" if len(logs) > 1 else "--out writes a study, drafted"
            raise OptionError(f"{drafted} with a device file only; add --device DEVICE.", where="--device")
        if device is None:
            surveyed = survey(logs[0])
            if given > 1:
                surveyed = replace(surveyed, notes=(parts_in_words(apart), *surveyed.notes))
            draft = surveyed.table
        else:
            folder = study.parent if study else Path()
            draft, surveyed = draft_study(logs, read_device(device), device, folder)
        if study is not None:
            with publishing_files(study) as new:
                (new / study.name).write_text(draft, encoding="utf-8")
    if as_json:
        print_json("channels", surveyed.to_json())
    elif toml:
        sys.stdout.write(draft or unrecognised(surveyed.topics))
    else:
        _show(surveyed, draft, study)


def _show(surveyed: Survey, draft: str, study: Path | None) -> None:
    from haptid.log.survey.draft import WITHOUT_TORQUE, unrecognised

    out.print(f"{surveyed.path}: {surveyed.format}", highlight=False)
    for note in surveyed.notes:
        out.print(f"  {note}", highlight=False)
    if surveyed.unequal:
        out.print(f"  {surveyed.unequal}", highlight=False)
    for topic in surveyed.topics:
        _show_topic(topic)
    out.print()
    if not surveyed.table:
        out.print("No channels of positions were recognised; name them in [channels].", highlight=False)
        if study is None:
            sys.stdout.write(unrecognised(surveyed.topics))
    if study is not None and surveyed.lacking:
        lacking = " and ".join(f"{key}s" for key in surveyed.lacking)
        out.print(
            f"Study in {study}; it lacks {lacking}, which were not recognised: name their channels in [channels]."
        )
        if "torque" in surveyed.lacking and WITHOUT_TORQUE in draft:
            out.print(f"Where there are none: {WITHOUT_TORQUE}. haptid excite plans a motion for that.")
    elif study is not None:
        out.print(f"Study in {study}. Units and choices are guesses: check them, then haptid identify {study}")
    elif draft:
        out.print("Draft for a study; units and choices are guesses, to be checked:\n", highlight=False)
        sys.stdout.write(draft)


def _show_topic(topic: TopicSurvey) -> None:
    from rich.table import Table

    rate = f", {topic.rate_hz:.6g} Hz" if topic.rate_hz else ""
    rows = "messages" if topic.name else "rows"
    out.print(f"\n{topic.name or 'table'} ({topic.kind}): {topic.count} {rows}{rate}", highlight=False)
    if topic.why_not:
        out.print(f"  {topic.why_not}", highlight=False)
        return
    if topic.header and math.isfinite(topic.late_ms):
        out.print(f"  stamps: {topic.header}; received {topic.late_ms:.4g} ms later (median)", highlight=False)
    elif topic.name:
        out.print('  no stamps in the messages: stamp = "receive"', highlight=False)
    if topic.joints and not all(joint.isdecimal() for joint in topic.joints):
        out.print(f"  joints: {', '.join(topic.joints)}", highlight=False)
    for array, count in topic.empty.items():
        out.print(f"  {array} is empty in {count} of {topic.count} messages", highlight=False)
    table = Table("channel", "samples", "missing", "range", "guess", "reason", box=None, pad_edge=False)
    for channel in topic.channels[:_PRINTED]:
        table.add_row(*_cells(channel))
    out.print(table, highlight=False)
    if len(topic.channels) > _PRINTED:
        out.print(f"  and {len(topic.channels) - _PRINTED} more (--json lists them)", highlight=False)


def _cells(channel: ChannelSurvey) -> tuple[str, ...]:
    spread = f"{channel.low:.5g} .. {channel.high:.5g}" if channel.count else "nothing but NaN"
    if channel.count and channel.low == channel.high:
        spread = f"{channel.low:.5g}, constant"
    guess = f"{channel.quantity}, {channel.unit}" if channel.unit else channel.quantity
    return channel.name, str(channel.count), str(channel.missing or ""), spread, guess, channel.reason
