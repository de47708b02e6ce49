"""Which channel is of which joint, where both have names that differ by words around the joint's own."""

from __future__ import annotations

import re
from collections.abc import Sequence

_Words = tuple[str, ...]
_WORD = re.compile(r"[^\W\d_]+|\d+")


def matched(channels: Sequence[str], joints: Sequence[tuple[str, ...]]) -> tuple[list[int], tuple[str, ...]]:
    """The channel of each joint, (joints,), empty where the names do not tell every joint's; and what is left over.

    A channel whose name contains a joint's is that joint's, and of several the one with the longest name. Otherwise the
    words are compared that not all channels, or not all joints, share at their ends: one contains the other. Of as many
    channels as joints the last one is that of the joint that is left, as of `pole` where the log says `pendulum angle`;
    no name tells that it is not another joint, such as a gripper, so the channel and the joint are returned too. Each
    joint has one channel of its own. Numbers alone are no names.

    Args:
        channels: names of channels of one quantity, without their units.
        joints: name of each joint, and its alias where it has one.
    """
    whole = [_words(name) for name in channels]
    ends = [[_words(joint[end]) for joint in joints] for end in (0, -1)]
    own, parts = _distinct(whole), [_distinct(names) for names in ends]
    like = [[c for c, words in enumerate(own) if any(_alike(words, n[k]) for n in parts)] for k in range(len(joints))]
    for found in (_longest(whole, list(zip(*ends, strict=True))), like):
        chosen = [c for group in found for c in group]
        if all(len(group) == 1 for group in found) and len(set(chosen)) == len(joints):
            return chosen, ()
    lacking = [k for k, group in enumerate(like) if not group]
    taken = {c for group in like for c in group}
    if len(channels) == len(joints) == len(taken) + 1 and len(lacking) == 1 and sum(map(len, like)) == len(taken):
        (last,) = {*range(len(joints))} - taken
        return [*(c for group in like for c in (group or [last]))], (channels[last], joints[lacking[0]][-1])
    return [], ()


def owners(channels: Sequence[str], joints: Sequence[tuple[str, ...]]) -> list[int]:
    """Joints whose names the channels contain, one for each channel, in the joints' order; none where one has none.

    Args:
        channels, joints: as for `matched`; the joints may be more.
    """
    ends = [[_words(joint[end]) for joint in joints] for end in (0, -1)]
    groups = _longest([_words(name) for name in channels], list(zip(*ends, strict=True)))
    found = [joint for joint, group in enumerate(groups) if len(group) == 1]
    return found if len(found) == len(channels) and max(map(len, groups), default=0) == 1 else []


def _longest(channels: Sequence[_Words], joints: Sequence[tuple[_Words, ...]]) -> list[list[int]]:
    """Channels of each joint, by the longest of the joints' names that a channel's name contains."""
    found: list[list[int]] = [[] for _ in joints]
    for c, words in enumerate(channels):
        sizes = [max((len(name) for name in names if _contains(words, name)), default=0) for names in joints]
        if max(sizes):
            found[sizes.index(max(sizes))].append(c)
    return found


def are_named(channels: Sequence[str]) -> bool:
    """Whether each channel has a word of its own, as where joints have names and no numbers that tell their order."""
    own = _distinct([_words(name) for name in channels])
    return len(own) > 1 and all(any(word.isalpha() and len(word) > 1 for word in words) for words in own)


def _words(name: str) -> _Words:
    return tuple(word.lower() for word in _WORD.findall(name))


def _distinct(names: Sequence[_Words]) -> list[_Words]:
    """Each without the words that all of them share at the beginning or the end, one word left at least."""
    made = list(names)
    while len(made) > 1 and all(len(words) > 1 and words[0] == made[0][0] for words in made):
        made = [words[1:] for words in made]
    while len(made) > 1 and all(len(words) > 1 and words[-1] == made[0][-1] for words in made):
        made = [words[:-1] for words in made]
    return made


def _alike(one: _Words, other: _Words) -> bool:
    """Whether the words of one stand in the other one after the other, and are not all numbers."""
    return _contains(one, other) or _contains(other, one)


def _contains(long: _Words, short: _Words) -> bool:
    places = range(len(long) - len(short) + 1)
    return any(word.isalpha() for word in short) and any(long[k : k + len(short)] == short for k in places)
