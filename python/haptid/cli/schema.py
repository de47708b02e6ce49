"""`haptid schema`."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any

import typer

from haptid.cli.common import AsJson, app, command, errors_shown
from haptid.errors import OptionError, suggestion

HELP = """\
Print the JSON Schema of a kind of file, or of what a command prints with --json.

NAME is device, world, study, experiment or result for files, or the name of a command.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid schema compare`
"""
FILES = ("device", "world", "study", "experiment", "result")


def _names() -> list[str]:
    return [*FILES, *sorted(typer.main.get_command(app).commands)]  # type: ignore[attr-defined]


@command(HELP)
def schema(
    name: Annotated[
        str, typer.Argument(help="a kind of file, or a command", show_default=False, autocompletion=_names)
    ],
    as_json: AsJson = False,  # noqa: ARG001 - a schema is JSON in any case
) -> None:
    with errors_shown():
        if name not in _names():
            advice = suggestion(name, _names())
            raise OptionError(f"there is no schema {name!r}.", where="NAME", found=name, limit=_names(), advice=advice)
    sys.stdout.write(json.dumps(_schema(name), indent=1) + "\n")


def _schema(name: str) -> dict[str, Any]:
    from haptid.cli.outputs import output_schema
    from haptid.device import device_schema, world_schema
    from haptid.experiment.bench.experiment import experiment_schema
    from haptid.results import result_schema
    from haptid.study import study_schema

    files = (device_schema, world_schema, study_schema, experiment_schema, result_schema)
    schemas = dict(zip(FILES, files, strict=True))
    return schemas[name]() if name in schemas else output_schema(name)
