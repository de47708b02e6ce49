"""What commands print with --json, held against the published schemas."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.protocols import Validator
from typer.testing import CliRunner

from haptid.cli import app


@cache
def _validator(command: str) -> Validator:
    schema = json.loads(CliRunner().invoke(app, ["schema", command]).stdout)
    Draft202012Validator.check_schema(schema)
    if command == "schema":  # the published meta-schema, which jsonschema has
        return Draft202012Validator(Draft202012Validator.META_SCHEMA)
    return Draft202012Validator(schema)


def valid(command: str, text: str) -> Any:
    """The values of a JSON text that a command printed or wrote, by the schema that `haptid schema` prints."""
    values = json.loads(text)
    _validator(command).validate(values)
    return values
