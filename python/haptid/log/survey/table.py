"""What a table contains: its channels, and the rate of its rows."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np

from haptid.errors import LogFileError
from haptid.log.by_content import Content, period_of
from haptid.log.checks import wrap_period
from haptid.log.far_off import far_off
from haptid.log.file_format import LEROBOT, Format
from haptid.log.formats.sniff import RawChannel, channel_list, group_of
from haptid.log.log import Signal
from haptid.log.merging import SPARSE
from haptid.log.registers import register_of
from haptid.log.request import Request
from haptid.log.stamp_parts import fraction_unit, sum_of, with_parts
from haptid.log.survey.beside import column_names, of_listed_joints, stated_rate, texts_beside
from haptid.log.survey.channels import A_PART, LOOKED_AT, STATED, ChannelRange, ChannelSurvey, Quantity, TopicSurvey
from haptid.log.survey.guesses import MAY_TURN, TURNS, guessed, lettered, posed, timed, usual_step, with_voltages
from haptid.log.survey.names import NESTED, base_of, element_of, is_time, quantity_of
from haptid.log.survey.recognised import recognised
from haptid.log.survey.states import with_states
from haptid.log.turns import turning_unit
from haptid.log.units import scale

# Columns of a table that are read together.
_TOGETHER = 16
# Numbers of a table that is read as a whole, to recognise channels by how they move.
_NUMBERS = 20_000_000
# A fraction of seconds reaches this, in any unit.
_FRACTION = 500.0
# Usual sampling rates, Hz, times powers of ten; one within this share is meant.
_RATES, _ROUNDED = (1.0, 1.2, 1.25, 1.5, 2.0, 2.4, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0), 0.02
# Rates that a log may have, Hz.
_SLOWEST, _FASTEST = 5.0, 1e5
# Columns of joints' names: of the array `name` of a JointState, or without a header.
_NAMING = re.compile(r"(?:(?<![A-Za-z])names?[_.]?\[?\d+\]?|^column\[\d+\])$")
# Share of the usual step by which those of times differ at most, of a channel that is called something else.
_EVEN = 0.02
# Share of its deviation by which a channel that was taken again differs at most.
_AGAIN = 0.02


def surveyed_table(path: Path, kind: Format, notes: list[str]) -> TopicSurvey:
    names, stated = kind.names(path), kind.units(path)
    if not names:
        raise LogFileError(
            f"{path}: nothing in it is an array of numbers.",
            where=path,
            limit=kind.name,
            advice="Save the samples as arrays, one row for each time: times, positions and torques.",
        )
    channels: list[ChannelSurvey] = []
    count, rate_of = 0, dict[str, float]()
    looked_at = _most_telling(names)
    beside = kind.beside(path)
    texts = texts_beside(beside)
    called = column_names(looked_at, texts)
    if len(looked_at) < len(names):
        notes.append(
            f"{len(looked_at)} of {len(names)} channels are looked at, those whose names say a quantity first; "
            "[channels] may name any"
        )
    for k in range(0, len(looked_at), _TOGETHER):
        request = Request()
        columns = _columns(path, kind, looked_at[k : k + _TOGETHER], request)
        notes.extend(request.notes if k == 0 else (note for note in request.notes if note not in notes))
        for name, column in columns.items():
            count = max(count, column.size)
            found, register = ChannelRange(), register_of(column)
            found.add(
                _sound(register.signed(column.astype(np.float64, copy=False)) if register else column, name, notes)
            )
            title = called.get(name, name)
            channel = replace(found.channel(title, column.size), register=register)
            if is_time(title):
                channel, own = timed(channel, column, stated.get(name, ""))
                rate_of[name] = own
            if channel.quantity == "other":  # `ticks` of an encoder do not grow as those of a clock
                source = "lerobot" if kind is LEROBOT else "rosjoint" if "joint_states" in name else ""
                channel = guessed(channel, title, source, stated.get(name, ""))
            channels.append(replace(channel, name=name, joint=called.get(name, "")))
    channels = [replace(c, quantity="other") if _is_part(c, count) else c for c in with_voltages(channels)]
    rate = next((rate_of[c.name] for c in channels if c.quantity == "time" and rate_of.get(c.name)), 0.0)
    channels, own = _with_stamps_in_parts(channels, path, kind)
    rate = own or rate
    by_rates = 0.0
    if len(channels) * count < _NUMBERS and not {"time", "position"} <= {channel.quantity for channel in channels}:
        content = _content(channels, path, kind)
        channels, own = _with_times(channels, content.time, path, kind)
        rate = rate or own
        if not any(channel.quantity == "position" for channel in channels):
            channels = recognised(channels, content)
        period = 0.0 if rate else _named_period(channels, path, kind) or content.dt
        by_rates = _usual_rate(period)
    channels = _without_repeats(posed(lettered(channels)), path, kind)
    if kind is not LEROBOT and len(channels) * count < _NUMBERS:

        def values(names: list[str]) -> list[RawChannel]:
            return list(_columns(path, kind, names, Request()).values())

        channels = with_states(channels, values, rate)
        by_rates = by_rates or (0.0 if rate else _usual_rate(_named_period(channels, path, kind)))
    channels = _turning(_without_times(channels, path, kind), path, kind)
    if kind is not LEROBOT and sum(c.quantity == "position" for c in channels) * count < _NUMBERS:
        channels = _wrapped(channels, path, kind)
    channels = _of_named_joints(channels, looked_at, path, kind, notes)
    channels = of_listed_joints(channels, texts)
    untitled = [c for c in channels if c.name not in called]
    named = (c.joint or (m["element"] if (m := element_of(c.name)) else "") for c in untitled)
    joints = dict.fromkeys(element for element in named if element and not element.isdecimal())
    if kind is LEROBOT:
        from haptid.log.formats import lerobot  # needs pyarrow

        rate = lerobot.describe(path).fps
    else:
        rate = _rate_of_positions(channels, count, rate, rate_of, path, kind, notes)
    stated_hz, stated_by = stated_rate(beside)
    return TopicSurvey(
        "",
        kind.name,
        count,
        rate,
        tuple(joints),
        {},
        tuple(channels),
        by_rates_hz=by_rates,
        stated_hz=stated_hz,
        stated_by=stated_by,
    )


def _sound(column: RawChannel, name: str, notes: list[str]) -> RawChannel:
    """A column with another value in place of those far beyond all others, which tell no unit; they are noted."""
    odd = far_off(column.astype(np.float64)) if column.dtype.kind == "f" else np.zeros(column.shape, dtype=bool)
    if not odd.any():
        return column
    places = channel_list([str(k + 1) for k in np.flatnonzero(odd)])
    notes.append(
        f"{name}: values up to {np.abs(column[odd]).max():.3g} in rows {places}, far beyond all others: damaged?"
    )
    return np.where(odd, column[~odd][0], column)


def _rate_of_positions(
    channels: Sequence[ChannelSurvey],
    rows: int,
    rate: float,
    rates: Mapping[str, float],
    path: Path,
    kind: Format,
    notes: list[str],
) -> float:
    """Rate of the rows that have positions, where others are those of other sources, Hz; else that of all rows.

    Args:
        channels, path, kind: of the file.
        rows: of the file.
        rate: of the rows, as far as known, Hz.
        rates: of each channel of times: those in the group of the positions come before the others.
        notes: appended to.
    """
    positions = [c for c in channels if c.quantity == "position" and c.usable]
    first = max(positions, key=lambda c: c.count, default=None)
    times = [c for c in channels if c.quantity == "time"]
    time = max(
        times, key=lambda c: first is not None and c.count + c.missing == first.count + first.missing, default=None
    )
    if time is None or not any(c.usable and c.missing >= SPARSE * rows for c in channels):
        beside = [c.name for c in times if first is not None and group_of(c.name) == group_of(first.name)]
        return next((rates[name] for name in beside if rates.get(name)), rate)
    if first is None:
        notes.append("the rows are those of several sources, and none of them is known to have positions: no rate")
        return 0.0
    columns = _columns(path, kind, [time.name, first.name], Request())
    there = ~np.isnan(columns[first.name].astype(np.float64))
    usual, uneven = usual_step(np.diff(columns[time.name][there]))
    own = 1.0 / (usual * scale(time.unit, "time")[1]) if usual else 0.0
    said = f"{own:.6g} Hz is the rate of" if own else "no rate is stated:"
    notes.append(
        f"the rows are those of several sources: {said} the {first.count} rows with {first.name}"
        + f"; {uneven}" * bool(uneven)
    )
    return own


def _named_period(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> float:
    """Sampling period by the velocities of as many positions, all known by names, s; else 0.

    The first pair with the most rows: others may be of every hundredth row.
    """
    found: dict[str, dict[str, list[str]]] = {"position": {}, "velocity": {}}
    rows = {channel.name: channel.rows for channel in channels}
    for channel in channels:
        if channel.quantity in found:
            match = element_of(channel.name)
            array = match["array"] if match else re.sub(r"\d+", "#", channel.name)
            found[channel.quantity].setdefault(array, []).append(channel.name)
    pairs = product(found["position"].values(), found["velocity"].values())
    for positions, rates in sorted(pairs, key=lambda pair: rows[pair[0][0]], reverse=True):
        if len(positions) == len(rates) <= _TOGETHER:
            columns = _columns(path, kind, [*positions, *rates], Request())
            sizes = {column.size for column in columns.values()}
            if len(columns) == 2 * len(rates) and len(sizes) == 1:
                period = period_of([columns[name] for name in positions], [columns[name] for name in rates])
                if period > 0:
                    return period
    return 0.0


def _with_stamps_in_parts(channels: list[ChannelSurvey], path: Path, kind: Format) -> tuple[list[ChannelSurvey], float]:
    """Channels with the times that whole seconds and the fraction beside them make, and their rate; else 0.

    HDF5 has them in the order of the alphabet: nanoseconds stand before seconds.
    """
    pairs = ((k, pair) for k, (one, other) in enumerate(pairwise(channels)) for pair in ((one, other), (other, one)))
    for k, (whole, part) in pairs:
        if not (whole.whole and part.whole and whole.usable and part.low >= 0 and part.high >= _FRACTION):
            continue
        columns = _columns(path, kind, [whole.name, part.name], Request())
        unit = fraction_unit(*columns.values()) if len(columns) == 2 else ""
        if unit:
            name = sum_of(whole.name, part.name, unit)
            times = _columns(path, kind, [name], Request())[name]
            made, rate = timed(_channel(name, times), times, "ns")
            made = replace(made, reason=made.reason.replace(f"{STATED[0]} ns", "whole seconds and their fraction"))
            others = [
                replace(c, quantity="other", unit="", reason="") if c in (whole, part) or c.quantity == "time" else c
                for c in channels
            ]
            return [*others[:k], made, *others[k:]], rate
    return channels, 0.0


def _without_times(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Channels of which none is the times once more, as where every array has them beside its samples."""
    times = [channel for channel in channels if channel.quantity == "time"]
    spans = {(channel.low, channel.high, channel.count): channel.name for channel in times}
    made = []
    for channel in channels:
        time = spans.get((channel.low, channel.high, channel.count))
        if time not in (None, channel.name) and channel not in times:
            own, same = _columns(path, kind, [channel.name, time], Request()).values()
            if np.array_equal(own, same):
                channel = replace(channel, quantity="other", unit="", reason=f"the same as {time}")
        made.append(channel)
    return made


def _is_part(channel: ChannelSurvey, rows: int) -> bool:
    """Whether it is called a time and is too short for that: `T12` of a transformation."""
    return channel.quantity == "time" and channel.rows <= A_PART * rows


def _channel(name: str, values: RawChannel) -> ChannelSurvey:
    found = ChannelRange()
    found.add(values)
    return found.channel(name, values.size)


def _with_times(
    channels: Sequence[ChannelSurvey], name: str, path: Path, kind: Format
) -> tuple[list[ChannelSurvey], float]:
    """Channels with that of times, known by its even growth where no name says it, and its rate; else 0."""
    if not name or any(channel.quantity == "time" for channel in channels):
        return list(channels), 0.0
    k = next(k for k, channel in enumerate(channels) if channel.name == name)
    column = _columns(path, kind, [name], Request())[name]
    steps = np.diff(column.astype(np.float64))
    if channels[k].quantity != "other" and np.ptp(steps) > _EVEN * abs(np.median(steps)):
        return list(channels), 0.0  # a position that turns on, and is called one
    channel, rate = timed(channels[k], column, "")
    return [*channels[:k], channel, *channels[k + 1 :]], rate


def _content(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> Content:
    """What the columns contain; times alone where names deny it.

    A rate that is called a torque looks so where damping is most, and a position that is called a velocity has its
    acceleration beside it.
    """
    clocks = set(with_parts([channel.name for channel in channels if channel.quantity == "time"]))
    content = Content.of(_columns(path, kind, [channel.name for channel in channels], Request()), clocks)
    called = {channel.name: channel.quantity for channel in channels}
    denied = {called[name] for name in content.rates} & {"torque"}
    denied |= {called[name] for name in content.positions} & {"torque", "velocity"}
    return Content(content.time) if denied else content


def _without_repeats(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Channels `q[joint][sample]` that were taken again at each pose are of no quantity, but the first.

    So does the gravity compensation of the dVRK, and so are runs that were repeated. Torques are as the positions of
    their shape.
    """
    nested: dict[tuple[Quantity, str], dict[str, list[ChannelSurvey]]] = {}
    for channel in channels:
        if match := NESTED.fullmatch(channel.name):
            own = nested.setdefault((channel.quantity, match["array"]), {})
            own.setdefault(match["outer"], []).append(channel)
    groups = {key: list(found.values()) for key, found in nested.items() if len({len(x) for x in found.values()}) == 1}
    shapes = {
        (len(found), len(found[0]))
        for (quantity, _), found in groups.items()
        if quantity == "position" and len(found) > 1 and len(found[0]) > 2 and _are_repeats(found, path, kind)
    }
    again = {
        channel.name: own[0].name
        for found in groups.values()
        if (len(found), len(found[0])) in shapes
        for own in found
        for channel in own[1:]
    }
    return [
        replace(c, quantity="other", unit="", reason=f"taken again, as {again[c.name]}") if c.name in again else c
        for c in channels
    ]


def _are_repeats(groups: Sequence[Sequence[ChannelSurvey]], path: Path, kind: Format) -> bool:
    """Whether the samples of the channels of that array which moves farthest are the same."""
    farthest = max(groups, key=lambda own: own[0].high - own[0].low if own[0].usable else 0.0)
    names = [channel.name for channel in farthest[:_TOGETHER] if channel.count]
    if not farthest[0].usable or len(names) < 2:
        return False
    columns = np.stack([column.astype(np.float64) for column in _columns(path, kind, names, Request()).values()])
    known = columns[:, np.isfinite(columns).all(axis=0)]
    apart = np.linalg.norm(known[1:] - known[:1], axis=1)
    return bool((apart < _AGAIN * np.linalg.norm(known[0] - known[0].mean())).all()) if known.size else False


def _turning(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Positions that may be several turns or some degrees in the unit that their torques tell."""
    torques = [c.name for c in channels if c.quantity == "torque" and c.usable][:_TOGETHER]
    doubtful = [c for c in channels if MAY_TURN in c.reason or TURNS in c.reason]
    if not doubtful or kind is LEROBOT:
        return list(channels)
    loads = list(_columns(path, kind, torques, Request()).values()) if torques else []
    made = []
    for channel in channels:
        meant = ""
        if channel in doubtful:
            position = _columns(path, kind, [channel.name], Request())[channel.name]
            meant = turning_unit(position, loads, several=TURNS in channel.reason)
        if meant:
            largest = max(abs(channel.low), abs(channel.high))
            moves = "turns several times" if meant == "rad" else "moves by degrees"
            reason = f"it reaches {largest:.4g}, and its torque or its swing is that of a joint that {moves}"
            channel = replace(channel, unit=meant, reason=reason)
        made.append(channel)
    return made


def _wrapped(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Channels of positions with the period by which they jump."""
    made = {channel.name: channel for channel in channels}
    wanted = [channel.name for channel in channels if channel.quantity == "position" and channel.usable]
    for k in range(0, len(wanted), _TOGETHER):
        for name, column in _columns(path, kind, wanted[k : k + _TOGETHER], Request()).items():
            values = column.astype(np.float64)
            values = values[np.isfinite(values)]
            if values.size > 1:
                largest = float(np.abs(np.diff(values)).max())
                found = wrap_period(values, Signal((name,), made[name].unit or "rad"), largest)
                made[name] = replace(made[name], period=found[0]) if found else made[name]
    return list(made.values())


def _most_telling(names: Sequence[str]) -> list[str]:
    """As many names as are looked at, in the order of the table; those first that say a time or a quantity."""
    if len(names) <= LOOKED_AT:
        return list(names)
    kept = sorted(names, key=lambda name: not is_time(name) and quantity_of(base_of(name)) == "other")[:LOOKED_AT]
    return [name for name in names if name in set(kept)]


def _of_named_joints(
    channels: Sequence[ChannelSurvey], names: Sequence[str], path: Path, kind: Format, notes: list[str]
) -> list[ChannelSurvey]:
    """Channels with the joints that columns of texts beside them name, as `rostopic echo -p` writes a JointState.

    As many columns as a quantity has channels, `name0` and on, each with one text in all rows; without a header the
    last ones before the numbers.
    """
    numeric = {channel.name for channel in channels}
    columns = [name for name in names if name not in numeric and _NAMING.search(name)]
    texts = kind.texts(path, columns) if len(columns) > 1 else {}
    if changing := [name for name in columns if len(texts.get(name, ())) > 1]:
        if not element_of(changing[0]):
            notes.append(
                f"{changing[0]} is not one name in all rows ({', '.join(texts[changing[0]])}): the numbers beside it "
                "are of no one joint; record a ROS bag or MCAP, where each joint is found by its name"
            )
        return list(channels)
    joints = [own[0] for own in texts.values() if own]
    groups: dict[tuple[Quantity, str], list[int]] = {}
    for k, channel in enumerate(channels):
        array = m["array"] if (m := element_of(channel.name)) else re.sub(r"\d+", "#", channel.name)
        groups.setdefault((channel.quantity, array), []).append(k)
    made = list(channels)
    for (quantity, array), own in groups.items():
        fits = len(own) == len(joints) or (array == "column" and len(own) < len(joints))
        if quantity in ("position", "velocity", "torque") and fits and len(set(joints[-len(own) :])) == len(own) > 1:
            for k, joint in zip(own, joints[-len(own) :], strict=True):
                made[k] = replace(made[k], joint=joint)
    return made


def _usual_rate(period: float) -> float:
    """The usual sampling rate that a period is meant for, Hz, or this one to three digits; 0 where there is none."""
    rate = 1.0 / period if period > 0 else 0.0
    if not _SLOWEST <= rate <= _FASTEST:
        return 0.0
    scale = 10.0 ** math.floor(math.log10(rate))
    nearest = min((x * k * scale for x in _RATES for k in (1.0, 10.0)), key=lambda x: abs(x - rate))
    return nearest if abs(nearest - rate) < _ROUNDED * rate else float(f"{rate:.3g}")


def _columns(path: Path, kind: Format, names: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """Columns of numbers; those that are none are noted."""
    try:
        return kind.columns(path, names, request)
    except LogFileError as error:
        if not isinstance(error.where, tuple) or len(names) == 1:
            raise
    found: dict[str, RawChannel] = {}
    for name in names:
        try:
            found |= kind.columns(path, [name])
        except LogFileError as error:
            request.notes.append(f"{name} is not a channel: {str(error).partition(': ')[2].partition('. ')[0]}")
    if not found:
        raise LogFileError(
            f"{path}: none of its columns is one of numbers ({request.notes[-1]}).",
            where=path,
            limit=kind.name,
            advice="Export a table: one line of names, then rows of numbers, one for each time.",
        )
    return found
