"""The `[channels]` table of a study that a log suggests: families of channels, one for each quantity."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from haptid._internal.toml_text import basic_string
from haptid.log.file_format import LEROBOT, MESSAGES, Format
from haptid.log.formats.sniff import channel_list
from haptid.log.held_joints import held_joints
from haptid.log.registers import Register
from haptid.log.survey.channels import STATED, ChannelSurvey, TopicSurvey
from haptid.log.survey.families import MEASURED_WORDS, SI, WANTED_WORDS, ChannelFamily, channel_families
from haptid.log.survey.guesses import NO_RATE, NOT_TOLD, unit_of
from haptid.log.survey.joint_names import are_named, owners
from haptid.log.survey.names import (
    COMMAND_WORDS,
    NEITHER,
    drive_unit,
    element_of,
    is_acceleration,
    may_be_rate,
    unit_apart,
    words_of,
)
from haptid.log.survey.recognised import RATE_OF_RATE
from haptid.log.units import PERIODS, TABLES

# Counts of a turn of most hobby servos; their angle is zero in the middle.
_TWELVE_BITS = 4096
# Unit of a velocity by that of its position.
_RATE_UNITS = {"rad": "rad/s", "deg": "deg/s", "turn": "turn/s", "m": "m/s", "mm": "mm/s"}
# Units of lengths, and of forces.
_STRAIGHT = ({"m", "mm", "um"}, {unit for unit, (si, _) in TABLES["torque"].items() if si == "N"})
# Units of torques and forces, which may be those at the joints.
_MECHANICAL = frozenset(unit for unit, (si, _) in TABLES["torque"].items() if si in ("N m", "N"))
# The letter of a coordinate, at the end of a name or alone.
_OF_X = re.compile(r"[xX]$|(?<![^\W_])[xX](?=[_. ])")
# Positions beyond this, m, of a prismatic joint are in mm.
_METRES = 5.0
# What a log of positions alone is good for, such as one of a servo arm that was guided by hand.
WITHOUT_TORQUE = (
    "positions alone, or with goals (actions), tell nothing of mass and friction: record beside them each servo's "
    "load, current or PWM (Present_Load, Present_Current, Present_PWM) or ROS effort, while the motors drive the joints"
)
_NO_TORQUE = "# torque = ...  # no channel of torques, currents or commands was found"
# Fewest joints whose names are compared.
_FEWEST = 2
# Joints that are named in a comment; points, and channels of no known quantity.
_NAMED, _POINTS, _LISTED = 8, 3, 24
# Turns beyond which a position that is called a motor's is one before its gear.
_MOTOR_TURNS = 2.0
# Torques on fewer rows than this share of the positions' are commands that are held until the next.
_FEW = 0.2
# Share by which the rate that velocities tell differs at most from the one that is stated.
_SAME_RATE = 0.05


def _fit(position: ChannelFamily, torque: ChannelFamily) -> tuple[object, ...]:
    """Order of pairs: both usable, equally many, joints before motors, of one group or topic, then their own ranks."""
    same = position.topic is torque.topic and position.prefix == torque.prefix
    equal = len(position.channels) == len(torque.channels)
    own = position.rank[1], not position.of_motors, torque.rank[1]
    return position.rank[0], torque.rank[0], equal, *own, same, position.rank, torque.rank


def channels_table(
    topics: Sequence[TopicSurvey],
    kind: Format,
    joints: Sequence[tuple[str, ...]],
    motors: Sequence[tuple[str, ...]],
    straight: Sequence[bool],
) -> str:
    """A `[channels]` table of the most likely signals; empty where there are no positions or torques."""
    positions = [family.of(joints) for family in channel_families(topics, "position", joints)]
    torques = [family.of(motors) for family in channel_families(topics, "torque", [*joints, *motors])]
    if joints and any(len(family.channels) == len(joints) for family in positions):
        positions = [family for family in positions if len(family.channels) == len(joints)]
    if not positions:
        return ""
    if joint_like := [family for family in positions if not family.of_a_point]:
        positions, torques = joint_like, [family for family in torques if not family.of_a_point]
    elif not any(family.known or family.of_axes for family in positions) and not (
        joints and (all(straight) or {joint[-1].lower() for joint in joints} == {*"xyz"})
    ):
        torques = [family for family in torques if family.of_axes_motors]  # a force beside them is that of a point
        if not torques:
            return ""
    most = max((len(family.channels) for family in positions if family.rank[:2] == (True, True)), default=0)
    positions = [family for family in positions if family.rank[1] or len(family.channels) > most]  # no plan of these
    rates = [family.of(joints) for family in channel_families(topics, "velocity", joints)]
    pairs = [(p, t if t.known else t.ordered(p)) for p in positions for t in torques]
    position, torque = max(pairs, key=lambda pair: _fit(*pair), default=(positions[0], None))
    if joints and len(position.channels) > len(joints) == len(moved := _moved(position)):
        count = len(position.channels)
        rates, position = [rate.ordered(position).only(moved, count) for rate in rates], position.only(moved, count)
        torque = torque and torque.only(moved, count)
    lines = ["[channels]  # units and choices are guesses: check each of them"]
    lines.append(_time_line(position, torque, kind))
    lengths = [channel.unit in _STRAIGHT[0] for channel in position.channels]
    straight = straight if len(straight) == len(lengths) or not any(lengths) else lengths
    if len(straight) == len(position.channels):
        position = replace(position, channels=tuple(map(_of_joint, position.channels, straight)))
        if torque is not None and len(torque.channels) == len(straight):
            torque = replace(torque, channels=tuple(map(_of_joint, torque.channels, straight)))
    before_gears = _before_gears(position)
    lines.append(_signal_line("position", position, before_gears) + _unlike(position, joints))
    lines += [] if joints else _other_positions(positions, position)
    if torque is None:
        lines += _left(topics, position) or [f"{_NO_TORQUE}; {WITHOUT_TORQUE}"]
    else:
        of_motors = _signal_line("torque", torque, before_gears and torque.of_motors)
        lines.append(of_motors + _other_order(position, torque) + _too_many(torque, motors))
        lines += _instead(torques, torque)
        lines += _merge_line(position, torque, kind)
    lines += _velocity_line(rates, position)
    return "\n".join(lines) + "\n"


def unrecognised(topics: Sequence[TopicSurvey]) -> str:
    """A `[channels]` table in comments, where no channel is known as a position: what to name, and from which."""
    lines = ["[channels]  # no channels of positions were recognised: name them here"]
    for topic in topics:
        left = [c.name for c in topic.channels if c.usable and c.quantity == "other"]
        named = {c.name for c in topic.channels if c.usable and c.quantity in ("other", "position")}
        rates = [c.name for c in topic.channels if c.usable and c.quantity == "velocity"]
        if points := _points(named):
            names = " and ".join(map(", ".join, points[:_POINTS]))
            lines.append(
                f"# {names}: of a point in space, which does not tell how the joints stand; record each joint's own "
                "position, and its motor's torque, current or command; of a machine with slides, give its "
                "device file"
            )
        of_points = {name for three in _points(rates) for name in three} if points else set()
        if rates := [name for name in rates if name not in of_points]:
            lines.append(
                f"# {channel_list(rates)}: velocities, which are not integrated; save the positions that they are of, "
                "or their running sum times the sampling period as a channel of positions"
            )
        if left:
            prefix = f"{topic.name}." if topic.name else ""
            shown = ", ".join(basic_string(prefix + name) for name in left[:_LISTED])
            more = f", and {len(left) - _LISTED} more" if len(left) > _LISTED else ""
            lines.append(f"# of no known quantity: {shown}{more}")
    times = [c for topic in topics for c in topic.channels if c.quantity == "time"]
    lines += [f"time = {basic_string(times[0].name)}\ntime_unit = {basic_string(times[0].unit)}"] if times else []
    lines += ['# position = { channels = ["..."], unit = "rad" }  # of each joint, in the order of the device']
    if not any(c.quantity == "torque" for topic in topics for c in topic.channels):
        lines += ['# torque = { channels = ["..."], unit = "N m" }  # of each motor']
    return "\n".join(lines) + "\n"


def _points(names: Iterable[str]) -> list[list[str]]:
    """Channels that are called x, y and z of a point, three of each: `pos_x`, `PosX [m]` or `x_pos`."""
    own = {unit_apart(name)[0]: name for name in names}
    found = []
    for name in sorted(own):
        for match in _OF_X.finditer(name):
            ends = "xyz" if match[0] == "x" else "XYZ"
            three = [name[: match.start()] + end + name[match.end() :] for end in ends]
            if own.keys() >= {*three}:
                found.append([own[one] for one in three])
    return found


def _other_positions(families: Sequence[ChannelFamily], chosen: ChannelFamily) -> list[str]:
    """Positions that are no part of the choice, and of the same kind, as a comment: other joints, or other trials."""
    taken = {channel.name for channel in chosen.channels}
    kind = chosen.rank[0], chosen.rank[1], chosen.rank[3], chosen.of_motors
    left = {}
    for family in families:
        own = [channel.name for channel in family.channels]
        same = (family.rank[0], family.rank[1], family.rank[3], family.of_motors) == kind
        if same and family.topic is chosen.topic and family.rank[-1] and taken.isdisjoint(own):
            left[channel_list(own)] = own
            taken |= set(own)
    names = " and ".join(list(left)[:_POINTS])
    return [f"# also positions: {names}; of other joints, other trials, or of the same in another way?"] if left else []


def _other_order(position: ChannelFamily, torque: ChannelFamily) -> str:
    """What to check where torques are called by other joints than the positions."""
    pairs = list(zip(position.heads, torque.heads, strict=False))
    both = [set(own) for own in zip(*pairs, strict=True)] if len(position.channels) == len(torque.channels) else []
    odd = [pair for pair in pairs if pair[0] != pair[1]]
    if not both or len(pairs) < _FEWEST or not both[0] & both[1] or not odd:
        return ""
    if all(name.isdecimal() for pair in pairs for name in pair) and len({int(b) - int(a) for a, b in pairs}) == 1:
        return ""  # one is counted from 0
    ones, others = (", ".join(names) for names in zip(*odd[:_NAMED], strict=True))
    return f"; their joints are called {others} where those of the positions are {ones}: check the order"


def _too_many(torque: ChannelFamily, motors: Sequence[tuple[str, ...]]) -> str:
    """What to check where more torques are left than the device has motors."""
    if not motors or len(torque.channels) <= len(motors):
        return ""
    names = ", ".join(motor[-1] for motor in motors[:_NAMED])
    count = "1 motor" if len(motors) == 1 else f"{len(motors)} motors"
    return f"; the device has {count}, and these are {len(torque.channels)}: keep those of {names}"


def _unlike(position: ChannelFamily, joints: Sequence[tuple[str, ...]]) -> str:
    """What to check where positions are not as many as the device's joints, or have names that are none of them."""
    count = len(position.channels)
    names = ", ".join(joint[-1] for joint in joints[:_NAMED]) + (", ..." if len(joints) > _NAMED else "")
    if joints and count < len(joints):
        moved = owners(position.called, joints)
        only = f"--only {','.join(joints[k][-1] for k in moved)}" if moved else "--hold JOINT=0"
        return (
            f"; the device has {len(joints)} joints ({names}), and these are {count}: a joint that the log lacks and "
            f"that stands still is held in the device file (haptid import {only})"
        )
    if joints and count > len(joints):
        return f"; the device has {len(joints)} joints, and these are {count}: keep those of {names}"
    if position.left:
        channel, joint = position.left
        return f"; no name tells {channel}: taken for the joint that is left, {joint}; is it another one, or a gripper?"
    if joints and not position.known and are_named(position.called):
        return f"; none is named as a joint of the device: put them, and the torques, in the order of {names}"
    held = sorted(set(range(count)) - set(_moved(position)))
    if held and held != list(range(count)) and any(position.channels[k].usable for k in held):
        return (
            f"; {channel_list([position.channels[k].name for k in held])} hardly move: identify a device file with "
            f"their joints held (haptid import --hold JOINT=POSITION), or add logs that move them"
        )
    return ""


def _moved(position: ChannelFamily) -> list[int]:
    """Channels, by number, of joints that are not held while others move; all where the unit is none of a position."""
    scales = [SI.get(channel.unit, 0.0) for channel in position.channels]
    if not all(scales):
        return list(range(len(scales)))
    travels = [scale * (channel.high - channel.low) for scale, channel in zip(scales, position.channels, strict=True)]
    held = held_joints(travels, [channel.unit in ("m", "mm") for channel in position.channels])
    return [k for k in range(len(scales)) if k not in held]


def _left(topics: Sequence[TopicSurvey], position: ChannelFamily) -> list[str]:
    """Channels of no known name, as many as the positions and beside them: a question, and lines to uncomment."""
    left = [
        family
        for family in channel_families(topics, "other")
        if len(family.channels) == len(position.channels)
        and family.topic is position.topic
        and family.rank[:2] == (True, True)
        and not words_of(family.array) & NEITHER
        and not any(channel.reason == RATE_OF_RATE or is_acceleration(channel.name) for channel in family.channels)
    ][:3]
    names = " or ".join(channel_list([channel.name for channel in family.channels]) for family in left)
    asked = f"{_NO_TORQUE} by its name; is it {names}?"
    return [asked, *(f"# torque = {{ {_where(family)}, {_asked_unit(family)} }}" for family in left)] if left else []


def _asked_unit(family: ChannelFamily) -> str:
    """The unit that the names of channels tell that may be torques."""
    unit = {"current": "A", "voltage": "V"}.get(drive_unit(words_of(family.array)), "")
    return f'unit = "{unit}", side = "motor"' if unit else 'unit = "N m"'


def _velocity_line(rates: Sequence[ChannelFamily], position: ChannelFamily) -> list[str]:
    """The velocities of the positions, one for each and in the same rows."""
    units = [_RATE_UNITS.get(unit, "") for unit in _written_units(position.channels)]
    samples = min(channel.count for channel in position.channels)
    for family in (rate.ordered(position) for rate in rates):
        own = [channel.unit or unit for channel, unit in zip(family.channels, units, strict=False)]
        fits = family.topic is position.topic and len(family.channels) == len(units) and all(own)
        wanted = bool(words_of(family.array) & WANTED_WORDS) != bool(words_of(position.array) & WANTED_WORDS)
        same = all(map(may_be_rate, family.called, position.called))
        if fits and same and not wanted and family.rank[0] and min(c.count for c in family.channels) == samples:
            stated = basic_string(own[0]) if len(set(own)) == 1 else f"[{', '.join(map(basic_string, own))}]"
            return [f"velocity = {{ {_where(family)}, unit = {stated} }}  # used where less noisy than differences"]
    return []


def _of_joint(channel: ChannelSurvey, straight: bool) -> ChannelSurvey:
    """A channel of a prismatic joint whose unit was guessed as an angle's or a moment's, and the other way round."""
    if straight and channel.unit in ("rad", "deg"):
        largest = max(abs(channel.low), abs(channel.high))
        unit = "mm" if largest > _METRES else "m"
        return replace(channel, unit=unit, reason=f"its joint is prismatic, and it reaches {largest:.3g}")
    if straight and channel.unit == "N m":
        return replace(channel, unit="N", reason=f"its joint is prismatic; {channel.reason}")
    if not straight and channel.unit in ("m", "mm") and not channel.reason.startswith(STATED):
        unit, reason = unit_of("position", frozenset(), max(abs(channel.low), abs(channel.high)), channel, "")
        return replace(channel, unit=unit, reason=f"its joint is revolute; {reason}")
    return channel


def _merge_line(position: ChannelFamily, torque: ChannelFamily, kind: Format) -> list[str]:
    """How torques come to the rows of the positions, where they have rows of their own."""
    if torque.topic is not position.topic:
        return ['merge = { onto = "position", method = "linear" }  # two topics, merged by time']
    samples, own = (min(c.count for c in family.channels) for family in (position, torque))
    if kind in (MESSAGES, LEROBOT) or own == 0 or max(samples, own) == position.topic.count:
        return []
    words = words_of(torque.array)
    if own < _FEW * samples and position.topic.rate_hz:
        seconds = math.ceil(samples / position.topic.rate_hz)
        return [f'merge = {{ method = "hold", largest_gap = {seconds} }}  # guess: {own} commands, each held']
    method = "hold" if words & (COMMAND_WORDS | WANTED_WORDS | {"control"}) else "linear"
    return [f'merge = {{ method = "{method}" }}  # rows of several sources, merged by time']


def _instead(others: Sequence[ChannelFamily], chosen: ChannelFamily) -> list[str]:
    """Other channels that may be meant, as comments."""
    taken = {(chosen.topic.name, channel.name) for channel in chosen.channels}
    rest = [
        f
        for f in others
        if len(f.channels) == len(taken) and f.rank[0] and {(f.topic.name, c.name) for c in f.channels} != taken
    ]
    of_a_model = not drive_unit(words_of(chosen.array)) and not words_of(chosen.array) & MEASURED_WORDS
    lines = []
    for family in rest[:3]:
        current = of_a_model and drive_unit(words_of(family.array)) == "current"
        asked = (
            "; take these where the torques are computed by a controller's model, and not measured" if current else ""
        )
        head = f"{family.topic.name}." if family.topic.name and family.topic is not chosen.topic else ""
        lines.append(f"# also there: {', '.join(head + c.name for c in family.channels)}{asked}")
    return lines


def _time_line(position: ChannelFamily, torque: ChannelFamily | None, kind: Format) -> str:
    times = [channel for channel in position.topic.channels if channel.quantity == "time"]
    if kind is MESSAGES and times:
        name = basic_string(f"{position.topic.name}.{times[0].name}")
        return f"time = {name}\ntime_unit = {basic_string(times[0].unit)}  # samples of one message, with one stamp"
    if kind is MESSAGES and position.topic.count > 1 and not position.topic.rate_hz:
        return "# rate_hz = ...  # all samples have one stamp: write the rate at which the log was sampled"
    if kind is MESSAGES:
        headers = all(f.topic.header for f in (position, torque) if f is not None)
        stamp = "header" if headers else "receive"
        why = "" if headers else "  # not every topic has stamps in its messages"
        return f"time = {{ topic = {basic_string(position.topic.name)}, stamp = {basic_string(stamp)} }}{why}"
    if kind is LEROBOT:
        return f'time = "time"  # frames at {position.topic.rate_hz:g} Hz, a pause between episodes'
    if not times:
        stated, by, own = position.topic.stated_hz, position.topic.stated_by, position.topic.by_rates_hz
        if stated and (not own or abs(own / stated - 1.0) < _SAME_RATE):
            return f"rate_hz = {stated:.9g}  # guess: the file states {by}"
        if own:
            but = f"; the file states {by}, which is another one" if stated else ""
            return (
                f"rate_hz = {own:g}  # guess: no channel of times was found; at this rate velocities fit the positions"
                f"{but}"
            )
        return "# rate_hz = ...  # no channel of times was found: write the rate at which the log was sampled"
    rows = position.channels[0].rows
    # The sender's stamp is that of the samples; the recorder's, beside it in `rostopic echo -p`, comes when it does. Of
    # topics that were joined in one table, each has stamps in its own rows only.
    time = max(
        times,
        key=lambda t: (
            t.rows == rows,
            not t.missing,
            not t.reason.endswith(NO_RATE),
            t.name.rpartition(".")[0] == position.prefix,
            {"header", "stamp"} <= words_of(t.name),
        ),
    )
    return f"time = {basic_string(time.name)}\ntime_unit = {basic_string(time.unit)}  # guess: {time.reason}"


def _where(family: ChannelFamily) -> str:
    """The keys that name the channels of a family."""
    elements = [m["element"] for c in family.channels if (m := element_of(c.name)) and m["array"] == family.array]
    if len(elements) == len(family.channels) and not family.array.endswith("#") and "#" not in family.array:
        topic = f"topic = {basic_string(family.topic.name)}, " if family.topic.name else ""
        joints = ", ".join(e if e.isdecimal() else basic_string(e) for e in elements)
        where = f"{topic}field = {basic_string(family.array)}, joints = [{joints}]"
    else:
        prefix = f"{family.topic.name}." if family.topic.name else ""
        where = "channels = [" + ", ".join(basic_string(prefix + channel.name) for channel in family.channels) + "]"
    return where


def _before_gears(position: ChannelFamily) -> bool:
    """Whether positions are called those of motors, and some of them turn further than joints do."""
    units = [SI["deg"] if c.reason.endswith(NOT_TOLD) else SI.get(c.unit, 0.0) for c in position.channels]
    ends = [si * max(abs(c.low), abs(c.high)) for si, c in zip(units, position.channels, strict=True) if c.usable]
    return position.of_motors and max(ends, default=0.0) > _MOTOR_TURNS * 2 * math.pi


def _signal_line(key: str, family: ChannelFamily, before_gears: bool = False) -> str:
    family = replace(family, channels=_of_stated_units(family.channels))
    units = _written_units(family.channels)
    reasons = dict.fromkeys(channel.reason for channel in family.channels)
    where = _where(family)
    unit, reason = units[0], next(iter(reasons))
    mixed = len(set(units)) > 1
    if any(_is_stated(channel) for channel in family.channels):
        reason = "; ".join(reasons)
    elif not mixed and len({channel.unit for channel in family.channels}) > 1:
        largest = _largest(family.channels)
        others = [c for c in family.channels if c.usable and c.unit != largest.unit and largest.unit in SI]
        reach = max((abs(end) for c in others for end in (c.low, c.high)), default=0.0)
        as_well = f"; the others fit too, with {reach:.3g} {largest.unit} at most" if others else ""
        other = " or ".join(sorted({c.unit for c in others}))
        listed = f": if they are in {other}, write a list of units" if key == "position" and others else ""
        reason = f"{largest.reason} ({largest.name}{as_well}{listed})"
    still = [channel.name for channel in family.channels if not channel.usable]
    constant = ""
    if still:
        reason += f"; without a change, is it connected?: {', '.join(still[:6])}"
        constant = ", constant_ok = true" if len(still) < len(family.channels) else ""
    written = "[" + ", ".join(map(basic_string, units)) + "]" if mixed else basic_string(unit)
    words = words_of(family.array)
    commanded = key == "torque" and (unit not in _MECHANICAL or (bool(words) and words <= COMMAND_WORDS))
    side = ', side = "motor"' if commanded or before_gears else ""
    if before_gears and key == "position":
        reason += "; called the motors', which turn so far before their gears: the ratios are in the device file"
    if key == "torque" and len(family.channels) - len(still) > 1 and all(c.low >= 0 for c in family.channels):
        reason += "; never negative: is it a magnitude without a sign?"
    register = next((c.register for c in family.channels if c.register), Register())
    if register:
        reason += f"; their sign is written as of {register}"
    counted, more = "", f", {register}" if register else ""
    periods = {channel.period for channel in family.channels if channel.period}
    if periods:
        more += ", unwrap = true" + (f", period = {min(periods):g}" if min(periods) != PERIODS.get(unit) else "")
        reason += f"; it jumps by {min(periods):g} {unit}, as where it is wrapped"
    if key == "position" and unit == "counts" and all(map(_is_of_a_servo, family.channels)):
        counted = f", gain = {2 * math.pi / _TWELVE_BITS:.9f}, offset = {-math.pi:.5f}"
        reason = f"whole numbers below {_TWELVE_BITS}, as of servos of 12 bits a turn with their zero at the middle"
    return f"{key} = {{ {where}, unit = {written}{counted}{more}{side}{constant} }}  # guess: {reason}"


def _is_of_a_servo(channel: ChannelSurvey) -> bool:
    """Whether positions are whole numbers of twelve bits."""
    return channel.whole and channel.low >= 0 and channel.high < _TWELVE_BITS


def _written_units(channels: Sequence[ChannelSurvey]) -> list[str]:
    """Unit of each channel as it is written: guesses of one kind are those of the channel with the largest values.

    A small joint, or a small motor, fits both units; the largest one tells which.
    """
    own = [channel.unit for channel in _of_stated_units(channels)]
    apart = any(map(_is_stated, channels)) or _mixed(own)
    return own if apart else [_largest(channels).unit] * len(own)


def _largest(channels: Sequence[ChannelSurvey]) -> ChannelSurvey:
    return max(channels, key=lambda channel: max(abs(channel.low), abs(channel.high)))


def _is_stated(channel: ChannelSurvey) -> bool:
    return channel.reason.startswith(STATED)


def _of_stated_units(channels: Sequence[ChannelSurvey]) -> tuple[ChannelSurvey, ...]:
    """Channels of which those without a stated unit have the one that is stated of others of their kind."""
    stated = [channel for channel in channels if _is_stated(channel)]
    units = {c: {s.unit for s in stated if not _mixed({s.unit, c.unit})} for c in channels if c not in stated}
    alone = {channel: next(iter(own)) for channel, own in units.items() if len(own) == 1}
    names = channel_list([channel.name for channel in alone])
    return tuple(
        replace(c, unit=alone[c], reason=f"of {names} no unit is stated: it is taken as that of the others")
        if c in alone
        else c
        for c in channels
    )


def _mixed(found: Iterable[str]) -> bool:
    """Whether units are of angles and of lengths, or of moments and of forces."""
    kinds = set(found)
    return any(kinds & one and kinds - one for one in _STRAIGHT)
