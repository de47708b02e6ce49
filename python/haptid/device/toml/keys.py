"""Types of the values of a device file: quantities, names, texts, and the base of its tables."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
)


def _quantity(value: Any) -> float | str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("write a number, or arithmetic as text")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("write a finite number")
    return number


# A number, or arithmetic over pi and named lengths as text.
Arithmetic = Annotated[
    Any,
    BeforeValidator(_quantity),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "examples": ["-pi/2", "d3 + 0.1"]}]}),
]
Triple = Annotated[list[Arithmetic], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$", max_length=40)]
Signed = Annotated[str, Field(pattern=r"^-?[A-Za-z0-9_]+$", max_length=41)]
Names = Annotated[list[Name], Field(min_length=1)]
Text = Annotated[str, Field(min_length=1, max_length=2000)]
Unit = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[^\x00-\x1f\x7f]+$")]


Numbers = Annotated[list[Annotated[float, Field(allow_inf_nan=False)]], Field(min_length=3, max_length=3)]
PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Table(BaseModel):
    """A table that allows no other keys.

    One with the defaults alone is `model_construct`ed: checking it would build its validator at import.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, populate_by_name=True, defer_build=True)
