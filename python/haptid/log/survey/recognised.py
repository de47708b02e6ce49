"""Channels without telling names, by how they move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from haptid.log.by_content import Content
from haptid.log.survey.channels import ChannelSurvey
from haptid.log.survey.families import WANTED_WORDS
from haptid.log.survey.guesses import unit_of
from haptid.log.survey.names import COMMAND_WORDS, is_straight, words_of

# Reason of what is of no quantity that is used.
RATE_OF_RATE = "the rate of a velocity"


def recognised(channels: Sequence[ChannelSurvey], content: Content) -> list[ChannelSurvey]:
    """Channels without telling names by how they move; those that are called torques keep their units."""
    made = []
    called = {channel.name for channel in channels if channel.quantity == "torque"}
    rates = dict(zip(content.positions, content.rates, strict=False))
    groups = [group for group in (content.torques, *content.others) if group]
    # Those that are called torques first, then measured ones.
    groups.sort(
        key=lambda group: (not called >= {*group}, bool(words_of(" ".join(group)) & (WANTED_WORDS | COMMAND_WORDS)))
    )
    torques, *left = groups or [()]
    for channel in channels:
        largest, words = max(abs(channel.low), abs(channel.high)), words_of(channel.name)
        if channel.name in content.positions:
            alike = words == words_of(rates.get(channel.name, ""))  # a state, `x1` with the rate `x3`, is no cart's `x`
            straight = is_straight(words) and not alike
            unit, reason = unit_of("position", words if straight else frozenset(), largest, channel, "")
            reason = f"their rates are in {rates.get(channel.name, 'no column')} and on; {reason}"
            channel = replace(channel, quantity="position", unit=unit, reason=reason)
        elif channel.name in content.rates:
            channel = replace(channel, quantity="velocity")
        elif channel.name in content.accelerations:
            channel = replace(channel, reason=RATE_OF_RATE)
        elif channel.name in torques and channel.name not in called:
            current = frozenset({"current"} if channel.name.rstrip("_0123456789") in ("i", "I") else ())
            unit, reason = unit_of("torque", current, largest, channel, "")
            others = " or ".join(" to ".join(dict.fromkeys((group[0], group[-1]))) for group in left)
            reason = f"the first that is left beside positions and rates{others and ', or '}{others}; {reason}"
            channel = replace(channel, quantity="torque", unit=unit, reason=reason)
        made.append(channel)
    return made
