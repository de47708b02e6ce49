"""A finding of the diagnosis: one test or measure, its figures, the limit, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal

from haptid._internal.late import dataclass

Status = Literal["ok", "doubt", "bad"]
ORDER: tuple[Status, ...] = ("ok", "doubt", "bad")
# Significance level of every test: one false finding in a hundred clean logs.
SIGNIFICANCE = 0.01
# A term that explains more than this share of a motor's residual power is worth adding.
_LARGE = 0.1
# One that explains less than this share is of no use, however significant: coarse encoders make such residuals.
SMALL_SHARE = 0.03
# What the sentences of "units and signs" compare; and its figures of parameters that are negative, before their names.
BODIES, NEGATIVE = "the inertial torque of the device file's bodies", "negative "


@dataclass(frozen=True)
class Finding:
    """The outcome of one diagnostic.

    Attributes:
        name: such as "time delay".
        status: "ok", "doubt" (significant) or "bad" (significant and large).
        figures: test statistics, p-values and effect sizes, SI, by name.
        sentence: the result, its size, the limit, and what to do.
    """

    name: str
    status: Status
    figures: Mapping[str, float]
    sentence: str

    def __post_init__(self) -> None:
        figures = {name: float(value) for name, value in self.figures.items()}
        object.__setattr__(self, "figures", MappingProxyType(figures))


def worst(statuses: Sequence[Status]) -> Status:
    """The worst of several; "ok" where there is none."""
    return max(statuses, key=ORDER.index, default="ok")


def graded(p: float, explained: float) -> Status:
    """By p-value and share of the residual power explained."""
    if p >= SIGNIFICANCE or explained < SMALL_SHARE:
        return "ok"
    return "bad" if explained > _LARGE else "doubt"


def shown_time(seconds: float) -> str:
    """An instant of a log in seconds, to the millisecond, as it can be copied into a study."""
    return f"{round(seconds, 3):.13g}"


def joined_names(names: Sequence[str], most: int = 4) -> str:
    """Names as text, the first few of many."""
    shown = list(names[:most])
    if len(names) > most:
        return f"{', '.join(shown)} and {len(names) - most} more"
    return " and ".join([", ".join(shown[:-1]), shown[-1]]) if len(shown) > 1 else "".join(shown)
