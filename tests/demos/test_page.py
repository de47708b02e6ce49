"""The page on the published identification has the recorded figures of the study, and a check for each claim."""

import json
import re

import pytest

from haptid.demos import read_demo


@pytest.fixture(scope="module")
def page(request):
    return (request.config.rootpath / "docs/phantom.md").read_text(encoding="utf-8")


def test_the_table_of_the_study_has_the_recorded_figures(page, request):
    file = request.config.rootpath / "benchmarks/results/phantom-study.json"
    recorded = json.loads(file.read_text(encoding="utf-8"))["figures"]
    table = re.search(r"\| mounting \| torque.*?\n\n", page, re.DOTALL)
    assert table is not None
    titles = set(read_demo("phantom").mountings.values())
    for line in table[0].strip().splitlines()[2:]:
        title, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert title in titles
        for what, cell in zip(("torque", "parameters", "Coulomb", "viscous"), cells, strict=True):
            for kind, figure in zip(("median", "worst"), cell.split(" / "), strict=True):
                wanted = recorded[f"encoders, {title}: {what}, {kind}, %"]
                assert float(figure) == pytest.approx(wanted, rel=0.06), (title, what, kind)


def test_every_claim_is_on_the_page(page):
    for claim in read_demo("phantom").claims:
        assert f"| {claim.name} |" in page
        assert claim.check in page
