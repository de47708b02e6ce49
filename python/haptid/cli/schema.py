"""`haptid schema`."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from haptid.cli.common import EXIT_ERROR, app, complain


@app.command()
def schema(
    kind: Annotated[str, typer.Argument(help="device, study, experiment or result", show_default=False)],
) -> None:
    """Print the JSON Schema of device, study, experiment or result files."""
    from haptid.device import device_schema
    from haptid.experiment.bench.experiment import experiment_schema
    from haptid.results import result_schema
    from haptid.study import study_schema

    schemas = {
        "device": device_schema,
        "study": study_schema,
        "experiment": experiment_schema,
        "result": result_schema,
    }
    if kind not in schemas:
        complain(f"there is no schema {kind!r}; write device, study, experiment or result.")
        raise typer.Exit(EXIT_ERROR)
    sys.stdout.write(json.dumps(schemas[kind](), indent=1) + "\n")
