"""HTML pages: a template for each section, one style sheet and one script, all in one file."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib.resources import files
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined
from jinja2.bccache import Bucket
from markupsafe import Markup

from haptid._core import __version__
from haptid.report.chart import Chart
from haptid.report.mathml import formula_markup
from haptid.report.section import PageSection
from haptid.results.tables import finite

# The script's parts, in the order of their dependencies.
SCRIPTS = (
    *("numbers.js", "svg.js", "paint.js", "plot.js", "heat.js", "bars.js", "mechanism.js", "solids.js", "scene.js"),
    *("tables.js", "charts.js"),
    "page.js",
)
_STYLES = ("page.css",)
_EXPORTED = "export { drawAll, startTables, resolved };\n"


def page(title: str, about: str, sections: Sequence[PageSection]) -> str:
    """A whole HTML document.

    Args:
        title, about: of the page.
        sections: in order.
    """
    parts = page_parts(sections)
    shown = [{**section, "html": Markup(section["html"])} for section in parts["sections"]]
    return (
        _environment()
        .get_template("page.html")
        .render(
            title=title,
            about=about,
            sections=shown,
            styles=[Markup(_text(name)) for name in _STYLES],
            scripts=[Markup(_text(name)) for name in SCRIPTS],
            drawings=_embedded(parts["drawings"]),
        )
    )


def page_parts(sections: Sequence[PageSection]) -> dict[str, Any]:
    """The sections of a page as JSON values, for another page with the same script and style.

    Returns:
        `sections`, each with key, title and html; `drawings`, of the charts by their keys.
    """
    shown = [
        {"key": s.key, "title": s.title, "html": _environment().get_template(f"{s.template}.html").render(s=s)}
        for s in sections
    ]
    drawings = {chart.key: chart.drawing for section in sections for chart in section.charts}
    return {"sections": shown, "drawings": finite(drawings)}


def module_of_scripts() -> str:
    """The scripts but the page's own as one ES module, for a page that draws parts of reports."""
    return "\n".join(["// Parts of the report's script.", *map(_text, SCRIPTS[:-1]), _EXPORTED])


class _Compiled(FileSystemBytecodeCache):
    """Compiled templates, kept where Python keeps compiled modules: compiling takes longer than filling them in."""

    def load_bytecode(self, bucket: Bucket) -> None:
        with suppress(OSError):
            super().load_bytecode(bucket)

    def dump_bytecode(self, bucket: Bucket) -> None:
        if not sys.dont_write_bytecode:
            with suppress(OSError):  # the folder cannot be written: the next run compiles them again
                Path(self.directory).mkdir(parents=True, exist_ok=True)
                super().dump_bytecode(bucket)


@cache
def _environment() -> Environment:
    beside = Path(cache_from_source(str(Path(__file__).parent / "templates" / "page.html"))).parent
    environment = Environment(
        loader=PackageLoader("haptid.report", "templates"),
        bytecode_cache=_Compiled(str(beside), f"%s.{__version__}.jinja"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["show"] = _show
    environment.filters["number"] = _number
    environment.tests["figure"] = lambda cell: cell.lstrip("-")[:1].isdigit()
    environment.filters["mathml"] = formula_markup
    environment.filters["embedded"] = _embedded
    environment.filters["unit"] = lambda unit: unit.replace("^2", "\u00b2").replace("^3", "\u00b3")
    return environment


def _show(chart: Chart) -> Markup:
    """The element of a chart, into which the page's script draws."""
    template = _environment().get_template("chart.html")
    return Markup(template.render(chart=chart, kind=chart.drawing["kind"]))


def _number(value: float | None, digits: int = 4) -> str:
    """A number to some digits; empty for None."""
    return "" if value is None else f"{value:.{digits}g}"


def _text(name: str) -> str:
    return files("haptid.report").joinpath("templates", name).read_text(encoding="utf-8")


def _embedded(value: Any) -> Markup:
    """JSON that is safe inside a script element."""
    text = json.dumps(finite(value), allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))
