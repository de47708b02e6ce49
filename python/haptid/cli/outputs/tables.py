"""What the models of outputs share."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from haptid.results.schema import Number

Interval = tuple[Number, Number]


class OutputTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class QuantityOutput(OutputTable):
    """A number with its uncertainty."""

    name: str
    unit: str
    value: Number
    se: Number = Field(description="standard error; null where it cannot be estimated")
    dof: Number = Field(description="degrees of freedom of the interval; null for infinitely many")
    conf_int: Interval = Field(description="95 % confidence interval [low, high]")
