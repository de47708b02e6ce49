"""Families of a log's channels: those of one quantity that belong together, one for each joint, the best first."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from haptid._internal.late import dataclass
from haptid.log.survey.channels import A_PART, OF_DEVICE, STATED, ChannelSurvey, Quantity, TopicSurvey
from haptid.log.survey.joint_names import matched
from haptid.log.survey.names import (
    ANGLE,
    NESTED,
    QUANTITY_WORDS,
    base_of,
    drive_unit,
    element_of,
    is_quantity,
    last_part,
    unit_apart,
    words_of,
)
from haptid.log.units import known_unit

# Less likely to be measured at the motor: the wanted value, that of a model, or an outside torque.
WANTED_WORDS = frozenset({"target", "desired", "des", "reference", "ref", "command", "commanded", "cmd", "goal",
                     "action", "planned", "computed", "nominal", "simulated",
                     "actions", "setpoint", "control", "controls", "ctrl", "set", "soll", "external", "ext", "et",
                     "model", "predicted", "pred", "last", "prev", "residual", "disturbance", "gravity",
                     "friction", "passive", "constraint", "rigid", "feedforward", "coriolis"})  # fmt: skip
# More likely than a command, where both are there.
MEASURED_WORDS = frozenset({"measured", "actual", "act", "present", "feedback", "fb", "fbk", "meas", "msr", "ist"})
# What was done to a signal: another one than that without the word.
TREATED_WORDS = frozenset({"raw", "unfiltered", "filtered", "filt", "lpf", "smooth", "smoothed"})
_ANGLES = frozenset({"rad", "deg", "turn"})
# rad or m of a unit of positions.
SI = {"rad": 1.0, "deg": math.pi / 180, "turn": 2 * math.pi, "m": 1.0, "mm": 1e-3}
# A motor's torque is preferred to its current, this to its voltage, this to a duty cycle.
_DRIVE = ("duty", "voltage", "current", "")
_DRIVE_UNITS = {"A": "current", "mA": "current", "V": "voltage", "mV": "voltage"}
# Share of their sizes by which ranges of one signal in two units differ at most.
_SAME_RANGE = 1e-3
# Words of coordinates of a machine, which may be called x, y and z as a point in space is.
_OF_AXES = frozenset({"angle", "angles", "ang", "theta", "th", "joint", "q", "axis", "motor", "enc", "encoder"})
# What is desired of a measured signal beside it, or its rates: `q_d` of `q`, `tau_J_d[1]` of `tau_J[1]`, `angleDD`.
_DESIRED = re.compile(r"(?:_d|(?<=[a-z])D{1,2})(?=(?:_?\d+|\[\w+\])?$)")
# Words of quantities and of where their values come from: never the name of a joint.
_KIND = (
    frozenset(word for _, known in QUANTITY_WORDS for word in known) - {"joint"}
    | WANTED_WORDS
    | MEASURED_WORDS
    | TREATED_WORDS
)
_SEPARATOR = re.compile(r"([./ _])")
# A joint's number behind what all joints have in their names.
_NUMBERED = re.compile(r"(?P<word>\D*[^\W\d]_?)(?P<number>[0-9]{1,6})")


@dataclass(frozen=True)
class ChannelFamily:
    """Channels of one quantity that belong together, in order.

    Attributes:
        known: whether they were found by the joints' names.
        left: a channel that no name tells, and the joint that was left for it; empty where names tell all.
    """

    topic: TopicSurvey
    array: str
    channels: tuple[ChannelSurvey, ...]
    known: bool = False
    left: tuple[str, ...] = ()

    @property
    def rank(self) -> tuple[bool, bool, bool, bool, int, int, int, bool]:
        """Usable, not wanted, of a known unit, measured, a torque and no current; then many, long ones, and not raw."""
        words = words_of(f"{self.topic.name} {self.array}")
        usable = sum(channel.usable for channel in self.channels)
        drive = drive_unit(words) or _DRIVE_UNITS.get(self.channels[0].unit, "") or ("voltage" if self.is_input else "")
        no_torque = self.channels[0].quantity != "torque"  # of which `current_position` is the present one
        return (
            usable > 0,
            not words & WANTED_WORDS,
            not all(channel.unit == "counts" for channel in self.channels),
            bool(words & MEASURED_WORDS) or (no_torque and "current" in words),
            _DRIVE.index("" if no_torque else drive),
            usable,
            min(channel.count for channel in self.channels),
            "raw" not in words,
        )

    @property
    def of_a_point(self) -> bool:
        """Whether the channels are x, y and z of a point or a force in space, and of no joint."""
        ends = {re.split(r"[_. ]|(?<=[a-z])(?=[A-Z])", unit_apart(c.name)[0])[-1].lower() for c in self.channels}
        return {"x", "y", "z"} in (ends, {head.lower() for head in self.heads})  # `pos_x`, `x_pos`

    @property
    def of_axes_motors(self) -> bool:
        """Whether the channels are currents or voltages, or are called motors', of x, y and z: none is of a point."""
        driven = drive_unit(words_of(self.array)) or self.channels[0].unit in _DRIVE_UNITS
        return self.of_a_point and bool(driven or all(words_of(c.name) & _OF_AXES for c in self.channels))

    @property
    def of_axes(self) -> bool:
        """Whether the channels are called angles, or the axes, motors or encoders of a machine, of x, y and z too."""
        stated = all(c.reason.startswith(STATED) and c.unit in {*_ANGLES, "counts"} for c in self.channels)
        return stated or all(words_of(c.name) & _OF_AXES for c in self.channels)

    @property
    def is_input(self) -> bool:
        """Whether the channels are called as the input of a controller, `u`, which is a torque only by chance."""
        stated = any(c.reason.startswith(STATED) for c in self.channels)
        return not stated and all(words_of(last_part(base_of(c.name))) == {"u"} for c in self.channels)

    @property
    def of_motors(self) -> bool:
        """Whether the channels are named as those of motors before their gears."""
        return bool(words_of(self.array) & {"motor", "rotor"})

    @property
    def prefix(self) -> str:
        """Name before the last point."""
        return self.array.rpartition(".")[0]

    def of(self, joints: Sequence[tuple[str, ...]]) -> ChannelFamily:
        """The channels of these joints, in their order; all channels where not every joint is found by a name."""
        if not joints:
            return self
        heads = [c.joint or _joint_words(c.name, self.channels) for c in self.channels]
        found = [[c for c, head in zip(self.channels, heads, strict=True) if head in names] for names in joints]
        if all(len(x) == 1 for x in found):
            return replace(self, channels=tuple(c for (c,) in found), known=True)
        order, left = matched(self.called, joints)
        if not order:
            return self
        return replace(self, channels=tuple(self.channels[k] for k in order), known=True, left=left)

    def ordered(self, other: ChannelFamily) -> ChannelFamily:
        """The channels in the order of another family that has the same elements."""
        own = {m["element"]: c for c in self.channels if (m := element_of(c.name))}
        wanted = [m["element"] for c in other.channels if (m := element_of(c.name))]
        named = len(own) == len(wanted) or not all(map(str.isdecimal, wanted))  # a number is none of the same joint
        if len(own) == len(self.channels) and set(own) >= set(wanted) and len(wanted) == len(other.channels) and named:
            return replace(self, channels=tuple(own[element] for element in wanted))
        by_name, wanted = dict(zip(self.heads, self.channels, strict=True)), list(other.heads)
        if len(by_name) == len(self.channels) == len(wanted) and by_name.keys() == set(wanted):
            return replace(self, channels=tuple(by_name[head] for head in wanted))
        return self

    @property
    def called(self) -> list[str]:
        """Names of the joints, where texts beside the channels say them, or of the channels without their units."""
        return [c.joint or unit_apart(c.name)[0] for c in self.channels]

    @property
    def heads(self) -> tuple[str, ...]:
        """What the channels' names differ in: the joints' names, or numbers, as of `q1`, `q2` and `tau1`, `tau2`."""
        words = tuple(c.joint or _joint_words(c.name, self.channels) for c in self.channels)
        split = [_NUMBERED.fullmatch(word) for word in words]
        numbers = [str(int(m["number"])) for m in split if m]
        alike = len({m["word"] for m in split if m}) == 1 and len(set(numbers)) == len(words)
        return tuple(numbers) if alike else words

    def only(self, kept: Sequence[int], count: int) -> ChannelFamily:
        """Some of the channels, by number, of a family of this many; of another size as it is."""
        return replace(self, channels=tuple(self.channels[k] for k in kept)) if len(self.channels) == count else self


def _joint_words(name: str, family: Sequence[ChannelSurvey]) -> str:
    """The part of a channel's name that differs between the channels of its family: the joint's name."""
    nested = [m["outer"] for c in family if (m := NESTED.fullmatch(c.name))]
    if len(set(nested)) == len(family) > 1:
        return nested[[c.name for c in family].index(name)]
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


def channel_families(
    topics: Iterable[TopicSurvey], quantity: Quantity, joints: Sequence[tuple[str, ...]] = ()
) -> list[ChannelFamily]:
    """Families of a quantity, the best first; names that differ in the name of one of the joints are of one family."""
    names = "|".join(re.escape(name) for name in sorted({x for joint in joints for x in joint}, key=len, reverse=True))
    own = re.compile(rf"(?<![^\W_])(?:{names})(?![^\W_])", re.I) if names else None
    found: list[ChannelFamily] = []
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
        groups, place = _joined(arrays), {channel.name: k for k, channel in enumerate(topic.channels)}
        mixed = _by_numbers(arrays) if quantity == "torque" else ()
        for array, channels in (*groups.items(), *_of_unlike_names(groups), *mixed):
            kept = sorted((c for c in channels if not _is_copy(c, channels)), key=lambda c: place[c.name])
            found += [ChannelFamily(topic, array, tuple(own)) for own in _of_one_drive(kept)]
        found += _across(topic, arrays) if joints else []
    return sorted(found, key=lambda family: family.rank, reverse=True)


def _of_one_drive(channels: Sequence[ChannelSurvey]) -> list[list[ChannelSurvey]]:
    """Elements of an array apart by what they are: one motor's current and torque are two signals and no two motors."""
    kinds: dict[str, list[ChannelSurvey]] = {}
    for channel in channels:
        told = channel.quantity == "torque" and element_of(channel.name) and not channel.reason.endswith(OF_DEVICE)
        kinds.setdefault(_DRIVE_UNITS.get(channel.unit, "") if told else "", []).append(channel)
    return list(kinds.values())


def _across(topic: TopicSurvey, arrays: dict[str, list[ChannelSurvey]]) -> list[ChannelFamily]:
    """Families `q[1][1]`, `q[2][1]`, ... of arrays of arrays, as where trials, or robots of a simulation, come last.

    Where they are as many as the device's joints, they are taken before those of `q[1]` that are not.
    """
    firsts: dict[str, list[ChannelSurvey]] = {}
    for channels in arrays.values():
        if match := NESTED.fullmatch(channels[0].name):
            firsts.setdefault(match["array"], []).append(channels[0])
    return [ChannelFamily(topic, f"{name}[#]", tuple(own)) for name, own in firsts.items() if len(own) > 1]


def _is_copy(channel: ChannelSurvey, family: Sequence[ChannelSurvey]) -> bool:
    """Whether a channel is another of its family in another unit: `q_deg` beside `q_rad`, which is kept."""
    own = family.index(channel)
    for k, other in enumerate(family):
        if other.unit != channel.unit and channel.usable and _apart_from_units(other) == _apart_from_units(channel):
            a, b = SI.get(channel.unit, 0.0), SI.get(other.unit, 0.0)
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
    singles = {array: cs[0].name for array, cs in arrays.items() if len(cs) == 1 and "/" not in array}
    for array, channels in arrays.items():
        kind = words_of(f"{base_of(channels[0].name)} {array}") & (_KIND | {"motor", "joint"})
        alone = array in singles
        kind -= _of_joint_name(channels[0].name, frozenset(singles.values())) if alone else frozenset()
        element = element_of(channels[0].name)
        place = f"[{element['element']}]" if element else ""
        rows = f" {channels[0].rows}"  # every tenth sample of a joint is no other joint
        made.setdefault(" ".join([*sorted(kind), place]) + rows if alone else array, []).extend(channels)
    return made


def _of_joint_name(name: str, others: frozenset[str]) -> frozenset[str]:
    """Words of angles in a name that are of its joint: `qpos_wrist_angle` beside `qpos_wrist_rotate`.

    The name without them says the quantity all the same, and is that of no other channel: `hip_pos` of `hip_pos_angle`.
    """
    short = ANGLE.sub("", name)
    rest = words_of(short)
    return words_of(name) - rest if rest & _KIND and rest - _KIND and short not in others else frozenset()


def _of_unlike_names(groups: dict[str, list[ChannelSurvey]]) -> Iterator[tuple[str, list[ChannelSurvey]]]:
    """Groups whose names say one quantity by different words, each of joints of its own: a cart's and a pendulum's.

    `shoulder_pos` and `elbow_angle` are of two joints, `elbow_pos` and `elbow_angle` two signals of one; a cart's `x`
    is of another joint than any angle.
    """
    alike: dict[tuple[object, ...], list[list[ChannelSurvey]]] = {}
    cart = any(channel.name.lower() == "x" for channels in groups.values() for channel in channels)
    for array, channels in groups.items():
        words = [words_of(last_part(base_of(c.name))) for c in channels]
        plain = not any("/" in c.name or element_of(c.name) for c in channels)
        if plain and all(own - _KIND or (cart and c.unit in _ANGLES) for own, c in zip(words, channels, strict=True)):
            other = frozenset.union(*words, words_of(array)) & (
                WANTED_WORDS | MEASURED_WORDS | TREATED_WORDS | {"motor", "joint", "rotor"}
            )
            alike.setdefault((other, drive_unit(words_of(array)), channels[0].rows), []).append(channels)
    for members in alike.values():
        names = [
            frozenset.union(*(words_of(last_part(base_of(c.name))) - _KIND for c in channels)) for channels in members
        ]
        stated = {
            c.unit for own in members for c in own if c.unit in _ANGLES and c.reason.startswith("the file states")
        }
        if len(members) > 1 and len(stated) < 2 and sum(map(len, names)) == len(frozenset.union(*names)):
            channels = [channel for own in members for channel in own]
            yield " ".join(channel.name for channel in channels), channels


def _by_numbers(arrays: dict[str, list[ChannelSurvey]]) -> Iterator[tuple[str, list[ChannelSurvey]]]:
    """One group of all torques, where each joint has one of another kind: `torque1`, `current2` and `torque3`."""
    own = [
        channels
        for array, channels in arrays.items()
        if not words_of(array) & WANTED_WORDS and not any("/" in c.name or element_of(c.name) for c in channels)
    ]
    every = [channel for channels in own for channel in channels]
    numbers = [re.findall(r"\d+", unit_apart(channel.name)[0]) for channel in every]
    if len(own) < 2 or any(len(one) != 1 for one in numbers):
        return
    values = sorted(int(number) for (number,) in numbers)
    if values == list(range(values[0], values[0] + len(values))) and len({channel.rows for channel in every}) == 1:
        yield " ".join(channel.name for channel in every), every


def _pattern(name: str) -> str:
    """A channel's name without what tells it from those of other joints: numbers, or the joint's name in a path."""
    parts = re.split(r"([/.])", name)
    numbered = any(re.search(r"\d", part) for part in parts[-3:])
    side = len(parts) > 2 and words_of(parts[-3]) & (WANTED_WORDS | MEASURED_WORDS | {"motor", "joint"})
    if len(parts) > 2 and not numbered and not side and is_quantity(parts[-1]):
        parts[-3] = "#"
    elif (
        len(parts) > 2
        and parts[-2] == "."
        and is_quantity(parts[-3])
        and not words_of(ANGLE.sub("", parts[-1])) & _KIND
    ):
        parts[-1] = "#"
    return re.sub(r"\d+", "#", "".join(parts))
