"""`haptid schema`."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from haptid.cli.common import AsJson, command, errors_shown
from haptid.errors import OptionError, suggestion

_KINDS = ("device", "world", "study", "experiment", "result")


@command("Print the JSON Schema of device, world, study, experiment or result files.")
def schema(
    kind: Annotated[
        str,
        typer.Argument(
            help="device, world, study, experiment or result", show_default=False, autocompletion=lambda: list(_KINDS)
        ),
    ],
    as_json: AsJson = False,  # noqa: ARG001 - a schema is JSON in any case
) -> None:
    from haptid.device import device_schema, world_schema
    from haptid.experiment.bench.experiment import experiment_schema
    from haptid.results import result_schema
    from haptid.study import study_schema

    found = (device_schema, world_schema, study_schema, experiment_schema, result_schema)
    schemas = dict(zip(_KINDS, found, strict=True))
    with errors_shown():
        if kind not in schemas:
            advice = suggestion(kind, schemas)
            raise OptionError(f"there is no schema {kind!r}.", where="KIND", found=kind, limit=_KINDS, advice=advice)
    sys.stdout.write(json.dumps(schemas[kind](), indent=1) + "\n")
