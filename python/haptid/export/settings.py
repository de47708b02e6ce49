"""How code is to be: its names, its precision, and where it smooths friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from haptid._internal.arrays import positive
from haptid.end_effector.force import REVERSAL_SPEED
from haptid.errors import CodeSettingError
from haptid.export.names import check_name

Precision = Literal["double", "single"]


@dataclass(frozen=True)
class CCode:
    """How the code is to be.

    Attributes:
        name: how all names begin; after the device where None.
        precision: "double" or "single", in C.
        reversal_speed: below it the sign of a velocity is smoothed, tanh(v / speed), rad/s or m/s.
    """

    name: str | None = None
    precision: Precision = "double"
    reversal_speed: float = REVERSAL_SPEED

    def __post_init__(self) -> None:
        if self.name is not None:
            check_name(self.name)
        if self.precision not in get_args(Precision):
            raise CodeSettingError("precision", self.precision, " or ".join(map(repr, get_args(Precision))))
        if not positive(self.reversal_speed):
            raise CodeSettingError("reversal_speed", self.reversal_speed, "a finite speed above zero, rad/s or m/s")
