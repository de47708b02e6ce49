"""`haptid channels`."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import app, errors_shown, out

if TYPE_CHECKING:
    from haptid.log.survey import ChannelSurvey, Survey, TopicSurvey

HELP = """\
List what a log contains: topics, rates, joints, empty fields, stamps; and a [channels] table for a study.

LOG is a file (CSV, Parquet, MAT, NPZ, NPY, HDF5, MCAP, ROS bag, db3, TDMS) or the folder of a ROS 2 bag or of a LeRobot
data set. Quantities and units are guessed from names, stated units and ranges: the table is a draft, each line with the
reason of its guess, and nothing is read by it before it stands in a study.

Exit status: 0 on success, 2 if the log cannot be read; the message says what to do.

Example: haptid channels run.mcap
"""
# Channels of a topic that are printed.
_PRINTED = 60


@app.command(help=HELP)
def channels(
    log: Annotated[Path, typer.Argument(help="the log: a file or a folder", show_default=False)],
    toml: Annotated[bool, typer.Option("--toml", help="print only the [channels] table")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="print everything as JSON")] = False,
) -> None:
    from haptid.log.survey import survey

    with errors_shown():
        found = survey(log)
    if as_json:
        sys.stdout.write(found.to_json())
    elif toml:
        sys.stdout.write(found.table)
    else:
        _show(found)


def _show(found: Survey) -> None:
    out.print(f"{found.path}: {found.format}", highlight=False)
    for note in found.notes:
        out.print(f"  {note}", highlight=False)
    for topic in found.topics:
        _show_topic(topic)
    out.print()
    if found.table:
        out.print("Draft for a study; units and choices are guesses, to be checked:\n", highlight=False)
        sys.stdout.write(found.table)
    else:
        out.print("No channels of positions were recognised by name; name them in [channels].", highlight=False)


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
