"""The page on the two branches has the recorded figures of the study, published tables, and a check for each claim."""

import json
import re

import pytest

from haptid.demos import read_demo

FIGURES = {
    "held, mean, %": "mean",
    "relative deviation over the published one, worst": "deviation",
    "relative error, unseen motion, median, %": "median",
    "relative error, unseen motion, worst, %": "worst",
    "seeds in which the fifteen alone are kept": "alone",
}


@pytest.fixture(scope="module")
def page(request):
    return (request.config.rootpath / "docs/medical.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def recorded(request):
    file = request.config.rootpath / "benchmarks/results/medical-study.json"
    return json.loads(file.read_text(encoding="utf-8"))["figures"]


def test_the_table_of_the_study_has_the_recorded_figures(page, recorded):
    table = re.search(r"\| branch \| intervals.*?\n\n", page, re.DOTALL)
    assert table is not None
    titles = [branch.title for branch in read_demo("medical").branches]
    lines = table[0].strip().splitlines()[2:]
    assert len(lines) == len(titles)
    for line, title in zip(lines, titles, strict=True):
        name, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert name == title
        for what, cell in zip(FIGURES, cells, strict=True):
            assert float(cell) == pytest.approx(recorded[f"{title}: {what}"], rel=0.06), (title, what)
    seeds = re.search(r"(\d+) seeds of each branch", page)
    assert seeds is not None
    assert int(seeds[1]) == recorded["seeds of each branch"]


def test_limits_are_met_in_the_recorded_study(recorded):
    for branch in read_demo("medical").branches:
        assert recorded[f"{branch.title}: relative deviation over the published one, worst"] <= 1
        assert recorded[f"{branch.title}: relative error, unseen motion, worst, %"] <= 3


def test_every_claim_is_on_the_page_and_its_check_is_a_golden_test(page, request):
    golden = [path.read_text(encoding="utf-8") for path in (request.config.rootpath / "tests/golden").glob("*.py")]
    claims = read_demo("medical").claims
    assert [claim.name for claim in claims] == [f"T{k}" for k in range(1, 10)]
    for claim in claims:
        assert f"| {claim.name} |" in page
        assert claim.check in page
        assert any(f"def {claim.check}(" in text for text in golden), claim.check


def test_published_parameters_on_the_page_are_those_of_the_tables(page):
    for table in read_demo("medical").tables.values():
        for name in table.rows:
            cad, identified, relative = (f"{table.figures[name, column]:g}" for column in table.columns)
            assert re.search(rf"\| {name} \| [^|]+ \| {cad} \| {identified} \| {relative} \|", page), name
