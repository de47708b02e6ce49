"""What `--json` prints, command by command: one model for each, which writes the output and whose JSON Schema
`haptid schema COMMAND` prints.

A number that is not finite is null. An entry that a command leaves out is one that the schema does not require.
`haptid identify` prints result.json, whose model is `results.Result`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter

from haptid._internal.escaping import json_text
from haptid.cli.outputs.of_devices import (
    AppOutput,
    BenchLogOutput,
    CampaignOutput,
    ChannelsOutput,
    CompletionOutput,
    DemoNameOutput,
    DemoResultOutput,
    FetchOutput,
    ImportOutput,
    ModelOutput,
    NamedDeviceOutput,
    PlannedMotionOutput,
)
from haptid.cli.outputs.of_results import (
    CharacteriseOutput,
    CompareOutput,
    ExportOutput,
    RedesignOutput,
    ReportOutput,
    SheetRowOutput,
)
from haptid.cli.outputs.of_studies import (
    AdviseOutput,
    CheckOutput,
    EliminationOutput,
    FleetOutput,
    FrictionOutput,
    PayloadOutput,
    PoolOutput,
    PosesOutput,
    ResponseOutput,
)
from haptid.results.tables import finite

# Where a command prints a JSON Schema itself.
META_SCHEMA = "https://json-schema.org/draft/2020-12/schema"
# Outputs by command; of haptid identify and haptid schema see `output_schema`.
OUTPUTS: Mapping[str, Any] = {
    "advise": AdviseOutput,
    "app": AppOutput,
    "bench": list[BenchLogOutput],
    "channels": ChannelsOutput,
    "characterise": CharacteriseOutput,
    "check": CheckOutput,
    "compare": CompareOutput,
    "completion": CompletionOutput,
    "datasheet": dict[str, list[SheetRowOutput]],
    "demo": list[DemoNameOutput] | DemoResultOutput,
    "devices": list[NamedDeviceOutput],
    "eliminate": dict[str, EliminationOutput],
    "excite": PlannedMotionOutput | CampaignOutput,
    "export": ExportOutput,
    "fetch": FetchOutput,
    "fleet": FleetOutput,
    "friction": FrictionOutput,
    "import": ImportOutput,
    "model": ModelOutput,
    "payload": PayloadOutput,
    "pool": PoolOutput,
    "poses": PosesOutput,
    "redesign": RedesignOutput,
    "report": ReportOutput,
    "response": ResponseOutput,
}


def output_text(command: str, values: Mapping[str, Any] | Sequence[Any]) -> str:
    """The JSON text that a command prints, by its model; an entry that the model does not have is a defect."""
    model: TypeAdapter[Any] = TypeAdapter(OUTPUTS[command])
    return json_text(
        finite(model.dump_python(model.validate_python(values), mode="json", by_alias=True, exclude_unset=True))
    )


def output_schema(command: str) -> dict[str, Any]:
    """JSON Schema (2020-12) of what a command prints with --json."""
    from haptid.results import result_schema

    if command == "schema":
        return {"$ref": META_SCHEMA}
    if command == "identify":
        return result_schema()
    return TypeAdapter(OUTPUTS[command]).json_schema(by_alias=True, mode="serialization")
