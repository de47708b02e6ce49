"""`haptid model`, `import`, `channels`, `excite`, `bench`, and lists."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ConfigDict, Field

from haptid.cli.outputs.tables import OutputTable
from haptid.results.schema import Number


class NoteOutput(OutputTable):
    grade: Literal["exact", "approximate", "left out"]
    text: str
    line: int | None = Field(description="of the description")


class ImportCheckOutput(OutputTable):
    states: int = Field(description="random states compared")
    torque: Number = Field(description="largest difference of torque, relative to the largest torque")
    gap_m: Number = Field(description="of the loops, closed")
    others: dict[str, Number] = Field(description="the same by other programs")


class ImportOutput(OutputTable):
    """A robot description as a device file."""

    source: str
    format: str
    exact: bool
    joints: dict[str, str] = Field(description="names in the device file, by those of the description")
    active: list[str]
    notes: list[NoteOutput]
    check: ImportCheckOutput
    snapped: Number = Field(description="change of the largest torque by snapping angles; null without")


class BaseParameterOutput(OutputTable):
    name: str
    unit: str
    grouping: dict[str, float] = Field(description="coefficients of the standard parameters")
    formula: str | None = Field(default=None, description="the regrouping with lengths as symbols")
    latex: str | None = None
    exact: dict[str, str] | None = Field(default=None, description="coefficients as formulas")


class ModelOutput(OutputTable):
    """Base parameters of a device."""

    device: str
    relations: list[str] = Field(description="of loops, as solved")
    closure_error: Number
    base_parameters: list[BaseParameterOutput]
    symbols: dict[str, float] = Field(description="lengths, m")
    notes: list[str]
    no_effect: list[str] = Field(description="standard parameters without effect on the torque")
    tolerance: Number = Field(description="of the rank")
    gap: list[Number] = Field(description="singular values on both sides of it")
    only_by_rounding: list[str]


class RegisterOutput(OutputTable):
    """How a drive's word has its sign."""

    sign_bit: int | None
    word_bits: int | None


class ChannelOutput(OutputTable):
    name: str
    count: int
    missing: int
    low: Number
    high: Number
    whole: bool = Field(description="whether all are whole numbers")
    quantity: Literal["time", "position", "velocity", "torque", "other"]
    unit: str
    reason: str = Field(description="of the guess")
    period: Number = Field(description="by which a position jumps, in its own unit; 0 where it does not")
    register_: RegisterOutput = Field(alias="register")
    joint: str = Field(description="as texts beside it name it, in every row or in a list; empty where none does")


class TopicOutput(OutputTable):
    name: str = Field(description="empty for a table")
    kind: str
    count: int = Field(description="messages or rows")
    rate_hz: Number
    joints: list[str]
    empty: dict[str, int] = Field(description="arrays without elements, and in how many messages")
    channels: list[ChannelOutput]
    header: str
    late_ms: Number = Field(description="median of receive stamp minus header stamp")
    why_not: str = Field(description="why it is not decoded")
    by_rates_hz: Number = Field(description="rate at which velocities are the rates of positions, without times")
    stated_hz: Number = Field(description="rate that a number beside the samples states; 0 where none does")
    stated_by: str = Field(description="that number with its name")


class ChannelsOutput(OutputTable):
    """What a log contains."""

    path: str
    format: str
    notes: list[str]
    topics: list[TopicOutput]
    table: str = Field(description="draft of [channels], TOML")


class ConditionOutput(OutputTable):
    raw: Number
    scaled: Number = Field(description="with columns of unit length")


class PredictedIntervalOutput(OutputTable):
    name: str
    before_percent: Number = Field(description="half width, per cent of the value")
    after_percent: Number


class PredictionOutput(OutputTable):
    """What the logs of motions are predicted to give, where their noise is known."""

    intervals: list[PredictedIntervalOutput] | None = None
    accuracy_percent: Number = Field(default=None, description="that was asked")
    reached: bool | None = Field(default=None, description="whether the logs have it already")
    seconds: Number = Field(
        default=None, description="of the motions; of a friction test, held poses and reversals, of this"
    )
    seconds_needed: Number = Field(default=None, description="until all intervals have it")
    sentences: list[str] | None = None


class PlannedMotionOutput(PredictionOutput):
    experiment: str = Field(description="file for haptid bench")
    samples: str = Field(description="CSV of the motion")
    parameters: list[str] | None = Field(default=None, description="that count")
    motions_evaluated: int | None = None
    first_condition: ConditionOutput | None = Field(default=None, description="of the first motion within the limits")
    condition: ConditionOutput | None = None
    predicted_relative_se_percent: dict[str, Number] | None = None


class CampaignOutput(PredictionOutput):
    """Several motions, one after the other."""

    motions: list[PlannedMotionOutput]


class BenchLogOutput(OutputTable):
    log: str
    truth: list[str] = Field(description="files of true parameters and signals")
    picture: str | None


class AppOutput(OutputTable):
    """Printed when the workbench listens."""

    folder: str
    address: str = Field(description="with the token; http, on this machine only")


class CompletionOutput(OutputTable):
    """A shell's completion script."""

    shell: str
    script: str


class DemoNameOutput(OutputTable):
    name: str
    title: str


class DemoResultOutput(OutputTable):
    """What a demonstration found: its result.json. What follows these entries is its own."""

    model_config = ConfigDict(extra="allow")

    schema_: int = Field(alias="schema")
    demo: str
    title: str
    source: str
    claims: list[dict[str, str]] = Field(description="printed statements that do not hold")


class NamedDeviceOutput(OutputTable):
    name: str
    description: str


class FetchOutput(OutputTable):
    """Public recordings, and what was downloaded."""

    recordings: list[dict[str, Any]] = Field(description="source, licence, files and SHA-256")
    files: list[str]
