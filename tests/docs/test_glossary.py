"""Every name of haptid that the glossary gives exists: in Python, in the schemas of files, on the command line."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from typer.main import get_command

import haptid
from haptid.cli import app
from haptid.device.toml.schema import device_schema
from haptid.results.result import result_schema
from haptid.study.schema import study_schema

PAGE = Path(__file__).parents[2] / "docs" / "glossary.md"
# Columns of other programs and of prose.
FOREIGN = ("term", "there", "remark")


def entries() -> Iterator[tuple[str, str]]:
    """Each quoted name with the heading of its column."""
    heads: list[str] = []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if not line.startswith("|"):
            heads = []
            continue
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not heads:
            heads = cells
        elif set(cells[0]) != {"-"}:
            assert len(cells) == len(heads), line
            for head, cell in zip(heads, cells, strict=True):
                for name in re.findall(r"`([^`]+)`", cell) if head not in FOREIGN else ():
                    yield head, name


def paths(node: Any, schema: dict[str, Any], path: str = "") -> Iterator[str]:
    """Every key by its path, and every value that a key may have by itself."""
    node = schema["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node
    for value in (*node.get("enum", ()), *([node["const"]] if "const" in node else ())):
        yield str(value)
    inner = [*node.get("anyOf", ()), *node.get("oneOf", ()), node.get("items"), node.get("additionalProperties")]
    for part in (*inner, *node.get("patternProperties", {}).values()):
        if isinstance(part, dict):
            yield from paths(part, schema, path)
    for key, value in node.get("properties", {}).items():
        yield f"{path}.{key}".lstrip(".")
        yield from paths(value, schema, f"{path}.{key}".lstrip("."))


def in_python(name: str) -> bool:
    found: Any = haptid
    place = "haptid"
    for part in name.split(".")[1:]:
        place += f".{part}"
        if hasattr(found, part):
            found = getattr(found, part)
        elif part in getattr(found, "__annotations__", ()):  # a field without default
            return name.endswith(part)
        else:
            try:
                found = importlib.import_module(place)
            except ModuleNotFoundError:
                return False
    return True


def on_the_command_line(name: str) -> bool:
    program, *words = name.split()
    command: Any = get_command(app)
    for word in words:
        if word.startswith("--"):
            return any(word in option.opts for option in command.params)
        if word not in getattr(command, "commands", {}):
            return False
        command = command.commands[word]
    return program == "haptid"


FILES = {
    "device file": {*paths(device_schema(), device_schema())},
    "study file": {*paths(study_schema(), study_schema())},
    "JSON": {*paths(result_schema(), result_schema())},
}
FILES["in a device file"] = FILES["device file"]
FILES["in a file of haptid"] = FILES["device file"] | FILES["study file"]
COLUMNS = {"Python": in_python, "in Python": in_python, "command line": on_the_command_line}
COLUMNS |= {head: known.__contains__ for head, known in FILES.items()}


@pytest.mark.parametrize("head", COLUMNS)
def test_every_name_exists(head: str) -> None:
    names = [name for column, name in entries() if column == head]
    assert names
    assert not [name for name in names if not COLUMNS[head](name)]


def test_every_column_is_checked() -> None:
    assert {head for head, _ in entries()} == set(COLUMNS)


@pytest.mark.parametrize(
    ("head", "name"),
    [
        ("Python", "haptid.Estimate.bse"),
        ("Python", "haptid.nothing"),
        ("device file", "motors.gear"),
        ("study file", "treatment.guard"),
        ("JSON", "estimate.parameters.sd"),
        ("command line", "haptid essential"),
        ("command line", "haptid export --anyway"),
    ],
)
def test_a_name_that_does_not_exist_is_found(head: str, name: str) -> None:
    assert not COLUMNS[head](name)


def test_every_method_and_kind_of_intervals_has_an_entry() -> None:
    """Of a study."""
    given = {name for head, name in entries() if head == "study file"}
    for field in ("method", "intervals"):
        annotation = haptid.study.schema.EstimateTable.model_fields[field].annotation
        choices = [choice for choice in (annotation, *get_args(annotation)) if get_origin(choice) is Literal]
        assert choices
        assert {name for choice in choices for name in get_args(choice)} <= given
