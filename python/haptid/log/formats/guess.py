"""Which channels are meant where none are named: t, q1..qn and tau1..taun, as most recorders call them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from haptid.errors import ChannelGuessError
from haptid.log.log import Channels, Signal

WHERE = r"(?P<where>(?:.*\.)?)"
NUMBER = r"_?\[?(?P<number>\d+)\]?"
TIME = re.compile(WHERE + r"(?:t|time)(?:_(?P<unit>s|ms|us|ns))?", re.IGNORECASE)
POSITION = re.compile(WHERE + r"(?P<family>q|pos|position)" + NUMBER, re.IGNORECASE)
TORQUE = re.compile(WHERE + r"(?P<family>tau|torque|u)" + NUMBER, re.IGNORECASE)
SINGLE = {"position": ("q", "pos", "position"), "torque": ("tau", "torque", "u")}


def guess(path: Path, names: Sequence[str]) -> tuple[Channels, str]:
    """The channels whose names say what they are, in rad and N m at the joint, and what was chosen.

    Raises:
        ChannelGuessError: there are none, or there is more than one choice.
    """
    times = [(name, match) for name in names if (match := TIME.fullmatch(name))]
    if len(times) != 1:
        found = "no time channel" if not times else f"{len(times)} time channels ({', '.join(n for n, _ in times)})"
        raise ChannelGuessError(path, f"{found} found by name", names)
    (time, match) = times[0]
    position = _numbered(path, names, POSITION, "position")
    torque = _numbered(path, names, TORQUE, "torque")
    unit = (match["unit"] or "s").lower()
    channels = Channels(Signal(position, "rad"), Signal(torque, "N m"), time=time, time_unit=unit)
    sentence = (
        f"channels were not given; taken: time {time} in {unit}, positions {', '.join(position)} in rad, "
        f"torques {', '.join(torque)} in N m, both at the joints"
    )
    return channels, sentence


def _numbered(path: Path, names: Sequence[str], pattern: re.Pattern[str], kind: str) -> tuple[str, ...]:
    """The one family of numbered channels, in order."""
    families: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        if match := pattern.fullmatch(name):
            family = families.setdefault((match["where"], match["family"].lower()), {})
            if family.setdefault(int(match["number"]), name) != name:
                raise ChannelGuessError(path, f"{family[int(match['number'])]} and {name} have one number", names)
    if not families:
        alone = [name for name in names if name.rpartition(".")[2].lower() in SINGLE[kind]]
        if len(alone) == 1:
            return (alone[0],)
        raise ChannelGuessError(path, f"no {kind} channels found by name", names)
    if len(families) > 1:
        firsts = ", ".join(family[min(family)] for family in families.values())
        raise ChannelGuessError(path, f"more than one set of {kind} channels ({firsts}, ...) found by name", names)
    (family,) = families.values()
    order = sorted(family)
    if order[0] > 1 or order[-1] - order[0] + 1 != len(order):
        found = ", ".join(family[k] for k in order)
        raise ChannelGuessError(path, f"{kind} channels {found} are not numbered without a gap from 1", names)
    return tuple(family[k] for k in order)
