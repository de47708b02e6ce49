"""Guesses from names: what a channel is, and its unit by name, type and range, each with its reason."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid.log.formats.sniff import RawChannel
from haptid.log.stamps import too_fast
from haptid.log.survey.channels import OF_DEVICE, STATED, ChannelSurvey, Quantity
from haptid.log.survey.families import WANTED_WORDS
from haptid.log.survey.names import (
    COMMAND_WORDS,
    COUNTED_WORDS,
    CURRENT_WORDS,
    QUANTITY_WORDS,
    base_of,
    drive_unit,
    element_of,
    is_straight,
    only_unit,
    quantity_of,
    time_unit,
    unit_apart,
    words_of,
)
from haptid.log.units import known_unit, readings

# Positions beyond this, rad, and counts beyond that, are not radians.
_RADIANS, _COUNTS = 4 * math.pi, 2000.0
# Below this, rad, a joint may have turned, as a pendulum or a wheel.
_FEW_TURNS = 20 * math.pi
# Degrees of a turn, beyond which few joints go, and turns beyond which a motor's are as likely as degrees.
_ONE_TURN, _OF_A_JOINT = 360.0, 2.0
_UNSTATED = "no unit is stated"
# How reasons end of times that tell no rate: another clock is better.
NO_RATE = (": their rate is not known", ": no one rate")
MAY_TURN, TURNS = "a joint that turns so far is in rad", "turns where it is in degrees"
NOT_TOLD = "which neither its torque nor its swing tells: write its unit, or a gain in rad per unit"
# Currents beyond this are in mA.
_AMPERES = 200.0
# Steps of times that are pauses, in the median; share by which mean and median differ where there is no one rate, and
# of rows with the stamp of the row before.
_PAUSE, _UNEVEN, _SHARED = 10.0, 0.25, 0.05
# Forces and torques beyond this, in MN or MN m, are no machine's.
_MEGA = 100.0
# Positions beyond this, of what moves straight, are in mm.
_METRES = 5.0
# A unit over another one, which no position and no torque has.
_RATIO = re.compile(r"[^\W\d_][^/]*/")
# Names of the rate of a cart's `x`, and the most poles that it carries.
_RATES_OF_X, _POLES = ("x_dot", "xdot", "dx"), 3
# A voltage that stays above this share of its greatest value feeds a drive, and moves nothing.
_SUPPLY, _AS_OF_A_SUPPLY = 0.8, "as of a supply"
# Words of voltages at a motor, about an operating point as those of a supply are; Universal Robots call the supply of a
# joint so too.
_AT_A_MOTOR = frozenset({"motor", "motors", "mot", "rotor", "joint", "joints", "axis", "vm", "vq", "uq"})
_FED_JOINT = frozenset({"actual", "joint"})
# A numbered pose that is called as nothing else's but the joints'.
_POSE = re.compile(r"(?:(?:joint|actual|measured|meas|robot)[_.]?)?poses?[_.]?\d+", re.I)
_LAST_NUMBER = re.compile(r"\d+$")
# Torques that are whole numbers, and reach more than this, are in a driver's unit.
_WHOLE = 10.0


def timed(channel: ChannelSurvey, column: RawChannel, stated: str) -> tuple[ChannelSurvey, float]:
    """A channel that is called a time, with its unit, and the rate of its rows; no time where it does not grow.

    The rate is 0 where its steps are of no one size: the reason says what they are.
    """
    own = column[~np.isnan(column)] if column.dtype.kind == "f" else column  # rows of other topics have none
    steps = np.diff(own[: 2**16].astype(np.float64) if own.dtype.kind == "f" else own[: 2**16])
    if not (steps.size and np.isfinite(steps).all() and (steps >= 0).mean() > 0.99 and (steps > 0).any()):
        return channel, 0.0
    step = float(np.median(steps)) or float(np.mean(steps))  # 0 where several rows have each stamp
    scales = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    known = known_unit(stated) if stated else None
    if known is not None and known[0] == "time":
        unit, reason = known[1], f"{STATED[0]} {stated}"
    elif named_unit := time_unit(channel.name):
        unit, reason = named_unit, STATED[1]
    elif channel.name.endswith("@time"):
        unit, reason = "ns", "as stamps of a waveform are read"
    elif column.dtype.kind in "iu" and channel.low > 1e17:
        unit, reason = "ns", "whole numbers of that size are nanoseconds since 1970"
    else:
        unit, reason = "", f"its usual step is {step:.4g}"
    fits = [u for u, scale in scales.items() if 2e-5 < step * scale < 0.2]
    if not unit:
        unit = fits[0] if fits else "s"
    elif fits and too_fast(steps * scales[unit]):
        unit, reason = fits[0], f"{reason}, by which its usual step of {step:.4g} is {1 / (step * scales[unit]):.3g} Hz"
    usual, uneven = usual_step(steps)
    rate = 1.0 / (usual * scales[unit]) if usual else 0.0
    return replace(channel, quantity="time", unit=unit, reason=reason + (f"; {uneven}" if uneven else "")), rate


def usual_step(steps: NDArray[Any]) -> tuple[float, str]:
    """The step of most times; 0, and what the steps are, where they are of no one size.

    Args:
        steps: differences of consecutive times, (n,); a few may be pauses, or go back.
    """
    forward = steps[steps > 0].astype(np.float64)
    same = float(np.mean(steps == 0))
    if same > _SHARED:
        return 0.0, f"{100 * same:.2g} % of the rows have the time of the row before{NO_RATE[0]}"
    median = float(np.median(forward)) if forward.size else 0.0
    within = forward[forward <= _PAUSE * median]
    if not within.size or abs(float(within.mean()) - median) > _UNEVEN * median:
        low, high = np.quantile(forward, (0.1, 0.9)) if forward.size else (0.0, 0.0)
        return 0.0, f"its steps are uneven, most of them from {low:.3g} to {high:.3g}{NO_RATE[1]}"
    return median, ""


def guessed(
    channel: ChannelSurvey, name: str, source: str, stated: str, topic: frozenset[str] = frozenset()
) -> ChannelSurvey:
    """What a channel is, by its name and that of its topic, its stated unit and its range."""
    base, stated = base_of(name), stated or unit_apart(name)[1]
    words = words_of(base) or words_of(name)
    quantity = quantity_of(base)
    if words and words <= COMMAND_WORDS:
        quantity = "torque"
    if quantity == "other" and "state" in words and element_of(name):  # an array, and no state of a switch
        quantity = "position"
    if quantity == "other" and topic and base == "data":
        words, quantity = topic, next((q for q, known in QUANTITY_WORDS if topic & known), "other")
    elif quantity == "other" and (m := element_of(name)):
        words = words_of(m["element"])
        quantity = next((q for q, known in QUANTITY_WORDS if words & known), "other")
    elif source == "lerobot" and (m := element_of(name)):  # joint.pos, joint.torque in one list
        inner = words_of(m["element"].rpartition(".")[2])
        quantity = next((q for q, known in QUANTITY_WORDS if inner & known), quantity)
    if quantity == "other" and not stated and (alone := only_unit(base)):
        own = base.rstrip("0123456789_ .")
        return replace(channel, quantity=alone[0], unit=alone[1], reason=STATED[1] + _or(own))
    known = known_unit(stated) if stated else None
    if known is not None and known[0] != "time":
        # Of `q-axis [A]` the unit tells, and not the letter; counts are of either, and volts of a potentiometer too.
        told = {quantity, known[0]} == {"position", "torque"} and known[1] not in ("counts", "V", "mV")
        if told or (quantity == "other" and known[0] in ("position", "torque")):
            quantity = known[0]
        return replace(channel, quantity=quantity, unit=known[1], reason=f"{STATED[0]} {stated}{_or(stated)}")
    if stated and known is None and quantity in ("position", "torque"):
        if _RATIO.match(stated):  # `torque constant [Nm/A]`
            return replace(channel, quantity="other")
        return replace(channel, quantity=quantity, unit="counts", reason=_own_unit(stated))
    end = base.rpartition("_")[2] if "_" in base else ""
    suffix = known_unit(end) if end else None
    filtered = end.lower() == "raw" and not channel.whole  # `q_raw` before a filter, in rad
    plain = end not in ("m", "a", "v", "n") or (end == "m" and is_straight(words))
    largest = max(abs(channel.low), abs(channel.high)) if channel.count else 0.0
    if suffix and suffix[0] == quantity and not filtered and plain:
        if base.isupper() and suffix[1][0] == "M":
            unit, reason = _milli_or_mega(suffix[1], largest)
            return replace(channel, quantity=quantity, unit=unit, reason=reason)
        return replace(channel, quantity=quantity, unit=suffix[1], reason=STATED[1] + _or(end))
    of_all = frozenset() if quantity == "position" and not is_straight(words) and is_straight(words | topic) else topic
    feeds = drive_unit(words) == "voltage" and (not words & _AT_A_MOTOR or words >= _FED_JOINT)
    if quantity == "torque" and feeds and 0 < _SUPPLY * channel.high <= channel.low < largest:
        return replace(channel, quantity="other", reason=f"from {channel.low:.4g} to {largest:.4g}, {_AS_OF_A_SUPPLY}")
    unit, reason = unit_of(quantity, words | of_all, largest, channel, source)
    return replace(channel, quantity=quantity, unit=unit, reason=reason)


def _or(unit: str) -> str:
    """What else a unit may be: `MNM` in capitals is mN m or MN m."""
    other = [f", which may also be {name}" for name in readings(unit, "torque")[1:]]
    return "".join(other)


def _milli_or_mega(unit: str, largest: float) -> tuple[str, str]:
    """Unit and reason where the name is in capitals, which do not tell milli from mega: no machine has such a mega."""
    milli = unit.replace("M", "m", 1)
    meant, other = (milli, unit) if largest > _MEGA else (unit, milli)
    return meant, f"{STATED[1]}, in capitals, which may also be {other}; up to {largest:.4g}"


def _own_unit(stated: str) -> str:
    """Reason of a channel whose stated unit is none that haptid converts, such as per cent of a rated torque."""
    return f"{STATED[0]} {stated}, which haptid does not know: a gain in SI per {stated} is required"


def unit_of(
    quantity: Quantity, words: frozenset[str], largest: float, channel: ChannelSurvey, source: str
) -> tuple[str, str]:
    if quantity == "position":
        if channel.whole and (largest > _COUNTS or words & COUNTED_WORDS):
            return "counts", f"whole numbers up to {largest:.4g}; a gain in rad per count is required"
        if is_straight(words):
            unit = "mm" if largest > _METRES else "m"
            return unit, f"{_UNSTATED}; called as what moves straight, up to {largest:.3g}"
        if {"pos", "estimate"} <= words:
            return "turn", "called as by ODrive, which counts turns"
        if largest > _RADIANS and not (source == "rosjoint" and channel.high - channel.low < _RADIANS):
            more = (
                "; LeRobot also writes -100..100 of a motor's range, which is no angle" if source == "lerobot" else ""
            )
            few = f"; {MAY_TURN}" if largest < _FEW_TURNS and not more else ""
            if largest > _ONE_TURN:  # of a wheel, or a motor before its gear
                few = f"; {largest / _ONE_TURN:.3g} {TURNS}, {largest / math.tau:.3g} where in rad"
            whole = "; whole numbers: degrees, or counts" if channel.whole else ""
            if largest > _OF_A_JOINT * _ONE_TURN and source != "lerobot":
                return "counts", f"it reaches {largest:.4g}{few}, {NOT_TOLD}"
            return "deg", f"it reaches {largest:.4g}, more than two turns in rad{more}{whole or few}"
        more = "as ROS prescribes" if source == "rosjoint" else _UNSTATED
        return "rad", f"{more}, and its range of {largest:.3g} fits"
    if quantity == "torque":
        counted, kind = channel.whole and largest > _WHOLE, drive_unit(words)
        if kind == "current" and (largest > _AMPERES or not counted):
            own = "; whole numbers: mA, or the driver's own unit (a servo's 2.69 or 6.5 mA)" if counted else ""
            said = "a current" if words & CURRENT_WORDS else "a control output, as a current of Universal Robots"
            return ("mA" if largest > _AMPERES else "A"), f"called {said}, up to {largest:.4g}{own}"
        if counted:
            return "counts", f"whole numbers up to {largest:.4g}, of a driver, a servo's load or a PWM; not N m"
        if kind == "voltage":
            return "V", f"called a voltage, up to {largest:.4g}"
        if kind == "duty":
            return "counts", f"a duty cycle, up to {largest:.4g}; not N m"
        more = "as ROS prescribes; some drivers write A, mA or per cent" if source == "rosjoint" else _UNSTATED
        return "N m", f"{more}; up to {largest:.4g}"
    return "", ""


def commanded(channel: ChannelSurvey, unit: str) -> ChannelSurvey:
    """A torque of no stated unit in that of the device's motors."""
    before, unstated, _ = channel.reason.partition(_UNSTATED)  # before it, how it was recognised without a name
    if channel.quantity != "torque" or not unstated or channel.unit == unit:
        return channel
    return replace(channel, unit=unit, reason=f"{before}{_UNSTATED}; {OF_DEVICE}")


def lettered(channels: Sequence[ChannelSurvey]) -> list[ChannelSurvey]:
    """Channels with a cart's `x` and `F`, where there is no y and z; beside other positions, a pole's, with more to it.

    `x` is a cart's beside the angle of a pole where its rate, its planned position or a force `F` is there too.
    """
    positions = sum(channel.quantity == "position" for channel in channels)
    letters = {channel.name.lower(): channel for channel in channels if channel.quantity == "other"}
    more = letters.keys() & {"f", *_RATES_OF_X} or any(
        {"x"} < words_of(name) & {"x", *WANTED_WORDS} for name in letters
    )
    if letters.keys() & {"y", "z", "fy", "fz"} or positions > (_POLES if more else 0):
        return list(channels)
    moved = positions and "x" in letters
    found: list[tuple[str, Quantity]] = [("x", "position"), *((name, "velocity") for name in _RATES_OF_X if moved)]
    if not any(channel.quantity == "torque" for channel in channels) and (moved or not positions):
        found.append(("f", "torque"))
    made = list(channels)
    for name, quantity in found:
        if channel := letters.get(name):
            largest = max(abs(channel.low), abs(channel.high))
            unit, reason = unit_of(quantity, frozenset({name}), largest, channel, "")
            made[made.index(channel)] = replace(channel, quantity=quantity, unit=unit, reason=reason)
    return made


def with_voltages(channels: Sequence[ChannelSurvey]) -> list[ChannelSurvey]:
    """Channels with the voltages that look like a supply's and are numbered as others that vary: all are of motors."""

    def array_of(channel: ChannelSurvey) -> str:
        return m["array"] if (m := element_of(channel.name)) else re.sub(r"\d+", "#", channel.name)

    varying = {array_of(channel) for channel in channels if channel.quantity == "torque" and channel.usable}
    made = []
    for channel in channels:
        if channel.reason.endswith(_AS_OF_A_SUPPLY) and array_of(channel) in varying:
            unit, reason = unit_of("torque", words_of(base_of(channel.name)), channel.high, channel, "")
            channel = replace(channel, quantity="torque", unit=unit, reason=reason)
        made.append(channel)
    return made


def posed(channels: Sequence[ChannelSurvey]) -> list[ChannelSurvey]:
    """Channels with numbered poses as positions, `pose_1` beside `vel_1`, where there are no others.

    As many as velocities or torques, by the same numbers. A pose that is called that of a hand is none of joints.
    """
    numbers: dict[str, set[str]] = {}
    for channel in channels:
        kind = "pose" if _POSE.fullmatch(channel.name) and channel.quantity == "other" else channel.quantity
        numbers.setdefault(kind, set()).add("".join(_LAST_NUMBER.findall(channel.name)))
    alike = numbers.get("pose") in (numbers.get("velocity"), numbers.get("torque"))
    if "position" in numbers or "pose" not in numbers or not alike:
        return list(channels)
    made = []
    for channel in channels:
        if _POSE.fullmatch(channel.name) and channel.quantity == "other":
            largest = max(abs(channel.low), abs(channel.high))
            unit, reason = unit_of("position", frozenset(), largest, channel, "")
            reason = f"called a pose, which is that of a point unless it is one of each joint; {reason}"
            channel = replace(channel, quantity="position", unit=unit, reason=reason)
        made.append(channel)
    return made
