"""Tables below the marks of a page are made from records, and nothing else of the page is changed."""

import json
import re
from pathlib import Path

import pytest

import pages

DOCS = Path(__file__).resolve().parents[2] / "docs"
MARKS = [
    (page.name, found["title"])
    for page in sorted(DOCS.glob("*.md"))
    for found in pages.MARK.finditer(page.read_text(encoding="utf-8"))
]
PAGE = "Before.\n\n<!-- One -->\n\n(not recorded)\n\n## After\n\n<!-- Two -->\n\nold\nlines\n"


def test_filling_in_leaves_the_rest_as_it_is():
    text = pages.filled(PAGE, {"One": "| a |\n| --- |", "Two": "- b"}.__getitem__)
    assert text == "Before.\n\n<!-- One -->\n\n| a |\n| --- |\n\n## After\n\n<!-- Two -->\n\n- b\n"
    assert pages.filled(text, {"One": "1", "Two": "2"}.__getitem__) == pages.filled(
        PAGE, {"One": "1", "Two": "2"}.__getitem__
    )


def test_new_marks_take_nothing_away():
    text = pages.filled("<!-- One -->\n\n<!-- Two -->\n\n## After\n", {"One": "1", "Two": "2"}.__getitem__)
    assert text == "<!-- One -->\n\n1\n\n<!-- Two -->\n\n2\n\n## After\n"


def test_a_mark_without_a_part_is_an_error():
    with pytest.raises(KeyError, match="Three"):
        pages.part("Three")


@pytest.mark.parametrize(("page", "title"), MARKS)
def test_every_mark_has_a_part(page, title):
    assert "recorded)" not in pages.part(title), page
    assert "\n\n" not in pages.part(title)


def test_parts_of_a_demonstration_are_those_of_its_record(tmp_path, monkeypatch):
    table = {"title": "", "cells": [["", "x, %", "range"], ["a | b", "1.5", "1 .. 2"]]}
    record = {"sections": {"errors": {"text": ["One.", "Two " + 40 * "words "], "tables": [table, table]}}}
    (tmp_path / "some-demo.json").write_text(json.dumps(record))
    monkeypatch.setattr(pages, "RESULTS", tmp_path)
    assert pages.part("some-demo: errors, table 2").splitlines() == [
        "|  | x, % | range |",
        "| --- | ---: | ---: |",
        "| a \\| b | 1.5 | 1 .. 2 |",
    ]
    lines = pages.part("some-demo: errors, text").splitlines()
    assert lines[0] == "- One."
    assert all(len(line) <= pages.WIDTH for line in lines)
    assert re.match(r"  words", lines[2])


def test_figures_of_a_record_have_their_row_and_column():
    sorts = dict(zip(pages.SORTS, (0.0001, 2.0, 0.123, 1.049), strict=True))
    rows = ("an arm, 3 joints, exact states", "an arm, 3 joints, encoders")
    bench = {f"{row}: {what}, %": x for row in rows for what, x in sorts.items()}
    assert pages.bench_identification(bench).splitlines()[2:] == [
        "| an arm, 3 joints | exact states | 1e-04 | 2 | 0.12 | 1 |",
        "|  | encoders | 1e-04 | 2 | 0.12 | 1 |",
    ]
    seeds = {f"encoders, GC: {what}, {kind}, %": x for what, x in sorts.items() for kind in ("median", "worst")}
    assert pages.mountings(seeds).splitlines()[2] == "| GC | 0.0001 / 0.0001 | 2 / 2 | 0.12 / 0.12 | 1 / 1 |"
    times = {f"{method}: times less biased than OLS": 4.61 for method in ("IV", "DIDIM", "CLIE")}
    assert "| 4.6 | 4.6 | 4.6 |" in pages.less_biased(times)
