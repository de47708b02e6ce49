"""What stands beside the samples of a file of arrays: names of their columns in lists of texts, and the rate."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from haptid.log.formats.sniff import RawChannel
from haptid.log.survey.channels import ChannelSurvey
from haptid.log.survey.names import element_of, is_time, quantity_of, words_of

# Words of lists that name the columns of arrays, in the singular.
_LISTS = ("name", "joint", "label", "column", "header", "field", "channel", "dof", "motor", "actuator", "axis", "axes")
_OF_MOTORS = frozenset({"motor", "motors", "actuator", "actuators"})
_OF_JOINTS = frozenset({"joint", "joints", "dof", "dofs", "axis", "axes"})
# Names of a sampling period, s, and of a rate, Hz, as words in lower case.
_SAMPLED = r"(?:sampl(?:e|ing)_?)"
_PERIOD = re.compile(rf"(?:d_?t|delta_?t|t_?s|{_SAMPLED}?(?:time_?step|period)|{_SAMPLED}time)(?:_(?P<unit>s|ms|us))?")
_RATE = re.compile(rf"(?:f_?s|fps|hz|(?:{_SAMPLED}|control_?)?(?:rate|freq|frequency))(?:_hz)?")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
# Rates that a log may have, Hz: a lower `freq` or `Fs` is that of the motion, or static friction.
_LEAST, _MOST = 20.0, 1e5


def texts_beside(beside: Mapping[str, RawChannel]) -> dict[str, tuple[str, ...]]:
    """Lists of different texts by their names, those of cells that are called `names[1]`, `names[2]` too."""
    found: dict[str, list[str]] = {}
    for name, values in beside.items():
        if values.dtype.kind == "U":
            match = element_of(name) if values.size == 1 else None
            found.setdefault(match["array"] if match else name, []).extend(str(text).strip() for text in values)
    return {name: tuple(own) for name, own in found.items() if len(set(own)) == len(own) > 1 and all(own)}


def column_names(names: Sequence[str], texts: Mapping[str, tuple[str, ...]]) -> dict[str, str]:
    """Names of an array's columns that a list beside it gives, where these tell quantities, as `q_elbow`, `tau_elbow`.

    Args:
        names: of the channels.
        texts: lists beside them.
    """
    told: dict[str, str] = {}
    for array, own in _arrays(names).items():
        for called in _lists_of(array, len(own), texts):
            kinds = {quantity_of(text) for text in called} - {"other"}
            if len(kinds) > 1 or (kinds and any(map(is_time, called))):
                told.update(zip(own, called, strict=True))
                break
    return told


def of_listed_joints(channels: Sequence[ChannelSurvey], texts: Mapping[str, tuple[str, ...]]) -> list[ChannelSurvey]:
    """Channels with the joints that a list beside the arrays names: `joint_names` beside `q`, of as many columns.

    Of several lists that one counts which is nearest, in the same group; then, of torques, that of motors.
    """
    named: dict[str, str] = {}
    for array, own in _arrays([channel.name for channel in channels]).items():
        kinds = {channel.quantity for channel in channels if channel.name in own}
        if kinds <= {"position", "velocity", "torque"} and len(kinds) == 1:
            found = _lists_of(array, len(own), texts, motors=kinds == {"torque"})
            named.update(zip(own, found[0], strict=True) if found else ())
    return [replace(channel, joint=channel.joint or named.get(channel.name, "")) for channel in channels]


def listed_joints(channels: Sequence[str], beside: Mapping[str, RawChannel]) -> tuple[str, ...]:
    """Joints that a list beside an array names, where the channels are all of its columns; nothing where none does."""
    for array, own in _arrays(channels).items():
        if list(channels) == own and (found := _lists_of(array, len(own), texts_beside(beside))):
            return found[0]
    return ()


def stated_rate(beside: Mapping[str, RawChannel]) -> tuple[float, str]:
    """Rate that single numbers beside the samples state, Hz, and by what; 0 where none does, or they disagree."""
    found = {}
    for name, values in beside.items():
        if values.size != 1 or values.dtype.kind == "U" or not float(values[0]) > 0:
            continue
        last = _CAMEL.sub("_", name.rpartition(".")[2]).lower()
        if period := _PERIOD.fullmatch(last):
            rate = 1.0 / (float(values[0]) * _SCALES[period["unit"] or "s"])
        elif _RATE.fullmatch(last):
            rate = float(values[0])
        else:
            continue
        if _LEAST <= rate <= _MOST:
            found[f"{name} = {float(values[0]):g}"] = rate
    rates = list(found.values())
    agree = bool(rates) and np.allclose(rates, rates[0], rtol=1e-3, atol=0.0)
    return (rates[0], next(iter(found))) if agree else (0.0, "")


def _arrays(names: Sequence[str]) -> dict[str, list[str]]:
    """Channels of each array that has several, all of them counted from 1."""
    found: dict[str, list[str]] = {}
    for name in names:
        if (match := element_of(name)) and match["element"].isdecimal():
            found.setdefault(match["array"], []).append(name)
    return {array: own for array, own in found.items() if own == [f"{array}[{k + 1}]" for k in range(len(own))]}


def _lists_of(
    array: str, count: int, texts: Mapping[str, tuple[str, ...]], motors: bool = False
) -> list[tuple[str, ...]]:
    """Lists that may name the columns of an array, the likeliest first: in its group, or in one around it."""
    fits = []
    for name, own in texts.items():
        group, _, last = name.rpartition(".")
        words = words_of(last)
        known = bool(words & (_OF_JOINTS | _OF_MOTORS)) or all(
            word.rstrip("s") in _LISTS or quantity_of(word) != "other" for word in words
        )
        around = not group or array == group or array.startswith(f"{group}.")
        if known and around and len(own) == count:
            wanted = words & (_OF_MOTORS if motors else _OF_JOINTS)
            fits.append((len(group), bool(wanted), not words & (_OF_JOINTS if motors else _OF_MOTORS), own))
    return [own for *_, own in sorted(fits, key=lambda fit: fit[:3], reverse=True)]
