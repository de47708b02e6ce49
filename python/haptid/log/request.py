"""How a log is to be read where its format leaves a choice, and what was found while reading."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Literal, get_args

from haptid._internal.late import dataclass
from haptid.errors import LogChannelError

MergeMethod = Literal["linear", "hold", "nearest"]


@dataclass(frozen=True)
class Merge:
    """How channels with stamps of their own come to the rows of the time channel.

    Attributes:
        method: "linear" between the neighbours, "hold" the value before (of commands), or the "nearest".
        largest_gap: rows without values this close are left out, s; None is four usual steps of the channel.
    """

    method: MergeMethod = "linear"
    largest_gap: float | None = None

    def __post_init__(self) -> None:
        if self.method not in get_args(MergeMethod):
            raise LogChannelError(
                f"merge method {self.method!r} is not known; wanted {', '.join(get_args(MergeMethod))}.",
                where="merge",
                found=self.method,
                limit=get_args(MergeMethod),
            )
        gap = self.largest_gap
        if gap is not None and not (math.isfinite(gap) and gap > 0):
            raise LogChannelError(
                f"largest_gap is {gap!r}; wanted a finite number above zero.", where="largest_gap", found=gap
            )


@dataclass(frozen=True)
class Request:
    """What a reader needs to know besides the names of the channels.

    Attributes:
        merge: of channels with other stamps.
        episodes: of a data set, by number; None for all.
        notes: what the reader found and did, appended to.
    """

    merge: Merge = field(default_factory=Merge)
    episodes: tuple[int, ...] | None = None
    notes: list[str] = field(default_factory=list)
