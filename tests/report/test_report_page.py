"""The page without a browser: whole in itself, every section there, every chart in words too."""

from html.parser import HTMLParser

import pytest
from jinja2 import Environment
from typer.testing import CliRunner

from haptid.cli import app
from haptid.report import page as pages
from haptid.report.page import page
from haptid.report.sections import SECTIONS
from reported import made

EXPECTED = {
    "verdict",
    "parameters",
    "torque",
    "errors",
    "residual",
    "friction",
    "torque_decomposition",
    "excitation",
    "mechanism",
    "maps",
    "provenance",
}


class Elements(HTMLParser):
    """Every element that begins, with its attributes."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))

    def of(self, tag):
        return [attributes for name, attributes in self.found if name == tag]


@pytest.fixture(scope="module")
def elements():
    return Elements(made().html())


def test_every_section_is_there_in_order(elements):
    keys = [attributes["id"] for attributes in elements.of("section")]
    assert set(keys) == EXPECTED == set(made().sections)
    order = [kind.key for kind in SECTIONS]
    assert keys == [key for key in order if key in keys]
    assert keys[0] == "verdict"
    assert [a["href"] for a in elements.of("a") if a["href"].startswith("#")] == [f"#{key}" for key in keys]


def test_nothing_is_fetched(elements):
    for tag, attributes in elements.found:
        for name in ("src", "href", "action", "data"):
            value = attributes.get(name) or ""
            assert not value or value.startswith(("#", "data:")), (tag, attributes)
    assert "@import" not in made().html()
    assert "url(http" not in made().html()


def test_names_of_elements_are_unique(elements):
    names = [attributes["id"] for _, attributes in elements.found if "id" in attributes]
    assert len(names) == len(set(names))


def test_every_chart_has_words_and_numbers(elements):
    charts = [a for a in elements.of("div") if (a.get("class") or "") == "chart"]
    assert len(charts) > 30
    captions = {a["id"] for a in elements.of("figcaption")}
    for chart in charts:
        assert chart["role"] == "group"
        assert len(chart["aria-label"]) > 20
        assert chart["aria-describedby"] in captions
    for section in made().sections.values():
        for chart in section.charts:
            assert any(character.isdigit() for character in chart.caption), chart.key


def test_what_a_file_says_is_no_markup():
    name = "<script>alert(1)</script>"
    text = page(name, name, ())
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert" in text


def test_each_section_is_one_class_and_one_template():
    assert len({kind.key for kind in SECTIONS}) == len(SECTIONS)
    for kind in SECTIONS:
        assert kind.__doc__


def test_the_command_makes_the_page_again_and_says_what_is_wrong(tmp_path):
    made().write(tmp_path)
    before = (tmp_path / "report.html").read_text(encoding="utf-8")
    (tmp_path / "report.html").unlink()
    done = CliRunner().invoke(app, ["report", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == before
    assert CliRunner().invoke(app, ["report", str(tmp_path), "--out", str(tmp_path / "b.html"), "-q"]).stdout == ""
    assert CliRunner().invoke(app, ["report", str(tmp_path / "nowhere")]).exit_code == 2


@pytest.fixture
def templates(monkeypatch, tmp_path):
    """Templates as a new process has them, whose compiled ones are kept in a folder of the test's."""
    monkeypatch.setattr("sys.pycache_prefix", str(tmp_path / "compiled"))
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    pages._environment.cache_clear()
    yield pages._environment
    pages._environment.cache_clear()


def test_templates_are_compiled_once_for_all_runs(templates, monkeypatch):
    first = page("title", "about", [])
    templates.cache_clear()
    monkeypatch.setattr(Environment, "compile", lambda *_: pytest.fail("compiled again"))
    assert page("title", "about", []) == first


@pytest.mark.usefixtures("templates")
def test_a_page_is_written_where_compiled_templates_cannot_be(tmp_path):
    (tmp_path / "compiled").write_text("no folder")
    assert "<title>title" in page("title", "about", [])
