"""Hooks of the documentation site: formulas as MathML, the page of commands, and a page for each notebook.

A formula is set while the site is built, by latex2mathml, so that a page needs neither a script nor a network for it.
"""

from __future__ import annotations

import html
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
from notebooks import as_markdown

# What `pymdownx.arithmatex` makes of a formula, in a line or displayed.
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
# In docs/cli.md.
COMMANDS = "<!--commands-->"


def on_files(files: Files, config: Any) -> Files:
    """A page beside each notebook, with its stored outputs; the notebook itself can be downloaded there."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        name = file.src_uri.rpartition("/")[2]
        text = as_markdown(json.loads(file.content_string))
        offer = f"This page is a notebook: [download]({name}) and run it.\n\n"
        title, _, rest = text.partition("\n")
        page = f"{title}\n\n{offer}{rest}"
        files.append(File.generated(config, file.src_uri.replace(".ipynb", ".md"), content=page))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The commands in place of their mark."""
    return markdown.replace(COMMANDS, "\n".join(commands())) if COMMANDS in markdown else markdown


def on_page_content(content: str, **_: Any) -> str:
    """MathML in place of TeX."""
    return FORMULA.sub(lambda found: formula(html.unescape(found[3]), displayed=found[2] == "["), content)


def formula(tex: str, displayed: bool) -> str:
    """A formula as MathML; a displayed one scrolls where the page is narrower."""
    made = convert(tex.strip(), display="block" if displayed else "inline")
    return f'<div class="formula" tabindex="0" role="group" aria-label="formula">{made}</div>' if displayed else made


def commands() -> Iterator[str]:
    """Every command with its text, arguments and options, as Markdown."""
    from typer.main import get_command

    from haptid.cli import app

    for name, command in get_command(app).commands.items():
        yield from described(f"haptid {name}", command)


def described(name: str, command: Any) -> Iterator[str]:
    """One command, and the commands below it."""
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
    inner = getattr(command, "commands", {})
    usage = " ".join([name, *(["COMMAND"] if inner else []), *(_place(p) for p in arguments)])
    yield f"## {name}\n\n```text\n{usage}{' [options]' if options else ''}\n```\n\n{command.help}\n"
    if arguments or options:
        yield "| | | default |\n|---|---|---|"
        for p in (*arguments, *options):
            shown = p.name.upper() if p in arguments else ", ".join(p.opts)
            yield f"| `{shown}` | {_cell(p.help or '')} | {_default(p)} |"
        yield ""
    if not inner and name != "haptid schema":
        yield from _output(name.split()[1])
    for below, one in inner.items():
        yield from described(f"{name} {below}", one)


def _output(command: str) -> Iterator[str]:
    """The keys of what a command prints with --json, folded; `haptid schema` has all of it."""
    from haptid.cli.outputs import output_schema

    schema = output_schema(command)
    yield f'??? note "Output of --json"\n\n    All of it: `haptid schema {command}`.\n'
    for title, table in _tables(schema, schema):
        yield f"    {title}\n\n    | key | |\n    |---|---|"
        for key, value in table["properties"].items():
            told = value.get("description") or _referred(value, schema).get("description", "")
            yield f"    | `{key}` | {_cell(told)} |"
        yield ""


def _referred(value: dict[str, Any], whole: dict[str, Any]) -> dict[str, Any]:
    """The object that a key holds, or a list of it; empty for numbers and texts."""
    inner = [value, value.get("items", {}), *value.get("anyOf", ())]
    names = [one["$ref"].rpartition("/")[2] for one in inner if "$ref" in one]
    return whole["$defs"][names[0]] if names else {}


def _tables(schema: dict[str, Any], whole: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The objects that an output is, or is a list or a table of."""
    if "$ref" in schema:
        schema = whole["$defs"][schema["$ref"].rpartition("/")[2]]
    if "properties" in schema:
        yield schema.get("description", ""), schema
    elif "anyOf" in schema:
        for one in schema["anyOf"]:
            yield from _tables(one, whole)
    elif schema.get("type") == "array":
        yield from ((f"A list; each entry: {title}", table) for title, table in _tables(schema["items"], whole))
    else:
        inner = _tables(schema["additionalProperties"], whole)
        yield from ((f"By name: {title}", table) for title, table in inner)


def _place(parameter: Any) -> str:
    shown = parameter.name.upper() + (" ..." if parameter.nargs == -1 else "")
    return shown if parameter.required else f"[{shown}]"


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    value = parameter.default
    return "" if value is None or value is False or callable(value) or value == () else f"`{_cell(str(value))}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")
