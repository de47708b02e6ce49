"""Arrays of states: positions, their rates and accelerations side by side under one name."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from haptid.log.by_content import period_of
from haptid.log.survey.channels import ChannelSurvey
from haptid.log.survey.names import element_of
from haptid.log.survey.recognised import RATE_OF_RATE

# Correlation of positions and summed rates, at least; share by which their period differs from that of the rows, and
# that of the accelerations from theirs, at most.
_ALIKE, _SAME_PERIOD = 0.95, 0.1
# Quantities in an array of states: with accelerations, and without.
_PARTS = (3, 2)
# Columns of an array that are looked at, at most.
_MOST = 48
_NUMBER = re.compile(r"\d+(?=\D*$)")


def with_states(
    channels: Sequence[ChannelSurvey], columns: Callable[[list[str]], list[NDArray[np.generic]]], rate: float
) -> list[ChannelSurvey]:
    """Channels whose arrays of positions are states, `Q = [q qd qdd]`, with the quantity of each; others as they are.

    Rates are known by their sums, which are the positions at one sampling period of all joints, and that of the rows
    where it is known. Joints may move as on a circle: no array is one of states that has as many columns as torques.

    Args:
        channels: of the log.
        columns: numbers of channels by their names.
        rate: of the rows, Hz; 0 where not known.
    """
    arrays: dict[tuple[str, str], list[ChannelSurvey]] = {}
    for channel in channels:
        match = element_of(channel.name)
        array = match["array"] if match else _NUMBER.sub("#", channel.name)
        arrays.setdefault((channel.quantity, array), []).append(channel)
    changed: dict[str, ChannelSurvey] = {}
    torques = {len(own) for quantity, own in arrays.items() if quantity[0] == "torque"}
    for (quantity, _), own in arrays.items():
        alike = quantity == "position" and len({channel.rows for channel in own}) == 1
        apart = len({channel.name for channel in own}) == len(own)
        if alike and apart and 1 < len(own) <= _MOST and len(own) not in torques:
            changed |= _told(own, columns, rate)
    return [changed.get(channel.name, channel) for channel in channels]


def _told(
    own: Sequence[ChannelSurvey], columns: Callable[[list[str]], list[NDArray[np.generic]]], rate: float
) -> dict[str, ChannelSurvey]:
    """Channels of one array that are no positions, by their names; nothing where it is no array of states."""
    values = columns([channel.name for channel in own])
    for parts in _PARTS:
        count = len(own) // parts
        if count * parts != len(own):
            continue
        blocks = [list(range(part * count, (part + 1) * count)) for part in range(parts)]
        by_joint = [list(range(part, len(own), parts)) for part in range(parts)]
        for positions, rates, *seconds in (blocks, by_joint) if count > 1 else (blocks,):
            period = period_of([values[k] for k in positions], [values[k] for k in rates], _ALIKE)
            if not period or (rate and abs(period * rate - 1.0) > _SAME_PERIOD):
                continue
            made = {own[k].name: replace(own[k], quantity="velocity", unit="", reason="") for k in rates}
            for block in seconds:
                second = period_of([values[k] for k in rates], [values[k] for k in block])
                reason = RATE_OF_RATE if abs(second / period - 1.0) < _SAME_PERIOD else ""
                made |= {own[k].name: replace(own[k], quantity="other", unit="", reason=reason) for k in block}
            return made
    return {}
