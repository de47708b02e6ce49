"""The page on the two branches has the recorded figures of the study, published tables, and a check for each claim."""

import json
import re

import numpy as np
import pytest

from haptid.demos import read_demo

SEEDS = 20
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
    assert int(seeds[1]) == recorded["seeds of each branch"] == SEEDS


def test_intervals_of_the_recorded_study_cover_the_truth_as_often_as_stated(recorded):
    """Every published parameter over the logs of both branches, and all of them together."""
    demo = read_demo("medical")
    held = {
        name: np.mean([recorded[f"{branch.title}: {name} held, %"] for branch in demo.branches])
        for name in demo.tables[demo.branches[0].key].rows
    }
    assert len(held) == 15
    assert min(held.values()) >= 90
    assert np.mean(list(held.values())) >= 93
    assert np.mean(list(held.values())) == pytest.approx(recorded["published parameters: held, mean, %"])


def test_the_fifteen_and_no_other_are_kept_in_every_seed_of_the_recorded_study(recorded):
    for branch in read_demo("medical").branches:
        assert recorded[f"{branch.title}: seeds in which the fifteen alone are kept"] == SEEDS
        assert recorded[f"{branch.title}: published parameters left out, most"] == 0
        assert recorded[f"{branch.title}: others kept, most"] == 0


def test_limits_are_met_in_the_recorded_study(recorded):
    for branch in read_demo("medical").branches:
        assert recorded[f"{branch.title}: relative deviation over the published one, worst"] <= 1
        assert recorded[f"{branch.title}: relative error, unseen motion, worst, %"] <= 3


def test_every_claim_is_on_the_page_and_its_check_is_there(page, request):
    tests = request.config.rootpath / "tests"
    files = [*(tests / "golden").glob("*.py"), tests / "excitation/test_wide_example.py"]
    checks = [path.read_text(encoding="utf-8") for path in files]
    claims = read_demo("medical").claims
    assert [claim.name for claim in claims] == [f"T{k}" for k in range(1, 10)]
    for claim in claims:
        assert f"| {claim.name} |" in page
        assert claim.check in page
        assert any(f"def {claim.check}(" in text for text in checks), claim.check


def test_published_parameters_on_the_page_are_those_of_the_tables(page):
    for table in read_demo("medical").tables.values():
        for name in table.rows:
            cad, identified, relative = (f"{table.figures[name, column]:g}" for column in table.columns)
            assert re.search(rf"\| {name} \| [^|]+ \| {cad} \| {identified} \| {relative} \|", page), name
