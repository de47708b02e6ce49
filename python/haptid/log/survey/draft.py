"""The `[channels]` table of a study that a log suggests: families of channels, one for each quantity."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from haptid._internal.toml_text import basic_string
from haptid.log.file_format import LEROBOT, MESSAGES, Format
from haptid.log.formats.sniff import channel_list
from haptid.log.held_joints import held_joints
from haptid.log.registers import Register
from haptid.log.survey.channels import A_PART, ChannelSurvey, Quantity, TopicSurvey
from haptid.log.survey.guesses import STATED
from haptid.log.survey.joint_names import are_named, matched, owners
from haptid.log.survey.names import (
    COMMAND_WORDS,
    NEITHER,
    QUANTITY_WORDS,
    base_of,
    drive_unit,
    element_of,
    unit_apart,
    words_of,
)
from haptid.log.units import PERIODS, TABLES, known_unit

# Less likely to be measured at the motor: the wanted value, that of a model, or an outside torque.
_WANTED = frozenset({"target", "desired", "des", "reference", "ref", "command", "cmd", "goal", "action",
                     "actions", "setpoint", "set", "soll", "external", "ext", "et", "model", "predicted", "pred",
                     "last", "prev", "residual", "disturbance", "gravity", "friction"})  # fmt: skip
# More likely than a command, where both are there.
_MEASURED = frozenset({"measured", "actual", "act", "present", "feedback", "fb", "fbk", "meas", "msr", "ist"})
# What was done to a signal: another one than that without the word.
_TREATED = frozenset({"raw", "unfiltered", "filtered", "filt", "lpf", "smooth", "smoothed"})
# Counts of a turn of most hobby servos; their angle is zero in the middle.
_TWELVE_BITS = 4096
# Unit of a velocity by that of its position.
_RATE_UNITS = {"rad": "rad/s", "deg": "deg/s", "turn": "turn/s", "m": "m/s", "mm": "mm/s"}
# rad or m of a unit of positions.
_SI = {"rad": 1.0, "deg": math.pi / 180, "turn": 2 * math.pi, "m": 1.0, "mm": 1e-3}
# Units of lengths, and of forces.
_STRAIGHT = ({"m", "mm", "um"}, {unit for unit, (si, _) in TABLES["torque"].items() if si == "N"})
# Units of torques and forces, which may be those at the joints.
_MECHANICAL = frozenset(unit for unit, (si, _) in TABLES["torque"].items() if si in ("N m", "N"))
# Positions beyond this, m, of a prismatic joint are in mm.
_METRES = 5.0
# A motor's torque is preferred to its current, this to its voltage, this to a duty cycle.
_DRIVE = ("duty", "voltage", "current", "")
# Share of their sizes by which ranges of one signal in two units differ at most.
_SAME_RANGE = 1e-3
# What is desired of a measured signal beside it: `q_d` of `q`, `tau_J_d[1]` of `tau_J[1]`.
_DESIRED = re.compile(r"_d(?=(?:_?\d+|\[\w+\])?$)")
# Words of quantities and of where their values come from: never the name of a joint.
_KIND = frozenset(word for _, known in QUANTITY_WORDS for word in known) - {"joint"} | _WANTED | _MEASURED | _TREATED
_SEPARATOR = re.compile(r"([./ _])")
# What a log of positions alone is good for, such as one of a servo arm that was guided by hand.
WITHOUT_TORQUE = (
    "positions alone, or with goals (actions), tell nothing of mass and friction: record beside them each servo's "
    "load, current or PWM (Present_Load, Present_Current, Present_PWM) or ROS effort, while the motors drive the joints"
)
_NO_TORQUE = "# torque = ...  # no channel of torques, currents or commands was found"
# Joints that are named in a comment.
_NAMED = 8
# Torques on fewer rows than this share of the positions' are commands that are held until the next.
_FEW = 0.2


@dataclass(frozen=True)
class _Family:
    """Channels of one quantity that belong together, in order; `known` where they were found by the joints' names."""

    topic: TopicSurvey
    array: str
    channels: tuple[ChannelSurvey, ...]
    known: bool = False

    @property
    def rank(self) -> tuple[bool, bool, bool, bool, int, int, int, bool]:
        """Usable, not wanted, of a known unit, measured, a torque and no current; then many, long ones, and not raw."""
        words = words_of(f"{self.topic.name} {self.array}")
        usable = sum(channel.usable for channel in self.channels)
        return (
            usable > 0,
            not words & _WANTED,
            not all(channel.unit == "counts" for channel in self.channels),
            bool(words & _MEASURED),
            _DRIVE.index(drive_unit(words)),
            usable,
            min(channel.count for channel in self.channels),
            "raw" not in words,
        )

    @property
    def of_a_point(self) -> bool:
        """Whether the channels are x, y and z of a point or a force in space, and of no joint."""
        ends = {re.split(r"[_. ]|(?<=[a-z])(?=[A-Z])", c.name)[-1].lower() for c in self.channels}
        return ends == {"x", "y", "z"}

    @property
    def of_motors(self) -> bool:
        """Whether the channels are named as those of motors before their gears."""
        return bool(words_of(self.array) & {"motor", "rotor"})

    @property
    def prefix(self) -> str:
        """Name before the last point."""
        return self.array.rpartition(".")[0]

    def of(self, joints: Sequence[tuple[str, ...]]) -> _Family:
        """The channels of these joints, in their order; all channels where not every joint is found by a name."""
        if not joints:
            return self
        heads = [_joint_words(c.name, self.channels) for c in self.channels]
        found = [[c for c, head in zip(self.channels, heads, strict=True) if head in names] for names in joints]
        if all(len(x) == 1 for x in found):
            return replace(self, channels=tuple(c for (c,) in found), known=True)
        order = matched([unit_apart(c.name)[0] for c in self.channels], joints)
        return replace(self, channels=tuple(self.channels[k] for k in order), known=True) if order else self

    def ordered(self, other: _Family) -> _Family:
        """The channels in the order of another family that has the same elements."""
        own = {m["element"]: c for c in self.channels if (m := element_of(c.name))}
        wanted = [m["element"] for c in other.channels if (m := element_of(c.name))]
        named = len(own) == len(wanted) or not all(map(str.isdecimal, wanted))  # a number is none of the same joint
        if len(own) == len(self.channels) and set(own) >= set(wanted) and len(wanted) == len(other.channels) and named:
            return replace(self, channels=tuple(own[element] for element in wanted))
        return self

    def only(self, kept: Sequence[int], count: int) -> _Family:
        """Some of the channels, by number, of a family of this many; of another size as it is."""
        return replace(self, channels=tuple(self.channels[k] for k in kept)) if len(self.channels) == count else self


def _fit(position: _Family, torque: _Family) -> tuple[object, ...]:
    """Order of pairs: both usable, equally many, joints before motors, of one group or topic, then their own ranks."""
    same = position.topic is torque.topic and position.prefix == torque.prefix
    equal = len(position.channels) == len(torque.channels)
    own = position.rank[1], not position.of_motors, torque.rank[1]
    return position.rank[0], torque.rank[0], equal, *own, same, position.rank, torque.rank


def _joint_words(name: str, family: Sequence[ChannelSurvey]) -> str:
    """The part of a channel's name that differs between the channels of its family: the joint's name."""
    split = {c.name: _SEPARATOR.split(m["element"] if (m := element_of(c.name)) else base_of(c.name)) for c in family}
    words, others = split[name], list(split.values())
    while len(words) > 2 and all(o[-2:] == words[-2:] for o in others) and _no_joint(words[-1], words[-2]):
        words, others = words[:-2], [o[:-2] for o in others]
    while len(words) > 2 and all(o[:2] == words[:2] for o in others) and _no_joint(words[0], words[1]):
        words, others = words[2:], [o[2:] for o in others]
    return "".join(words)


def _no_joint(part: str, separator: str) -> bool:
    """Whether a part that all names share is none of the joints' names; of words joined by `_` only a known one is."""
    words = words_of(part)
    return separator != "_" or (bool(words) and words <= _KIND)


def _families(
    topics: Iterable[TopicSurvey], quantity: Quantity, joints: Sequence[tuple[str, ...]] = ()
) -> list[_Family]:
    """Families of a quantity, the best first; names that differ in the name of one of the joints are of one family."""
    names = "|".join(re.escape(name) for name in sorted({x for joint in joints for x in joint}, key=len, reverse=True))
    own = re.compile(rf"(?<![^\W_])(?:{names})(?![^\W_])", re.I) if names else None
    found: list[_Family] = []
    for topic in topics:
        arrays: dict[str, list[ChannelSurvey]] = {}
        all_names = {channel.name for channel in topic.channels}
        for channel in topic.channels:
            error = channel.name.startswith("E_") and channel.name[2:] in all_names  # of a controller: `E_q` beside `q`
            if channel.quantity == quantity and channel.rows > A_PART * topic.count and not error:
                element = element_of(channel.name)
                array = element["array"] if element else _pattern(_without(unit_apart(channel.name)[0], own))
                if _DESIRED.search(channel.name) and _DESIRED.sub("", channel.name) in all_names:
                    array += " desired"
                arrays.setdefault(array, []).append(channel)
        groups = _joined(arrays)
        for array, channels in (*groups.items(), *_of_unlike_names(groups)):
            found.append(_Family(topic, array, tuple(c for c in channels if not _is_copy(c, channels))))
    return sorted(found, key=lambda family: family.rank, reverse=True)


def _is_copy(channel: ChannelSurvey, family: Sequence[ChannelSurvey]) -> bool:
    """Whether a channel is another of its family in another unit: `q_deg` beside `q_rad`, which is kept."""
    own = family.index(channel)
    for k, other in enumerate(family):
        if other.unit != channel.unit and channel.usable and _apart_from_units(other) == _apart_from_units(channel):
            a, b = _SI.get(channel.unit, 0.0), _SI.get(other.unit, 0.0)
            ends = (a * channel.low - b * other.low, a * channel.high - b * other.high)
            same = a > 0 and max(map(abs, ends)) < _SAME_RANGE * a * (channel.high - channel.low)
            if same and (b == 1.0, -k) > (a == 1.0, -own):
                return True
    return False


def _apart_from_units(channel: ChannelSurvey) -> tuple[frozenset[str], list[str]]:
    """Words of a name that are no unit, and its numbers."""
    name = unit_apart(channel.name)[0]
    return frozenset(word for word in words_of(name) if not known_unit(word)), re.findall(r"\d+", name)


def _without(name: str, joints: re.Pattern[str] | None) -> str:
    """A channel's name without that of its joint; whole where nothing but a number would be left of it."""
    short = joints.sub("#", name) if joints else name
    return short if words_of(short) else name


def _joined(arrays: dict[str, list[ChannelSurvey]]) -> dict[str, list[ChannelSurvey]]:
    """Families; channels whose names differ in a joint's name only are put together: `hip_pos`, `hip[1]`, `knee[1]`."""
    made: dict[str, list[ChannelSurvey]] = {}
    for array, channels in arrays.items():
        kind = words_of(f"{base_of(channels[0].name)} {array}") & (_KIND | {"motor", "joint"})
        alone = len(channels) == 1 and "/" not in array
        element = element_of(channels[0].name)
        place = f"[{element['element']}]" if element else ""
        rows = f" {channels[0].rows}"  # every tenth sample of a joint is no other joint
        made.setdefault(" ".join([*sorted(kind), place]) + rows if alone else array, []).extend(channels)
    return made


def _of_unlike_names(groups: dict[str, list[ChannelSurvey]]) -> Iterator[tuple[str, list[ChannelSurvey]]]:
    """Groups whose names say one quantity by different words, each of joints of its own: a cart's and a pendulum's.

    `shoulder_pos` and `elbow_angle` are of two joints, `elbow_pos` and `elbow_angle` two signals of one.
    """
    alike: dict[tuple[object, ...], list[list[ChannelSurvey]]] = {}
    for array, channels in groups.items():
        words = [words_of(base_of(c.name)) for c in channels]
        if not any("/" in c.name or element_of(c.name) for c in channels) and all(own - _KIND for own in words):
            other = frozenset.union(*words, words_of(array)) & (
                _WANTED | _MEASURED | _TREATED | {"motor", "joint", "rotor"}
            )
            alike.setdefault((other, drive_unit(words_of(array)), channels[0].rows), []).append(channels)
    for members in alike.values():
        names = [frozenset.union(*(words_of(base_of(c.name)) - _KIND for c in channels)) for channels in members]
        if len(members) > 1 and sum(map(len, names)) == len(frozenset.union(*names)):
            channels = [channel for own in members for channel in own]
            yield " ".join(channel.name for channel in channels), channels


def _pattern(name: str) -> str:
    """A channel's name without what tells it from those of other joints: numbers, or the joint's name in a path."""
    parts = re.split(r"([/.])", name)
    numbered = any(re.search(r"\d", part) for part in parts[-3:])
    side = len(parts) > 2 and words_of(parts[-3]) & (_WANTED | _MEASURED | {"motor", "joint"})
    if len(parts) > 2 and not numbered and not side and _quantity_word(parts[-1]):
        parts[-3] = "#"
    elif len(parts) > 2 and parts[-2] == "." and _quantity_word(parts[-3]) and not words_of(parts[-1]) & _KIND:
        parts[-1] = "#"
    return re.sub(r"\d+", "#", "".join(parts))


def _quantity_word(part: str) -> bool:
    """Whether a part of a name says a quantity and nothing else."""
    return any(words_of(part) <= known for _, known in QUANTITY_WORDS)


def channels_table(
    topics: Sequence[TopicSurvey],
    kind: Format,
    joints: Sequence[tuple[str, ...]],
    motors: Sequence[tuple[str, ...]],
    straight: Sequence[bool],
) -> str:
    """A `[channels]` table of the most likely signals; empty where there are no positions or torques."""
    positions = [family.of(joints) for family in _families(topics, "position", joints)]
    torques = [family.of(motors) for family in _families(topics, "torque", [*joints, *motors])]
    if joints and any(len(family.channels) == len(joints) for family in positions):
        positions = [family for family in positions if len(family.channels) == len(joints)]
    if not positions:
        return ""
    if joint_like := [family for family in positions if not family.of_a_point]:
        positions, torques = joint_like, [family for family in torques if not family.of_a_point]
    rates = [family.of(joints) for family in _families(topics, "velocity", joints)]
    pairs = [(p, t if joints else t.ordered(p)) for p in positions for t in torques]
    position, torque = max(pairs, key=lambda pair: _fit(*pair), default=(positions[0], None))
    if joints and len(position.channels) > len(joints) == len(moved := _moved(position)):
        count = len(position.channels)
        rates, position = [rate.ordered(position).only(moved, count) for rate in rates], position.only(moved, count)
        torque = torque and torque.only(moved, count)
    lines = ["[channels]  # units and choices are guesses: check each of them"]
    lines.append(_time_line(position, torque, kind))
    if len(straight) == len(position.channels):
        position = replace(position, channels=tuple(map(_of_joint, position.channels, straight)))
        if torque is not None and len(torque.channels) == len(straight):
            torque = replace(torque, channels=tuple(map(_of_joint, torque.channels, straight)))
    lines.append(_signal_line("position", position) + _unlike(position, joints))
    if torque is None:
        lines += _left(topics, position) or [f"{_NO_TORQUE}; {WITHOUT_TORQUE}"]
    else:
        lines.append(_signal_line("torque", torque))
        lines += _instead(torques, torque)
        lines += _merge_line(position, torque, kind)
    lines += _velocity_line(rates, position)
    return "\n".join(lines) + "\n"


def _unlike(position: _Family, joints: Sequence[tuple[str, ...]]) -> str:
    """What to check where positions are not as many as the device's joints, or have names that are none of them."""
    count = len(position.channels)
    names = ", ".join(joint[-1] for joint in joints[:_NAMED]) + (", ..." if len(joints) > _NAMED else "")
    if joints and count < len(joints):
        moved = owners([unit_apart(c.name)[0] for c in position.channels], joints)
        only = f"--only {','.join(joints[k][-1] for k in moved)}" if moved else "--hold JOINT=0"
        return (
            f"; the device has {len(joints)} joints ({names}), and these are {count}: a joint that the log lacks and "
            f"that stands still is held in the device file (haptid import {only})"
        )
    if joints and count > len(joints):
        return f"; the device has {len(joints)} joints, and these are {count}: keep those of {names}"
    if joints and not position.known and are_named([unit_apart(c.name)[0] for c in position.channels]):
        return f"; none is named as a joint of the device: put them, and the torques, in the order of {names}"
    held = sorted(set(range(count)) - set(_moved(position)))
    if held and held != list(range(count)) and any(position.channels[k].usable for k in held):
        return (
            f"; {channel_list([position.channels[k].name for k in held])} hardly move: identify a device file with "
            f"their joints held (haptid import --hold JOINT=POSITION), or add logs that move them"
        )
    return ""


def _moved(position: _Family) -> list[int]:
    """Channels, by number, of joints that are not held while others move; all where the unit is none of a position."""
    scales = [_SI.get(channel.unit, 0.0) for channel in position.channels]
    if not all(scales):
        return list(range(len(scales)))
    travels = [scale * (channel.high - channel.low) for scale, channel in zip(scales, position.channels, strict=True)]
    held = held_joints(travels, [channel.unit in ("m", "mm") for channel in position.channels])
    return [k for k in range(len(scales)) if k not in held]


def _left(topics: Sequence[TopicSurvey], position: _Family) -> list[str]:
    """Channels of no known name, as many as the positions and beside them: a question, and lines to uncomment."""
    left = [
        family
        for family in _families(topics, "other")
        if len(family.channels) == len(position.channels)
        and family.topic is position.topic
        and family.rank[:2] == (True, True)
        and not words_of(family.array) & NEITHER
    ][:3]
    names = " or ".join(channel_list([channel.name for channel in family.channels]) for family in left)
    asked = f"{_NO_TORQUE} by its name; is it {names}?"
    return [asked, *(f'# torque = {{ {_where(family)}, unit = "N m" }}' for family in left)] if left else []


def _velocity_line(rates: Sequence[_Family], position: _Family) -> list[str]:
    """The velocities of the positions, one for each and in the same rows."""
    units = [_RATE_UNITS.get(channel.unit, "") for channel in position.channels]
    samples = min(channel.count for channel in position.channels)
    for family in (rate.ordered(position) for rate in rates):
        own = [channel.unit or unit for channel, unit in zip(family.channels, units, strict=False)]
        fits = family.topic is position.topic and len(family.channels) == len(units) and all(own)
        wanted = bool(words_of(family.array) & _WANTED) != bool(words_of(position.array) & _WANTED)
        if fits and not wanted and family.rank[0] and min(c.count for c in family.channels) == samples:
            stated = basic_string(own[0]) if len(set(own)) == 1 else f"[{', '.join(map(basic_string, own))}]"
            return [f"velocity = {{ {_where(family)}, unit = {stated} }}  # used where less noisy than differences"]
    return []


def _of_joint(channel: ChannelSurvey, straight: bool) -> ChannelSurvey:
    """A channel of a prismatic joint whose unit was guessed as that of an angle or a moment."""
    if straight and channel.unit in ("rad", "deg"):
        largest = max(abs(channel.low), abs(channel.high))
        unit = "mm" if largest > _METRES else "m"
        return replace(channel, unit=unit, reason=f"its joint is prismatic, and it reaches {largest:.3g}")
    if straight and channel.unit == "N m":
        return replace(channel, unit="N", reason="its joint is prismatic")
    return channel


def _merge_line(position: _Family, torque: _Family, kind: Format) -> list[str]:
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
    method = "hold" if words & (COMMAND_WORDS | _WANTED | {"control"}) else "linear"
    return [f'merge = {{ method = "{method}" }}  # rows of several sources, merged by time']


def _instead(families: Sequence[_Family], chosen: _Family) -> list[str]:
    """Other channels that may be meant, as comments."""
    taken = {(chosen.topic.name, channel.name) for channel in chosen.channels}
    rest = [
        f
        for f in families
        if len(f.channels) == len(taken) and f.rank[0] and {(f.topic.name, c.name) for c in f.channels} != taken
    ]
    return [f"# also there: {', '.join(c.name for c in family.channels)}" for family in rest[:3]]


def _time_line(position: _Family, torque: _Family | None, kind: Format) -> str:
    if kind is MESSAGES:
        headers = all(f.topic.header for f in (position, torque) if f is not None)
        stamp = "header" if headers else "receive"
        why = "" if headers else "  # not every topic has stamps in its messages"
        return f"time = {{ topic = {basic_string(position.topic.name)}, stamp = {basic_string(stamp)} }}{why}"
    if kind is LEROBOT:
        return f'time = "time"  # frames at {position.topic.rate_hz:g} Hz, a pause between episodes'
    times = [channel for channel in position.topic.channels if channel.quantity == "time"]
    if not times:
        if own := position.topic.by_rates_hz:
            return (
                f"rate_hz = {own:g}  # guess: no channel of times was found; at this rate velocities fit the positions"
            )
        return "# rate_hz = ...  # no channel of times was found: write the rate at which the log was sampled"
    rows = position.channels[0].rows
    time = max(times, key=lambda t: (t.rows == rows, t.name.rpartition(".")[0] == position.prefix))
    return f"time = {basic_string(time.name)}\ntime_unit = {basic_string(time.unit)}  # guess: {time.reason}"


def _where(family: _Family) -> str:
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


def _signal_line(key: str, family: _Family) -> str:
    units = dict.fromkeys(channel.unit for channel in family.channels)
    reasons = dict.fromkeys(channel.reason for channel in family.channels)
    where = _where(family)
    unit, reason = next(iter(units)), next(iter(reasons))
    if len(units) > 1 and not _mixed(units):
        # A small joint, or a small motor, fits both units; that with the largest values tells which.
        largest = max(family.channels, key=lambda channel: max(abs(channel.low), abs(channel.high)))
        stated = any(channel.reason.startswith(STATED) for channel in family.channels)
        unit, reason = (unit, reason) if stated else (largest.unit, largest.reason)
        reason += "; units differ between channels" if stated else f" ({largest.name}; the others fit too)"
    still = [channel.name for channel in family.channels if not channel.usable]
    constant = ""
    if still:
        reason += f"; without a change, is it connected?: {', '.join(still[:6])}"
        constant = ", constant_ok = true" if len(still) < len(family.channels) else ""
    mixed = _mixed(units)
    written = (
        "[" + ", ".join(basic_string(channel.unit) for channel in family.channels) + "]"
        if mixed
        else basic_string(unit)
    )
    commanded = key == "torque" and (unit not in _MECHANICAL or words_of(family.array) <= COMMAND_WORDS)
    side = ', side = "motor"' if commanded else ""
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
    if key == "position" and unit == "counts" and all(c.low >= 0 and c.high < _TWELVE_BITS for c in family.channels):
        counted = f", gain = {2 * math.pi / _TWELVE_BITS:.9f}, offset = {-math.pi:.5f}"
        reason = f"whole numbers below {_TWELVE_BITS}, as of servos of 12 bits a turn with their zero at the middle"
    return f"{key} = {{ {where}, unit = {written}{counted}{more}{side}{constant} }}  # guess: {reason}"


def _mixed(found: Iterable[str]) -> bool:
    """Whether units are of angles and of lengths, or of moments and of forces."""
    kinds = set(found)
    return any(kinds & one and kinds - one for one in _STRAIGHT)
